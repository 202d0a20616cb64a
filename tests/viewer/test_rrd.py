"""What is in the files for Rerun, read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from testbed.experiment.growth import growing_errors, growth
from testbed.experiment.matrix_errors import MatrixErrors
from testbed.identification.estimate import METHODS
from testbed.identification.torque_constants import DriveEstimate
from testbed.robot.visuals.appearance import bounds
from testbed.viewer.constant_bars import TALL, largest, log_constants
from testbed.viewer.curves import tick
from testbed.viewer.heat_map import CELL, log_matrix, picture
from testbed.viewer.log import write_rrd
from testbed.viewer.robot_drawing import ARROW
from testbed.viewer.scene import Scene, means, scene_of
from tests.helpers.ideal import ideal
from tests.helpers.paths import ROOT
from tests.helpers.runs import noisy, robot, run_of, without
from tests.helpers.viewer import columns, entities, words

pytestmark = pytest.mark.slow

SCALARS = "Scalars:scalars"


def test_every_sample_of_the_signals_is_in_the_file(scene: Scene, rrd: Path) -> None:
    for signal in scene.predictions.signals:
        for c, channel in enumerate(signal.channels):
            found = columns(rrd, f"/{signal.kind}/{channel}", SCALARS).reshape(-1, 3)
            every = [signal.measured, *(signal.predicted[method] for method in METHODS)]
            np.testing.assert_array_equal(found, np.column_stack([each[:, c] for each in every]))
    position = columns(rrd, "/position", SCALARS).reshape(-1, 3)
    np.testing.assert_array_equal(position, scene.run.recording.position)


def test_curves_that_agree_are_all_seen(scene: Scene, rrd: Path) -> None:
    """One over the other, each is wider than those above it."""
    paths = [f"/{kind}{s.kind}/{c}" for s in scene.smooth.signals for c in s.channels
             for kind in ("", "residual/")]  # fmt: skip
    for path in paths:
        widths = columns(rrd, path, "SeriesLines:widths", static=True)
        assert len(widths) >= 2
        assert (np.diff(widths) <= -1.0).all()


def test_residuals_are_the_smoothed_ones(scene: Scene, rrd: Path) -> None:
    for signal in scene.smooth.signals:
        for c, channel in enumerate(signal.channels):
            found = columns(rrd, f"/residual/{signal.kind}/{channel}", SCALARS).reshape(-1, 2)
            every = [signal.residual(method)[:, c] for method in METHODS]
            np.testing.assert_array_equal(found, np.column_stack(every))


def test_the_arrows_are_the_measured_reaction(scene: Scene, rrd: Path) -> None:
    assert scene.wrench is not None
    wrench = means(scene.wrench, round(scene.run.recording.rate / 50))
    for name, vectors in (("force", wrench[:, :3]), ("moment", wrench[:, 3:])):
        found = columns(rrd, f"/world/bedplate/{name}", "Arrows3D:vectors").reshape(-1, 3)
        scale = ARROW * scene.appearance.reach / np.linalg.norm(vectors, axis=1).max()
        np.testing.assert_allclose(found, vectors * scale, rtol=1e-5, atol=1e-6)


def test_the_arrows_stand_clear_of_the_plate(scene: Scene, rrd: Path) -> None:
    """Beside everything that stands on the bedplate, where nothing hides them."""
    for name in ("force", "moment"):
        origins = columns(rrd, f"/world/bedplate/{name}", "Arrows3D:origins").reshape(-1, 3)
        np.testing.assert_allclose(
            origins, np.tile(scene.appearance.corner, (len(origins), 1)), rtol=1e-6
        )
        for shape in scene.appearance.shapes:
            low, high = bounds(shape)
            if shape.body < 0:
                assert (origins[:, 0] > high[0]).all()
                assert (origins[:, 1] < low[1]).all()


def test_the_file_has_a_blueprint_and_one_timeline(rrd: Path) -> None:
    reader = RrdReader(str(rrd))
    assert len(reader.blueprints()) == 1
    schema = reader.store(store=reader.recordings()[0]).schema()
    assert [column.name for column in schema.index_columns()] == ["time"]


def test_the_robot_in_the_file_stands_as_it_stood(scene: Scene, rrd: Path) -> None:
    """Rotations read back from the file against Pinocchio's frames."""
    model = pin.buildModelFromUrdf(str(ROOT / "models/puma562.urdf"))
    data = model.createData()
    shown = scene.motion.q[scene.frames]
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


def test_runs_stand_side_by_side(scene: Scene, tmp_path: Path) -> None:
    again = replace(scene, predictions=replace(scene.predictions, run=replace(scene.run, name="b")))
    write_rrd([scene, again], tmp_path / "two.rrd")
    for run in ("run1", "run2"):
        assert len(columns(tmp_path / "two.rrd", f"/{run}/wrench/Fz", SCALARS))


