"""Forces asked before every step: friction of any law, none of which reaches the plate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.excitation.fourier import Fourier
from testbed.robot.model_file import ModelFile
from testbed.simulation.build import build_plant
from testbed.simulation.effect import StepForces
from testbed.simulation.rollout import Rollout, Task, simulate_motion, simulate_motions
from testbed.simulation.sampled_loop import Sampling
from tests.helpers.paths import ROOT
from tests.helpers.robots import random_robot

STEP = 2.5e-4
MEANS, INSTANTS = Sampling(500.0, 8, True, 0.1), Sampling(500.0, 8, False, 0.1)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> tuple[tb.Tree, Path, Fourier]:
    path = tmp_path_factory.mktemp("robot") / "robot.xml"
    made = random_robot(np.random.default_rng(11), 3)
    path.write_text(made.mjcf())
    rng = np.random.default_rng(2)
    motion = Fourier(0.5, np.zeros(3), *(0.2 * rng.normal(size=(2, 3, 2))))
    return tb.load_tree(path), path, motion


def run(
    robot: tuple[tb.Tree, Path, Fourier],
    sampling: Sampling,
    forces: StepForces | None,
    viscous: float = 0.0,
) -> Rollout:
    tree, path, motion = robot
    rubbing = tree.with_joints({name: {"viscous": viscous} for name in tree.names})
    plant = build_plant(ModelFile(path), rubbing, STEP, changed=tree.names)
    return simulate_motion(plant, tree, motion, 0.6, 60.0, sampling, forces=forces)


@pytest.mark.parametrize("sampling", [MEANS, INSTANTS], ids=["means", "instants"])
def test_forces_of_zero_change_no_bit(
    sampling: Sampling, robot: tuple[tb.Tree, Path, Fourier]
) -> None:
    alone = run(robot, sampling, None).truth
    pushed = run(robot, sampling, lambda t, q, qd, motor: np.zeros(3)).truth
    for name, values in vars(alone).items():
        np.testing.assert_array_equal(getattr(pushed, name), values, err_msg=name)


@pytest.mark.parametrize("sampling", [MEANS, INSTANTS], ids=["means", "instants"])
def test_a_viscous_force_is_viscous_friction(
    sampling: Sampling, robot: tuple[tb.Tree, Path, Fourier]
) -> None:
    """To the first order of the step, over which the force is held."""
    inside = run(robot, sampling, None, viscous=2.0).truth
    outside = run(robot, sampling, lambda t, q, qd, motor: -2.0 * qd).truth
    scale = np.abs(inside.friction).max()
    assert scale > 0.1
    assert np.abs(inside.friction - outside.friction).max() < 0.02 * scale
    assert np.abs(inside.position - outside.position).max() < 1e-4


def test_no_force_at_the_joints_reaches_the_plate(
    robot: tuple[tb.Tree, Path, Fourier],
) -> None:
    """Torque less friction moves the robot, and the wrench is that of the motion alone."""
    tree = robot[0]

    def rough(time: float, q: Array, qd: Array, motor: Array) -> Array:
        return np.asarray(-1.5 * np.tanh(qd / 0.1) - 0.5 * np.sin(3 * q) + 0.3 * np.sin(40 * time))

    found = run(robot, INSTANTS, rough)
    truth = found.truth
    motion = tb.Motion(found.time, truth.position, truth.velocity, truth.acceleration)
    forces, wrench = tb.joint_forces(tree, motion), tb.base_wrench(tree, motion)
    gap = truth.torque - truth.friction - forces
    assert np.abs(gap).max() < 1e-11 * np.abs(forces).max()
    left = truth.wrench - wrench
    assert np.abs(left - left[0]).max() < 1e-11 * np.abs(wrench).max()  # the pedestal's weight
    assert np.abs(truth.friction).max() > 1.0


def test_forces_know_time_and_state(robot: tuple[tb.Tree, Path, Fourier]) -> None:
    seen: list[tuple[float, Array, Array]] = []

    def watch(time: float, q: Array, qd: Array, motor: Array) -> Array:
        seen.append((time, q.copy(), qd.copy()))
        return np.zeros(3)

    found = run(robot, MEANS, watch)
    times = np.array([time for time, _, _ in seen])
    np.testing.assert_allclose(np.diff(times), STEP, rtol=1e-6)
    first = np.searchsorted(times, -1e-9)
    assert abs(times[first]) < 1e-12
    mean = np.mean([q for _, q, _ in seen[first : first + 9]], axis=0)
    np.testing.assert_allclose(mean, found.truth.position[0], atol=1e-3)


@pytest.mark.slow
def test_friction_that_an_experiment_states_goes_before_the_model_files(
    puma: tb.Tree,
) -> None:
    """Both MuJoCo's plant, which checks itself against the tree, and the estimate know it."""
    words = [
        "motion.duration=4", "motion.candidates=2", "simulation.step=1e-3",
        "robot.joint.elbow.coulomb=4.5", "robot.joint.waist.viscous=0.0",
    ]  # fmt: skip
    run = tb.carry_out(tb.Experiment.load(ROOT / "experiments/noise_free.toml", words))
    truths = run.truths
    assert (truths["coulomb/elbow"], truths["viscous/waist"]) == (4.5, 0.0)
    assert truths["coulomb/waist"] == puma.joints[0].coulomb
    internal = run.estimates["internal"]
    found = dict(zip(internal.names, internal.values, strict=True))
    assert found["coulomb/elbow"] == pytest.approx(4.5, rel=1e-9)
    assert abs(found["viscous/waist"]) < 1e-9


def test_forces_need_a_simulation_of_their_own(robot: tuple[tb.Tree, Path, Fourier]) -> None:
    tree, path, motion = robot
    plant = build_plant(ModelFile(path), tree, STEP)
    tasks = [Task(plant, tree, motion, 60.0)] * 2
    with pytest.raises(ValueError, match="forces need a simulation of their own"):
        simulate_motions(tasks, 0.6, MEANS, forces=lambda t, q, v, motor: np.zeros(3))
