"""What people look at: Rerun files read back, the viewer's own complaints, the report's page."""

from __future__ import annotations

import json
import os
import re
import socket
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from rerun.chunk import RrdReader

import testbed as tb
from testbed.errors import ExperimentError, UnseenParameters, ViewerError
from testbed.experiment.evaluate import evaluate
from testbed.experiment.run import Run
from testbed.experiment.run_folder import read_run, write_run
from testbed.experiment.unseen import subject_of
from testbed.identification.identify import Method
from testbed.identification.predict import Growth, growth
from testbed.identification.settings import Settings
from testbed.recordings.recording import Truth
from testbed.report.contents import Subject, notes
from testbed.report.html import write_report
from testbed.robot.visuals.load_shapes import load_shapes
from testbed.robot.visuals.shapes import poses_at_zero
from testbed.robot.visuals.sticks import sticks
from testbed.viewer.live import Live
from testbed.viewer.log import write_rrd
from testbed.viewer.story import Story, means, poses, pressure, tell
from tests.helpers.browser import browser
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot, random_states

LAVAPIPE = Path("/usr/share/vulkan/icd.d/lvp_icd.x86_64.json")


@pytest.fixture(scope="module")
def outcome(puma_recording: tb.Recording) -> Run:
    settings = ["motion.duration=10", "simulation.step=2.5e-4", "motion.candidates=10"]
    experiment = tb.Experiment.load(ROOT / "experiments/table6.toml", settings)
    return evaluate(experiment, puma_recording)


@pytest.fixture(scope="module")
def story(outcome: Run) -> Story:
    times = [2.0, 4.0, 10.0]
    grown: dict[Method, Growth] = {
        "external": growth(outcome.tree, outcome.recording, "external", times, zeros=True)
    }
    shapes = load_shapes(ROOT / "models/puma562.xml", outcome.tree).shapes
    return tell(
        "puma", outcome.tree, outcome.recording, shapes, outcome.estimates, outcome.truths, grown
    )


@pytest.fixture(scope="module")
def subject(outcome: Run) -> Subject:
    return subject_of(outcome)


def columns(path: Path, entity: str, column: str) -> np.ndarray[Any, Any]:
    """All samples of one entity's column, in the file's order."""
    reader = RrdReader(str(path))
    store = reader.store(store=reader.recordings()[0])
    found = [
        chunk.to_record_batch().column(column)
        for chunk in store.stream().filter(content=entity)
        if not chunk.is_static
    ]
    return np.concatenate([np.array(each.flatten().to_pylist(), dtype=float) for each in found])


