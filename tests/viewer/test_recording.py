"""What is in the files for Rerun, read back."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.bodies.shapes.appearance import load_appearance
from testbed.bodies.shapes.shapes import Shape, shape_bounds
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import ViewerError
from testbed.core.parameters.rules import SIGNALS
from testbed.view.viewer.blueprint import runs_blueprint
from testbed.view.viewer.curves import INTERVAL_RATE, MIN_INTERVAL_SAMPLES, interval_extremes
from testbed.view.viewer.live import LiveViewer, become_viewer, serve_viewer
from testbed.view.viewer.log import write_motion_rrd, write_runs_rrd
from testbed.view.viewer.robot_drawing import MAX_ARROW_SHARE
from testbed.view.viewer.scene import Scene, block_means, build_scene, pressure
from tests.helpers.pages import checked, run_named
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.refusals import refuses
from tests.helpers.strategies import rngs
from tests.helpers.viewer import columns, free_port, tree

SCALARS = "Scalars:scalars"
slow = pytest.mark.slow


@cache
def scene(name: str) -> Scene:
    return build_scene(run_named(name))


@cache
def rrd(name: str) -> Path:
    path = Path(mkdtemp()) / f"{name}.rrd"
    write_runs_rrd([scene(name)], path)
    return path


@slow
def test_signals_predictions_and_residuals_are_in_the_file() -> None:
    """Curves one over the other are all seen."""
    shown, path = scene("ur5"), rrd("ur5")
    for found, at in ((shown.predictions, ""), (shown.smoothed_predictions, "/residual")):
        for channel in found.channels:
            every = [channel.residuals[m] for m in SIGNALS] if at else [
                channel.measured, *(channel.predicted[m] for m in SIGNALS)
            ]  # fmt: skip
            place = f"{at}/{channel.kind}/{channel.name}"
            written = columns(path, place, SCALARS).reshape(-1, len(every))
            _, wanted = interval_extremes(found.motion.t, np.column_stack(every))
            np.testing.assert_array_equal(written, wanted)
            widths = columns(path, place, "SeriesLines:widths", static=True)
            assert (np.diff(widths) <= -1.0).all()
    written = columns(path, "/position", SCALARS).reshape(-1, shown.run.tree.n)
    recording = shown.run.recording
    np.testing.assert_array_equal(written, interval_extremes(recording.time, recording.position)[1])


@given(rngs, st.floats(10, 3000), st.integers(2, 5000))
def test_what_is_thinned_looks_the_same(rng: np.random.Generator, rate: float, count: int) -> None:
    """Spikes stay; a value is of its moment, that of a rising curve exactly; of slow ones all."""
    time = 7.0 + np.arange(count) / rate
    values = np.column_stack([rng.normal(size=(count, 2)), np.arange(count)])
    values[rng.integers(count), 0] = -1e6
    instants, shown = interval_extremes(time, values)
    assert (
        len(shown)
        == len(instants)
        <= max(2 * MIN_INTERVAL_SAMPLES * INTERVAL_RATE, 2.6 * INTERVAL_RATE) * count / rate + 4
    )
    for end in (np.min, np.max):
        np.testing.assert_array_equal(end(shown, axis=0), end(values, axis=0))
    np.testing.assert_array_equal(time[shown[:, 2].astype(int)], instants)
    if rate < MIN_INTERVAL_SAMPLES * INTERVAL_RATE:
        assert len(shown) == count
    else:
        step = 1 / INTERVAL_RATE + 1 / rate
        for k in range(0, len(shown), 7):
            near = np.abs(time - instants[k]) <= step
            assert np.isin(shown[k], values[near]).all()


def assert_stands(path: Path, urdf: Path, motion: Array, names: tuple[str, ...]) -> None:
    """Bodies in a file are where Pinocchio's frames are."""
    model = pin.buildModelFromUrdf(str(urdf))
    data, order = model.createData(), [list(model.names)[1:].index(name) for name in names]
    for j, name in enumerate(names):
        place = columns(path, f"/world/robot/{j + 1}", "Transform3D:translation").reshape(-1, 3)
        turn = columns(path, f"/world/robot/{j + 1}", "Transform3D:quaternion").reshape(-1, 4)
        assert len(place) == len(motion)
        for k in range(0, len(motion), 97):
            q = np.empty(model.nq)
            q[order] = motion[k]
            pin.forwardKinematics(model, data, q)
            frame = data.oMi[model.getJointId(name)]
            np.testing.assert_allclose(place[k], frame.translation, atol=1e-6)
            there = pin.Quaternion(turn[k]).toRotationMatrix()
            np.testing.assert_allclose(there, frame.rotation, atol=1e-6)


