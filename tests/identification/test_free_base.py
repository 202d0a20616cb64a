"""Robots on a base that moves: what the ground's reaction tells, and a humanoid that squats."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import ModelError, RecordingError
from testbed.excitation.fourier import Fourier
from testbed.identification.predict import motion_in, predictions
from testbed.recordings.measured_base import with_base_joints
from testbed.recordings.recording import Recording
from testbed.robot.free_base import FREE, coordinates, on_free_base
from tests.helpers.command import command_line
from tests.helpers.humanoid import G1, humanoid, squatting
from tests.helpers.robots import random_robot


def rows_by_pinocchio(model: pin.Model, seed: int, states: int) -> Array:
    """Rows of a free root on all standard parameters at random states: no code of ours."""
    rng, data, rows = np.random.default_rng(seed), model.createData(), []
    for _ in range(states):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
        v, a = rng.uniform(-3, 3, (2, model.nv))
        rows.append(pin.computeJointTorqueRegressor(model, data, q, v, a)[:6].copy())
    return np.concatenate(rows)


def rank(rows: Array) -> int:
    size = np.linalg.norm(rows, axis=0)
    return int(np.linalg.matrix_rank(rows / np.where(size > 0, size, 1.0), tol=1e-8))


@pytest.mark.parametrize("seed", range(20))
def test_the_minimal_set_is_as_large_as_pinocchios_rank(seed: int) -> None:
    """On random trees, revolute and prismatic joints mixed; under gravity and without it."""
    rng = np.random.default_rng(4000 + seed)
    robot = random_robot(rng, int(rng.integers(1, 7)))
    model = pin.buildModelFromXML(robot.urdf(), pin.JointModelFreeFlyer())
    free = on_free_base(robot.tree())
    sliding = sum(not joint.revolute for joint in robot.tree().joints)
    for gravity in (free.gravity, np.zeros(3)):
        model.gravity.linear = gravity
        found = tb.minimal_set(free.with_gravity(gravity), "reaction")
        assert found.count == rank(rows_by_pinocchio(model, seed, 10 + 2 * free.n))
        assert found.count == 10 + 7 * robot.tree().n - 3 * sliding


def test_a_humanoid_has_as_many_parameters_as_its_rank() -> None:
    tree = tb.load_tree(G1, weld_root=True)
    model = pin.buildModelFromUrdf(str(G1), pin.JointModelFreeFlyer())
    found = tb.minimal_set(on_free_base(tree), "reaction")
    assert found.count == rank(rows_by_pinocchio(model, 0, 60)) == 10 + 7 * 29 == 213


def test_the_grounds_wrench_is_pinocchios() -> None:
    tree, recording = humanoid(3.0, 100.0, 1, 0.0)
    free = on_free_base(tree)
    path = squatting(tree, 1).at(recording.time)
    assert recording.wrench is not None
    ours = tb.base_wrench(free, path)
    np.testing.assert_allclose(ours, recording.wrench, atol=2e-5)
    np.testing.assert_allclose(with_base_joints(recording).position, path.q, atol=1e-12)


@pytest.mark.slow
def test_a_squatting_humanoid_is_estimated_within_three_sigma() -> None:
    tree, recording = humanoid(40.0, 50.0, 2, 1.0)
    free = on_free_base(tree)
    found = tb.identify(free, recording)
    assert len(found.names) == 213
    z = (found.values - found.minimal.values(tb.barycentric(free))) / found.sigma
    assert np.mean(np.abs(z) <= 3) >= 0.99  # of normal errors .9973
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.2  # single motions have .84 to 1.18
    assert np.abs(z).max() < 4.0  # 99 % of the largest of 213 normal ones
    mass = found.names.index("mbar6")
    assert found.values[mass] == pytest.approx(sum(b.mass for b in free.inertias), rel=1e-3)


TWO_PLATES = """
rate = 50
joints = [JOINTS]
[sources.robot]
file = "robot.npz"
time = "time"
time_unit = "s"
[sources.left]
file = "left.npz"
time = "time"
time_unit = "s"
[sources.right]
file = "right.npz"
time = "time"
time_unit = "s"
[position]
source = "robot"
columns = [COLUMNS]
unit = "rad"
[base]
source = "robot"
position = ["pose[0]", "pose[1]", "pose[2]"]
unit = "mm"
quaternion = ["pose[6]", "pose[3]", "pose[4]", "pose[5]"]
[plates.left]
source = "left"
columns = ["w[0]", "w[1]", "w[2]", "w[3]", "w[4]", "w[5]"]
units = ["N", "N mm"]
sense = "on_robot"
place = { xyz = [0.0, 0.2, -0.05], rpy = [0, 0, 1.5707963267948966] }
tare = [0, 0, 0, 0, 0, 0]
[plates.right]
source = "right"
columns = ["w[0]", "w[1]", "w[2]", "w[3]", "w[4]", "w[5]"]
units = ["N", "N m"]
sense = "on_plate"
place = { xyz = [0.1, -0.2, 0.0], rpy = [3.141592653589793, 0, 0] }
"""


def on_plate(wrench: Array, xyz: Array, turn: Array) -> Array:
    """What a plate at a place shows of a wrench about the ground's origin."""
    force = wrench[:, :3] @ turn
    moment = (wrench[:, 3:] - np.cross(xyz, wrench[:, :3])) @ turn
    return np.hstack([force, moment])