@pytest.fixture(scope="module")
def rrd(story: Story, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rrd") / "puma.rrd"
    write_rrd([story], path)
    return path


def test_every_sample_of_the_wrench_is_in_the_file(story: Story, rrd: Path) -> None:
    found = columns(rrd, "/wrench/Fz", "Scalars:scalars").reshape(-1, 3)
    expected = np.column_stack(
        [story.measured(story.recording.measured("wrench"))[:, 2]]
        + [story.wrench[method][:, 2] for method in ("external", "internal")]
    )
    np.testing.assert_array_equal(found, expected)
    position = columns(rrd, "/position", "Scalars:scalars").reshape(-1, 3)
    np.testing.assert_array_equal(position, story.recording.position)


def test_the_arrows_are_the_measured_reaction(story: Story, rrd: Path) -> None:
    size = round(story.recording.rate / 50)
    wrench = means(story.measured(story.recording.measured("wrench")), size)
    for name, vectors in (("force", wrench[:, :3]), ("moment", wrench[:, 3:])):
        found = columns(rrd, f"/world/bedplate/{name}", "Arrows3D:vectors")
        arrows = np.stack(list(found.reshape(-1, 3)))
        scale = np.linalg.norm(arrows, axis=1).max() / np.linalg.norm(vectors, axis=1).max()
        np.testing.assert_allclose(arrows, vectors * scale, rtol=1e-5, atol=1e-6)


def test_the_file_has_a_blueprint_and_one_timeline(rrd: Path) -> None:
    reader = RrdReader(str(rrd))
    assert len(reader.blueprints()) == 1
    schema = reader.store(store=reader.recordings()[0]).schema()
    assert [column.name for column in schema.index_columns()] == ["time"]


def test_the_robot_in_the_file_stands_as_it_stood(story: Story, rrd: Path) -> None:
    """Rotations read back from the file against Pinocchio's frames."""
    model = pin.buildModelFromUrdf(str(ROOT / "models/puma562.urdf"))
    data = model.createData()
    shown = story.motion.q[story.frames]
    for j in range(3):
        turn = columns(rrd, f"/world/robot/{j + 1}", "Transform3D:quaternion").reshape(-1, 4)
        place = columns(rrd, f"/world/robot/{j + 1}", "Transform3D:translation").reshape(-1, 3)
        assert len(turn) == len(shown)
        for k in range(0, len(shown), 97):
            pin.forwardKinematics(model, data, shown[k])
            frame = data.oMi[j + 1]
            there = pin.Quaternion(turn[k]).toRotationMatrix()
            np.testing.assert_allclose(there, frame.rotation, atol=1e-6)
            np.testing.assert_allclose(place[k], frame.translation, atol=1e-6)


def test_runs_stand_side_by_side(story: Story, tmp_path: Path) -> None:
    write_rrd([story, replace(story, name="again")], tmp_path / "two.rrd")
    for run in ("run1", "run2"):
        assert len(columns(tmp_path / "two.rrd", f"/{run}/wrench/Fz", "Scalars:scalars"))


@pytest.mark.parametrize("seed", range(8))
def test_poses_are_pinocchios(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, 5)
    tree = robot.tree()
    q, *_ = random_states(rng, 3, tree.n)
    model = pin.buildModelFromXML(robot.urdf())
    data = model.createData()
    for k in range(len(q)):
        full = np.zeros(tree.n)
        for j, name in enumerate(tree.names):
            full[model.joints[model.getJointId(name)].idx_q] = q[k, j]
        pin.forwardKinematics(model, data, full)
        for name, (rotation, position) in zip(tree.names, poses(tree, q), strict=True):
            placed = data.oMi[model.getJointId(name)]
            np.testing.assert_allclose(rotation[k], placed.rotation, atol=1e-12)
            np.testing.assert_allclose(position[k], placed.translation, atol=1e-12)
    for here, there in zip(poses(tree, np.zeros((1, tree.n))), poses_at_zero(tree), strict=True):
        np.testing.assert_allclose(here[0][0], there[0], atol=1e-12)
        np.testing.assert_allclose(here[1][0], there[1], atol=1e-12)


def test_both_languages_give_shapes_to_the_right_bodies() -> None:
    seen = {}
    for name in ("puma562.xml", "puma562.urdf"):
        tree = tb.load_tree(ROOT / "models" / name)
        shapes = load_shapes(ROOT / "models" / name, tree).shapes
        seen[name] = {shape.body for shape in shapes}
        assert all(np.isfinite(shape.position).all() for shape in shapes)
        for shape in shapes:  # the upper arm is beside the shoulder, the column below it
            if shape.body == 1:
                assert abs(shape.position[2]) < 0.6
    assert seen == {"puma562.xml": {-1, 0, 1, 2}, "puma562.urdf": {-1, 0, 1, 2}}


def test_a_robot_without_shapes_is_drawn_as_sticks(puma: tb.Tree) -> None:
    found = list(sticks(puma))
    assert {shape.body for shape in found} >= {0, 1, 2}


def test_the_centre_of_pressure_balances_the_moments() -> None:
    rng = np.random.default_rng(0)
    force, point = rng.normal(size=(20, 3)), rng.normal(size=(20, 2))
    force[:, 2] += 5
    arm = np.column_stack([point, np.zeros(20)])
    wrench = np.column_stack([force, np.cross(arm, force)])
    np.testing.assert_allclose(pressure(wrench), point, atol=1e-12)
    assert np.isnan(pressure(np.array([[1.0, 0, 0, 0, 0, 0]]))).all()


def test_predictions_without_noise_are_exact(puma: tb.Tree) -> None:
    """Noise-free data: both estimates predict wrench and torques to the last digits."""
    settings = ["motion.duration=4", "motion.candidates=3", "simulation.step=1e-3"]
    experiment = tb.Experiment.load(ROOT / "experiments/noise_free.toml", settings)
    outcome = tb.carry_out(experiment)
    told = tell("exact", outcome.tree, outcome.recording, estimates=outcome.estimates)
    for method in outcome.estimates:
        gap = told.wrench[method] - told.measured(outcome.recording.measured("wrench"))
        assert np.abs(gap).max() < 1e-8 * np.abs(outcome.recording.measured("wrench")).max()
    gap = told.torque["internal"] - told.measured(outcome.recording.measured("torque"))
    turning = np.abs(told.motion.qd) > 0.02  # dry friction at rest has no formula
    assert np.abs(gap[turning]).max() < 1e-6 * np.abs(outcome.recording.measured("torque")).max()


@pytest.fixture
def headless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, int]]:
    """The real viewer, drawing without a screen, and its port."""
    if not LAVAPIPE.exists():
        pytest.skip("no software Vulkan driver on this machine")
    experimental = pytest.importorskip("rerun.experimental")
    monkeypatch.setenv("VK_ICD_FILENAMES", str(LAVAPIPE))
    monkeypatch.setenv("WGPU_BACKEND", "vulkan")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    spawn = experimental.ViewerClient.spawn
    with spawn(headless=True, port=port, hide_welcome_screen=True) as viewer:
        yield viewer, port