@slow
def test_the_robot_stands_as_it_stood_and_the_arrows_are_the_measured_reaction() -> None:
    """Beside everything on the bedplate, where nothing hides them; shapes in place and colour."""
    shown, path = scene("ur5"), rrd("ur5")
    run = shown.run
    assert_stands(
        path, GOLDEN / "robots/ur5.urdf", shown.motion.q[shown.pose_samples], run.tree.names
    )
    assert shown.pose_samples.step == round(run.recording.rate / 50)
    assert shown.wrench is not None
    wrench, look = block_means(shown.wrench, round(run.recording.rate / 50)), shown.appearance
    for name, vectors in (("force", wrench[:, :3]), ("moment", wrench[:, 3:])):
        found = columns(path, f"/world/bedplate/{name}", "Arrows3D:vectors").reshape(-1, 3)
        scale = MAX_ARROW_SHARE * look.reach / np.linalg.norm(vectors, axis=1).max()
        np.testing.assert_allclose(found, vectors * scale, rtol=1e-5, atol=1e-6)
        origins = columns(path, f"/world/bedplate/{name}", "Arrows3D:origins").reshape(-1, 3)
        for low, high in (shape_bounds(shape) for shape in look.shapes if shape.body < 0):
            assert ((origins[:, 0] > high[0]) & (origins[:, 1] < low[1])).all()
    for k, shape in enumerate(look.shapes):
        part = f"robot/{shape.body + 1}" if shape.body >= 0 else "bedplate"
        at, solid = f"/world/{part}/shape{k}", {"box": "Boxes3D", "cylinder": "Cylinders3D"}
        begins = shape.kind == "capsule"  # at one end; others have centres
        kind, place = ("Capsules3D", "translations") if begins else (solid[shape.kind], "centers")
        found = columns(path, at, f"{kind}:{place}", static=True)
        half = begins * shape.rotation[:, 2] * shape.size[-1]
        np.testing.assert_allclose(found.ravel(), shape.position - half, atol=1e-6)
        (colour,) = columns(path, at, f"{kind}:colors", static=True)
        seen = int(colour) >> np.array([24, 16, 8, 0]) & 255
        np.testing.assert_allclose(seen, 255 * shape.colour, atol=1)


@slow
def test_bodies_that_can_exist_hang_on_their_links_with_the_estimates_size() -> None:
    """Model file, truth and estimate one in the other, each with its own second moments."""
    run, path = run_named("bodies"), rrd("bodies")
    assert run.consistent is not None
    for j, own in enumerate(run.consistent.standard):
        place = f"/world/robot/{j + 1}/body"
        assert {f"{place}/{name}" for name in ("prior", "truth", "estimate")} & set(tree(path))
        half = columns(path, f"{place}/estimate", "Ellipsoids3D:half_sizes", static=True)
        centre = columns(path, f"{place}/estimate", "Ellipsoids3D:centers", static=True).ravel()
        np.testing.assert_allclose(centre * own[0], own[1:4], atol=1e-5)
        trace = own[[4, 6, 9]].sum() / 2 - own[1:4] @ own[1:4] / own[0]  # about the centre
        assert own[0] * (half**2).sum() / 5 == pytest.approx(trace, rel=1e-3)


@slow
def test_what_was_not_measured_is_not_in_the_file_and_runs_stand_side_by_side(
    tmp_path: Path,
) -> None:
    write_runs_rrd([scene("half"), scene("silent")], tmp_path / "two.rrd")
    entities = tree(tmp_path / "two.rrd")
    first = {entity.split("/")[2] for entity in entities if entity.startswith("/run1/")}
    assert "torque" in first
    assert "wrench" not in first
    assert not [entity for entity in entities if "/force" in entity]
    assert "/run2/world/robot/3" in entities


@slow
def test_notes_say_every_warning_and_names_are_no_markup() -> None:
    hostile = scene("hostile")
    assert "<script" not in hostile.notes.replace("\\<script", "")
    assert scene("ur5").notes.count("\n- ") == len(sentences(run_named("ur5").diagnostics))
    for name in run_named("plate").tree.names:
        assert f"| {name} |" in scene("plate").notes