def two_plates(recording: Recording, folder: Path) -> None:
    """The humanoid's files as loggers write them: millimetres, x y z w, either sign of the turn."""
    base, wrench = recording.measured("base"), recording.measured("wrench")
    share = 0.5 + 0.3 * np.sin(recording.time)[:, None]
    left, right = share * wrench, (1 - share) * wrench
    flips = np.where(np.arange(len(base)) % 7 < 3, -1.0, 1.0)[:, None]
    pose = np.hstack([1e3 * base[:, :3], flips * base[:, [4, 5, 6, 3]]])
    np.savez(folder / "robot.npz", time=recording.time, q=recording.position, pose=pose)
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    shown = on_plate(left, np.array([0.0, 0.2, -0.05]), turned) * ([1.0] * 3 + [1e3] * 3)
    np.savez(folder / "left.npz", time=recording.time, w=shown)
    shown = -on_plate(right, np.array([0.1, -0.2, 0.0]), np.diag([1.0, -1, -1]))
    np.savez(folder / "right.npz", time=recording.time, w=shown)
    joints = ", ".join(f'"{name}"' for name in recording.names)
    columns = ", ".join(f'"q[{k}]"' for k in range(len(recording.names)))
    text = TWO_PLATES.replace("[JOINTS]", f"[{joints}]").replace("[COLUMNS]", f"[{columns}]")
    (folder / "g1.toml").write_text(text)


def test_two_plates_and_a_pose_are_imported(tmp_path: Path) -> None:
    _, recording = humanoid(4.0, 50.0, 3, 0.0)
    two_plates(recording, tmp_path)
    found = Recording.from_mapping(tmp_path / "g1.toml")
    found.save(tmp_path / "g1.parquet")
    again = Recording.load(tmp_path / "g1.parquet")
    assert again.base is not None
    assert again.units()["base/x"] == "m"
    inner = slice(20, recording.samples - 20)
    np.testing.assert_allclose(
        again.measured("wrench")[inner], recording.measured("wrench")[inner], atol=1e-6
    )
    theirs = coordinates(recording.measured("base"))
    np.testing.assert_allclose(coordinates(again.base)[inner], theirs[inner], atol=1e-9)


@pytest.mark.slow
def test_one_command_identifies_a_humanoid_on_two_plates(tmp_path: Path) -> None:
    tree, recording = humanoid(40.0, 50.0, 4, 1.0)
    two_plates(recording, tmp_path)
    words = ("identify", "g1.toml", "--model", str(G1), "--set", "robot.base=measured", "--json")
    done = command_line(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)["external"]
    free = on_free_base(tree)
    truth = tb.minimal_set(free, "reaction").values(tb.barycentric(free))
    z = (np.array(said["values"]) - truth) / np.array(said["sigma"])
    assert np.mean(np.abs(z) <= 3) >= 0.99
    assert np.sqrt(np.mean(z**2)) < 1.2


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_predictions_are_the_grounds_wrench(seed: int) -> None:
    """Weight and all: of random trees, along a motion that the estimate has not seen."""
    rng = np.random.default_rng(6000 + seed)
    free = on_free_base(random_robot(rng, 3).tree())
    paths = [small(free, rng).at(np.arange(0, 20, 0.01)) for _ in range(2)]
    seen, other = (
        Recording(free.names, p.t, p.q, wrench=tb.base_wrench(free, p), tare=np.zeros(6))
        for p in paths
    )
    estimate = tb.identify(free, seen)
    motion, inner = motion_in(other)
    found = predictions(free, other, motion, {"external": estimate})[0]["external"]
    np.testing.assert_allclose(found, other.measured("wrench")[inner], atol=1e-3)


def small(tree: tb.Tree, rng: np.random.Generator) -> Fourier:
    """The base sways, joints move."""
    size = np.where(np.arange(tree.n) < FREE, 0.05, 0.3)[:, None]
    return Fourier(0.1, np.zeros(tree.n), *(size * rng.normal(size=(2, tree.n, 8))))


def test_what_is_no_pose_is_refused() -> None:
    tree, recording = humanoid(0.5, 100.0, 5, 0.0)
    free = on_free_base(tree)
    base = recording.measured("base").copy()
    with pytest.raises(RecordingError, match="w, x, y, z"):
        coordinates(base * 2)
    base[:, 3:] = [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]
    with pytest.raises(RecordingError, match="80 degrees"):
        coordinates(base)
    lacking = Recording(
        recording.names, recording.time, recording.position, wrench=recording.wrench
    )
    with pytest.raises(RecordingError, match="base"):
        tb.identify(free, lacking)
    with pytest.raises(ModelError, match=r"base\.x"):
        on_free_base(free)