def test_estimates_are_shown_by_their_errors_a_body_a_plot(scene: Scene, rrd: Path) -> None:
    """In percent; every minimal parameter once; the curves carry their names."""
    for method in METHODS:
        run, grown = scene.run, scene.growth[method]
        names, seen = run.estimates[method].names, []
        errors = 100 * growing_errors(run, method, grown)
        for body, members in scene.bodies(method).items():
            path = f"/estimate/{method}/{body + 1}"
            found = columns(rrd, path, SCALARS).reshape(-1, len(members))
            there = np.isfinite(errors[:, members]).all(axis=1)
            np.testing.assert_array_equal(found, errors[there][:, members])
            assert words(rrd, path, "SeriesLines:names") == [names[k] for k in members]
            seen += members
        assert sorted(seen) == list(range(len(run.estimates[method].base.names)))


def test_friction_is_drawn_to_scale_and_its_axes_say_which(scene: Scene, rrd: Path) -> None:
    rest, speed = scene.predictions.unexplained_torque, scene.motion.qd
    assert rest is not None
    for j, name in enumerate(scene.run.tree.names):
        width, height = scene.friction_axes(j)
        assert (width, height) == (np.abs(speed[:, j]).max(), np.abs(rest[:, j]).max())
        points = columns(rrd, f"/friction/{name}/points", "Points2D:positions", static=True)
        points = points.reshape(-1, 2)
        step = len(rest) // 2000
        np.testing.assert_allclose(points[:, 0] * width, speed[::step, j], atol=1e-5 * width)
        np.testing.assert_allclose(-points[:, 1] * height, rest[::step, j], atol=1e-5 * height)
        ticks = columns(rrd, f"/friction/{name}/axes/ticks", "Points2D:positions", static=True)
        labels = words(rrd, f"/friction/{name}/axes/ticks", "Points2D:labels")
        assert [label.split(" ", 1)[1] for label in labels] == ["rad/s", "rad/s", "N m", "N m"]
        values = [float(label.split()[0]) for label in labels]
        x, y = ticks.reshape(-1, 2).T
        np.testing.assert_allclose([*(x[:2] * width), *(-y[2:] * height)], values, rtol=1e-5)


@pytest.mark.parametrize(
    ("end", "round_value"),
    [(1.0, 1.0), (1.9, 1.0), (2.0, 2.0), (4.9, 2.0), (5.0, 5.0), (0.03, 0.02), (700.0, 500.0)],
)
def test_ticks_are_round_and_within_the_axis(end: float, round_value: float) -> None:
    assert tick(end) == pytest.approx(round_value)


@pytest.mark.parametrize("lacks", ["wrench", "torque"])
@pytest.mark.parametrize("name", ["ur5", "gantry"])
def test_what_was_not_measured_is_not_in_the_file(lacks: str, name: str, tmp_path: Path) -> None:
    run = run_of(robot(name), without(noisy(ideal(robot(name))), lacks))
    path = tmp_path / "one.rrd"
    write_rrd([scene_of(run, growth(run, [5.0]))], path)
    there = entities(path)
    kinds = {entity.split("/")[1] for entity in there if entity.count("/") > 1}
    other = {"wrench": "torque", "torque": "wrench"}[lacks]
    assert other in kinds
    assert not {lacks, "friction"} & kinds
    assert any(entity.startswith("/world/bedplate/force") for entity in there) == (
        lacks == "torque"
    )


def test_a_recording_without_forces_still_shows_the_robot(tmp_path: Path) -> None:
    run = run_of(robot("puma"), replace(ideal(robot("puma")), wrench=None, torque=None))
    path = tmp_path / "still.rrd"
    write_rrd([scene_of(run, growth(run))], path)
    assert "/world/robot/3" in entities(path)
    assert "no estimate could be made" in words(path, "/notes", "TextDocument:text")[0]


def test_constants_and_the_matrix_are_in_the_file(scene: Scene, tmp_path: Path) -> None:
    """What the notes say in words: bars as long as two sigma, cells as dark as they are wrong."""
    drives = [
        DriveEstimate(joint, constant, sigma, (), 0.1, "N m", 100)
        for joint, constant, sigma in (("waist", 1.08, 2e-3), ("elbow", 0.96, 5e-3))
    ]
    rng = np.random.default_rng(0)
    matrix = MatrixErrors(rng.normal(size=(6, 6)), 0.1 * rng.uniform(size=(6, 6)))
    path = tmp_path / "drives.rrd"
    stream = rr.RecordingStream("testbed", recording_id="drives")
    stream.save(path)
    log_constants(stream, drives, "/constants")
    log_matrix(stream, matrix, "/plate")
    stream.flush()
    stream.disconnect()
    strips = columns(path, "/constants/bars", "LineStrips2D:strips", static=True).reshape(-1, 2, 2)
    scale = TALL / largest(drives)
    for bar, drive in zip(strips[::3], drives, strict=True):
        low, high = sorted(-bar[:, 1] / scale + 1)
        np.testing.assert_allclose(
            [low, high], drive.constant + np.array([-2, 2]) * drive.sigma, atol=1e-6
        )
    said = words(path, "/plate/before/numbers", "Points2D:labels")
    np.testing.assert_allclose([float(each) for each in said], matrix.error.ravel(), rtol=0.06)
    brightness = picture(matrix.error, matrix.most)[::CELL, ::CELL].sum(axis=2)
    order = np.argsort(np.abs(matrix.error).ravel())
    assert (np.diff(brightness.ravel()[order].astype(int)) <= 0).all()
    assert picture(matrix.sigma, matrix.most).sum() > picture(matrix.error, matrix.most).sum()