def settled(viewer: Any) -> list[Any]:
    """The viewer's views, once they are there."""
    for _ in range(60):
        time.sleep(0.5)
        views: list[Any] = list(viewer.get_state().views)
        if len(views) > 3:
            return views
    raise AssertionError("the viewer shows no views")


def test_the_viewer_has_nothing_to_complain_about(
    headless: tuple[Any, int], rrd: Path, tmp_path: Path
) -> None:
    viewer, _ = headless
    viewer.open(str(rrd))
    settled(viewer)
    viewer.set_time("time", duration=4.0, play_state="paused")
    time.sleep(2)
    viewer.save_screenshot(str(tmp_path / "shot.png"))
    assert [view.reports for view in settled(viewer) if view.reports] == []
    assert (tmp_path / "shot.png").stat().st_size > 50_000


def test_a_run_is_shown_while_it_happens(headless: tuple[Any, int], story: Story) -> None:
    viewer, port = headless
    live = Live(story, port)
    truth = story.recording.truth
    assert truth is not None
    for first in (0, 1000):
        part = slice(first, first + 1000)
        piece = Truth(**{name: values[part] for name, values in vars(truth).items()})
        live(story.recording.time[part], piece)
    assert [view.reports for view in settled(viewer) if view.reports] == []


def test_a_live_view_needs_a_viewer(story: Story) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(ViewerError, match=f"no viewer listens at 127.0.0.1:{port}; open one"):
        Live(story, port)