@slow
def test_a_motion_is_shown_with_no_less_left_than_is_proven(tmp_path: Path) -> None:
    found = checked()
    half, centre = np.array([0.1, 0.2, 0.5]), np.array([1.0, 0, 0.5])
    box = Shape(-1, "box", half, centre, np.eye(3), np.ones(4))
    look, path = load_appearance(found.rules.tree), tmp_path / "motion.rrd"
    write_motion_rrd(path, found.motion, found.rules, found.proof, look, (box,))
    left = columns(path, "/left/1", SCALARS)
    proven = 100 * min(m.left for m in found.proof.margins if m.label.startswith("velocity"))
    assert proven <= left.min() <= proven + 1.0
    size = columns(path, "/world/obstacles", "Boxes3D:half_sizes", static=True)
    np.testing.assert_allclose(size.ravel(), box.size, rtol=1e-6)
    motion = found.motion.at(np.linspace(0, found.motion.period, len(left))).q
    assert_stands(path, ROOT / "models/puma562.urdf", motion, found.rules.tree.names)


@given(rngs)
def test_the_centre_of_pressure_balances_the_moments(rng: np.random.Generator) -> None:
    force, point = rng.normal(size=(20, 3)), rng.normal(size=(20, 2))
    force[:, 2] = 1 + np.abs(force[:, 2])
    wrench = np.column_stack([force, np.cross(np.column_stack([point, np.zeros(20)]), force)])
    np.testing.assert_allclose(pressure(wrench), point, atol=1e-9)
    assert np.isnan(pressure(wrench * np.array([1, 1, -1, 1, 1, 1]))).all()  # pulled


SIDES = ("start", "end")


def views(part: Any) -> Iterator[Any]:
    """All views of a blueprint's part."""
    inner = getattr(part, "contents", None)
    if isinstance(inner, list | tuple):
        for each in inner:
            yield from views(each)
    else:
        yield part


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", "plate", "half"])
def test_every_view_looks_at_something_and_has_its_unit(name: str) -> None:
    """All are opened on the same seconds."""
    shown, there = scene(name), tree(rrd(name))
    page = runs_blueprint([shown])
    for view in views(page.root_container):
        assert any(f"{at}/".startswith(f"{view.origin}/") for at in there), view.origin
        if view.origin.startswith(("/wrench", "/torque", "/residual")):
            assert "[" in view.name
    start, end = shown.time_window
    assert start == shown.run.recording.time[0]
    assert 0 < end - start <= 10.0
    for view in views(page.root_container):
        if view.origin.startswith(("/wrench", "/torque")):
            (seen,) = view.properties["TimeAxis"].view_range.pa_array.to_pylist()
            ends = [float(x["value"] if isinstance(x, dict) else x) for x in map(seen.get, SIDES)]
            np.testing.assert_allclose(ends, [1e9 * start, 1e9 * end], atol=1e3)


@pytest.mark.parametrize("screen", ["DISPLAY", "WAYLAND_DISPLAY", ""])
def test_the_viewer_is_started_for_this_machine_alone_where_there_is_a_screen(
    screen: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rerun beside Python, else that of the path; a page for a browser needs no screen."""
    started: list[tuple[str, list[str]]] = []
    environments: list[dict[str, str]] = []

    def started_as(program: str, command: list[str], environment: dict[str, str]) -> None:
        started.append((program, command))
        environments.append(environment)

    monkeypatch.setattr(os, "execve", started_as)
    for folder in ("beside", "path"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "rerun").touch(mode=0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "beside/python"))
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if screen:
        monkeypatch.setenv(screen, "0")
        become_viewer(Path("run.rrd"))
    else:
        with refuses(ViewerError, "run.rrd"):
            become_viewer(Path("run.rrd"))
    serve_viewer(Path("run.rrd"), 9123)
    (tmp_path / "beside/rerun").unlink()
    serve_viewer(Path("run.rrd"), 9123)
    (tmp_path / "path/rerun").unlink()
    with refuses(ViewerError, "rerun"):
        serve_viewer(Path("run.rrd"), 9123)
    programs = [str(tmp_path / at / "rerun") for at in ("beside", "path")]
    assert [program for program, _ in started] == [programs[0]] * bool(screen) + programs
    assert all(each["CI"] and "FORCE_RERUN_ANALYTICS" not in each for each in environments)
    for _, command in started:
        assert command[:2] == ["rerun", "run.rrd"]
        assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert started[-1][1][command.index("--web-viewer-port") + 1] == "9123"


@pytest.mark.slow
def test_a_viewer_that_is_not_there_is_named_by_its_port() -> None:
    port = free_port()
    with refuses(ViewerError, str(port)):
        LiveViewer("run", scene("silent").appearance, port)