@pytest.fixture(scope="module")
def page(subject: Subject, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(subject, path)
    return path


def test_the_report_needs_nothing_else(page: Path) -> None:
    text = page.read_text()
    assert not re.search(r"<script|<link|@import|url\((?!#)|src=", text)
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", text)
    assert page.stat().st_size < 4e6


def test_the_report_says_what_was_found(page: Path, subject: Subject) -> None:
    text, numbers = page.read_text(), json.loads(page.with_suffix(".json").read_text())
    for name in subject.external.names:
        assert f">{name}<" in text
    assert [row["name"] for row in numbers["parameters"]][:2] == ["mb3z", "K3yy"]
    assert numbers["has_truth"]
    assert len(numbers["figures"]) == 3
    tables = {figure["id"]: figure["rows"] for figure in numbers["figures"]}
    assert len(tables["prediction"]) == 9
    worst = max(float(row[5].rstrip("%")) for row in tables["prediction"][:6])
    assert worst < 5.0  # the plate's channels, on a motion that was not identified


def test_the_report_is_the_same_bits_every_time(
    subject: Subject, page: Path, tmp_path: Path
) -> None:
    write_report(subject, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_bytes() == page.read_bytes()


def test_parameters_that_are_told_apart_poorly_are_named(subject: Subject) -> None:
    external = subject.external
    covariance = np.diag(external.sigma**2)
    covariance[0, 1] = covariance[1, 0] = -0.97 * external.sigma[0] * external.sigma[1]
    known = replace(subject, truths={})
    told = notes(replace(known, external=replace(external, covariance=covariance), warnings=()))
    assert told[0] == (
        "mb3z and K3yy are told apart poorly by the external method: their correlation is -0.97"
    )


def test_errors_that_sigma_does_not_tell_are_named(subject: Subject) -> None:
    """Torque constants are off by percents: the internal estimate's errors are systematic."""
    (note,) = [note for note in notes(subject) if "systematic" in note]
    assert note.startswith("the internal estimate of")


@pytest.mark.parametrize(("width", "dark"), [(390, False), (390, True), (1200, False)])
def test_the_report_in_a_browser(page: Path, tmp_path: Path, width: int, dark: bool) -> None:
    """Network closed; nothing on the console; no sideways scrolling; a table beside each figure."""
    with browser(tmp_path, width, dark) as seen:
        seen.open(page)
        assert seen.run("return document.documentElement.scrollWidth") <= width
        assert seen.run("return document.querySelectorAll('figure svg').length") == 3
        assert seen.run("return document.querySelectorAll('figure + details table').length") == 3
        assert seen.run("return getComputedStyle(document.body).backgroundColor") == (
            "rgb(20, 23, 27)" if dark else "rgb(255, 255, 255)"
        )
        assert seen.run(
            "return [...document.querySelectorAll('svg')].every(s => s.getAttribute('aria-label'))"
        )
        assert seen.complaints() == []


def test_the_page_is_not_where_its_numbers_go(subject: Subject, tmp_path: Path) -> None:
    """Both files or none."""
    (tmp_path / "r.json").mkdir()
    with pytest.raises(OSError, match="is a folder"):
        write_report(subject, tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_dollars_in_names_are_dollars(subject: Subject, tmp_path: Path) -> None:
    tree = subject.tree
    odd = replace(tree, joints=(replace(tree.joints[0], name="a$\\foo_{$"), *tree.joints[1:]))
    recording = replace(subject.recording, names=odd.names)
    write_report(replace(subject, tree=odd, recording=recording, unseen=None), tmp_path / "r.html")
    assert "a$\\foo_{$" in (tmp_path / "r.html").read_text()


def test_growth_ends_at_the_estimate(outcome: Run) -> None:
    """With the run's own settings."""
    settings = replace(outcome.settings, cutoff=3.0, deadband=0.1)
    known: dict[str, Any] = {"zeros": True, "settings": settings}
    grown = growth(outcome.tree, outcome.recording, "internal", [5.0, 99.0], **known)
    whole = tb.identify(outcome.tree, outcome.recording, "internal", **known)
    np.testing.assert_array_equal(grown.values[-1], whole.values)
    assert grown.time[-1] == outcome.recording.time[-1]


def test_a_broken_mesh_is_left_out(tmp_path: Path) -> None:
    text = (GOLDEN / "robots/pendulum.urdf").read_text()
    (tmp_path / "bad.stl").write_bytes(b"no mesh at all")
    visual = '<visual><geometry><mesh filename="bad.stl"/></geometry></visual>'
    box = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
    name = re.findall(r'<link name="(\w+)"', text)[-1]
    text = text.replace(f'<link name="{name}">', f'<link name="{name}">{visual}{box}')
    (tmp_path / "r.urdf").write_text(text)
    tree = tb.load_tree(tmp_path / "r.urdf")
    assert [shape.kind for shape in load_shapes(tmp_path / "r.urdf", tree).shapes] == ["box"]


def test_no_rows_at_all_is_said(puma: tb.Tree, puma_recording: tb.Recording) -> None:
    with pytest.raises(UnseenParameters, match="0 samples determine only 0"):
        tb.identify(puma, puma_recording, "internal", settings=Settings(deadband=1e3))


def test_hostile_names_stay_text(subject: Subject, tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script>"
    write_report(replace(subject, title=hostile, claim=hostile), tmp_path / "r.html")
    assert "<script" not in (tmp_path / "r.html").read_text()


def test_a_run_is_read_as_it_was_written(outcome: Run, tmp_path: Path) -> None:
    write_run(outcome, tmp_path / "run")
    again = read_run(tmp_path / "run")
    np.testing.assert_array_equal(
        again.estimates["external"].values, outcome.estimates["external"].values
    )
    np.testing.assert_array_equal(
        again.estimates["internal"].sigma, outcome.estimates["internal"].sigma
    )
    with pytest.raises(ExperimentError, match="is no run folder: it has no experiment.toml"):
        read_run(tmp_path)
