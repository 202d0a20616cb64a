"""The plant is the robot that was read, and its plate feels what Newton and Euler say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ModelError
from testbed.core.recordings.recording import Truth
from testbed.core.robot.model_file import ModelFile
from testbed.lab.simulation.compiled_loop import motor_torque
from testbed.lab.simulation.controller import Controller, computed_torque, mass_matrices
from testbed.lab.simulation.plant import Plant, build_plant, check_plant
from testbed.lab.simulation.rollout import Sampling, SimulationDiverged, simulate_motion
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.plants import PUMA, check_laws, run, sensed, waving
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot
from tests.helpers.strategies import few, rngs, robots

WITNESS = 1e-12


@pytest.fixture(scope="module")
def plant(puma: tb.Tree) -> Plant:
    return build_plant(ModelFile(PUMA), puma, 1e-4)


@contextmanager
def written(text: str, form: str = "xml") -> Iterator[Path]:
    """A model file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"r.{form}"
        path.write_text(text)
        yield path


@few(4)
@given(robot=robots((1, 6)), form=st.sampled_from(["urdf", "xml"]))
def test_any_robot_gets_a_plate_that_feels_its_motion(robot: Robot, form: str) -> None:
    """And none of its friction: the vector equations along the motion that MuJoCo has made."""
    with written(robot.urdf() if form == "urdf" else robot.mjcf(), form) as path:
        bare = tb.load_tree(path)
        tree = bare.with_joints({name: {"coulomb": 2.0, "viscous": 0.5} for name in bare.names})
        done = run(tree, path, waving(tree.n), Sampling(500.0, 4, False, 0.0), 5e-4)
        tare = build_plant(ModelFile(path), bare, 5e-4).tare
    np.testing.assert_allclose(tare, tb.pedestal_wrench(tree), atol=1e-10)
    check_laws(tree, done.time, done.truth, WITNESS)
    assert np.abs(done.truth.friction).max() > 0.1


@few(4)
@given(rng=rngs)
def test_friction_never_reaches_the_plate_wherever_its_sensor_sits(
    rng: np.random.Generator, puma: tb.Tree, plant: Plant
) -> None:
    """The same wrench with friction and without, and of a sensor that is turned and displaced."""
    q, qd, effort = rng.uniform(-1, 1, (3, 3)) * np.array([[2.3], [2.0], [60.0]])
    qdd, friction, wrench = sensed(plant, q, qd, effort)
    assert np.abs(friction).max() > 2.0
    smooth = build_plant(ModelFile(PUMA), puma, 1e-4, with_friction=False)
    same, none, other = sensed(smooth, q, qd, effort - friction)
    assert not none.any()
    np.testing.assert_allclose(same, qdd, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(other, wrench, atol=1e-9 * np.abs(wrench).max())
    sensor = 'name="bedplate_sensor"'
    moved = PUMA.read_text().replace(sensor, f'{sensor} pos=".1 -.2 .05" euler=".4 .5 .6"')
    with written(moved) as path:
        elsewhere = build_plant(ModelFile(path), puma, 1e-4)
    there = sensed(elsewhere, q, qd, effort)[2]
    np.testing.assert_allclose(there, wrench, atol=1e-11 * np.abs(wrench).max())


def test_a_plant_that_is_not_the_robot_that_was_read_is_refused(
    puma: tb.Tree, plant: Plant
) -> None:
    """A hundred thousandth of a mass is enough; friction, rotor, tare, spring, fluid as well."""
    joint, name = 1, puma.names[1]
    check_plant(plant, puma, PUMA)
    for loss in ({"coulomb": 5.0}, {"viscous": 4.0}):
        with refuses(ModelError, f"'{name}'"):
            check_plant(plant, puma.with_joints({name: loss}), PUMA)
    more = tb.Inertia(1e-5 * puma.inertias[joint].mass, np.zeros(3), np.zeros((3, 3)))
    rotor = puma.with_joints({name: {"rotor_inertia": puma.joints[joint].rotor_inertia + 1e-4}})
    for tree in (rotor, puma.with_inertia(joint, more)):
        with refuses(ModelError, PUMA.name):
            check_plant(plant, tree, PUMA)
    with refuses(ModelError, "0.001"):
        check_plant(replace(plant, tare=plant.tare + 1e-3 * np.eye(6)[2]), puma, PUMA)
    other = build_plant(ModelFile(PUMA), puma, 1e-3)
    other.model.opt.density = 1.2
    with refuses(ModelError, puma.names[0]):
        check_plant(other, puma, PUMA)
    other.model.dof_damping[:] = 1e300
    with refuses(ModelError, PUMA.name):
        check_plant(other, puma, PUMA)


@few(5)
@given(robot=robots((4, 4)), friction=st.sampled_from([0.0, 0.01, 1.0]), joint=st.integers(0, 3))
def test_on_a_light_robot_a_weak_spring_is_named_and_strong_friction_is_not(
    robot: Robot, friction: float, joint: int
) -> None:
    """The plant's check of itself goes by the robot's size, here a thousandth of the usual mass.

    Else small robots are simulated with springs that no equation has, or refused for friction that
    their weight cannot overcome.
    """
    links = (
        replace(x, mass=x.mass / 1e3, xyz=x.xyz / 10, com=x.com / 10, central=x.central / 1e5)
        for x in robot.links
    )
    text = replace(robot, links=tuple(links)).mjcf()
    text = text.replace("<joint ", f'<joint frictionloss="{friction}" damping="0.01" ')
    with written(text) as path:
        tree = tb.load_tree(path)
        plant = build_plant(ModelFile(path), tree, 5e-4)
        assert plant.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        at = plant.velocity_index[joint]
        plant.model.jnt_stiffness[at], plant.model.qpos_spring[at] = 1e-3, 0.5
        with refuses(ModelError, f"'{tree.names[joint]}'"):
            check_plant(plant, tree, path)


INSTANTS = Sampling(500.0, 2, False, 0.2)


def with_all(tree: tb.Tree, **changes: object) -> tb.Tree:
    """The robot with something changed on every joint."""
    return replace(tree, joints=tuple(replace(j, **changes) for j in tree.joints))  # type: ignore[arg-type]


def torque_of(drive: Controller, k: int, position: Array, velocity: Array) -> Array:
    """Torque that the compiled control law asks of the motors."""
    found = np.zeros(len(position))
    motor_torque(drive, k, position, velocity, np.arange(len(position)), found)
    return found


@few(6)
@given(robot=robots((2, 6)), rng=rngs)
def test_a_drive_asks_for_the_models_torque_and_pulls_all_joints_back_alike(
    robot: Robot, rng: np.random.Generator
) -> None:
    """By w^2 e + 2 0.9 w e', Pinocchio's mass matrix and the rotors, within the motors' limits."""
    w, grid, n = 30.0, 500, len(robot.links)
    tree = with_all(robot.tree(), rotor_inertia=0.7, coulomb=2.0, viscous=0.3)
    motion = tb.Fourier(0.1, rng.normal(size=n), *(0.3 * rng.normal(size=(2, n, 3))))
    turns = rng.permutation(grid)[:6] + grid * np.array([0, 1, -1, 3, -2, 0])
    drive = computed_torque(tree, motion, (turns + 1e-6) / grid * motion.period, w)
    there = motion.at(drive.times)
    witness = by_pinocchio(robot.urdf(), tree, (there.q, there.qd, there.qdd))
    mass = mass_matrices(tree, there.q)
    np.testing.assert_allclose(mass, witness.mass, atol=1e-12 * np.abs(witness.mass).max())
    for k in range(6):
        alone = torque_of(drive, k, there.q[k], there.qd[k])
        dry = alone - witness.forces[k] - 0.3 * there.qd[k] - 0.7 * there.qdd[k]
        np.testing.assert_allclose(dry, 2 * np.tanh(there.qd[k] / 0.05), rtol=1e-6, atol=1e-9)
        late, slow = 0.01 * rng.normal(size=(2, n))
        added = torque_of(drive, k, there.q[k] - late, there.qd[k] - slow) - alone
        wanted = (witness.mass[k] + 0.7 * np.eye(n)) @ (w**2 * late + 2 * 0.9 * w * slow)
        np.testing.assert_allclose(added, wanted, atol=1e-4 * np.abs(wanted).max())
    weak = computed_torque(with_all(tree, max_effort=0.5), motion, there.t[:1], w)
    free = torque_of(drive, 0, there.q[0] - 1, there.qd[0])
    limited = torque_of(weak, 0, there.q[0] - 1, there.qd[0])
    np.testing.assert_array_equal(limited, np.clip(free, -0.5, 0.5))


def test_the_plate_feels_the_motion_that_the_encoders_show(puma: tb.Tree) -> None:
    """Averaged samples, smooth joints: the wrench follows from positions alone.

    The trap: an integrator that treats velocities half a step late or damping implicitly
    is wrong here by 1e-3 and more, whatever its sensors say about themselves.
    """
    done = run(puma, PUMA, waving(3), Sampling(1000.0, 2, True, 0.2), 5e-4, friction=False)
    q, rate = done.truth.position, 1000.0
    qd = (q[2:] - q[:-2]) * rate / 2
    qdd = (q[2:] - 2 * q[1:-1] + q[:-2]) * rate**2
    shown = tb.base_wrench(puma, tb.Motion(done.time[1:-1], q[1:-1], qd, qdd))
    felt = done.truth.wrench - tb.pedestal_wrench(puma)
    gap = np.sqrt(np.mean((felt[1:-1] - shown) ** 2, axis=0) / np.mean(shown**2, axis=0))
    assert gap.max() < 1e-4


def test_samples_are_instants_or_means_by_the_trapezoidal_rule(puma: tb.Tree) -> None:
    """The acceleration of a mean is what speed gained; means of five steps lie amid their ends."""
    first, mean = (
        run(puma, PUMA, waving(3), Sampling(2000.0, 1, averaged, 0.1), 5e-4, friction=False).truth
        for averaged in (False, True)
    )
    for name in ("position", "velocity"):
        values = getattr(first, name)
        between = (values[1:] + values[:-1]) / 2
        np.testing.assert_allclose(getattr(mean, name)[:-1], between, atol=1e-12)
    gain = np.diff(first.velocity, axis=0) * 2000
    np.testing.assert_allclose(mean.acceleration[:-1], gain, atol=1e-7)
    np.testing.assert_array_equal(mean.torque, first.torque)
    for averaged in (False, True):
        sampling = Sampling(400.0, 5, averaged, 0.1)
        coarse = run(puma, PUMA, waving(3), sampling, 5e-4, friction=False)
        at = coarse.time + averaged * 0.5 / 400
        np.testing.assert_allclose(coarse.truth.position, waving(3).at(at).q, atol=5e-4)
        other = waving(3).at(coarse.time + (not averaged) * 0.5 / 400).q
        assert np.abs(coarse.truth.position - other).max() > 1e-3


def test_what_is_watched_is_what_is_recorded_and_what_went_before(puma: tb.Tree) -> None:
    """A viewer sees the warm-up, from the reference's own state on; a recording begins at 0."""
    seen: list[tuple[Array, Truth]] = []
    done: list[tuple[int, int]] = []
    rollout = simulate_motion(
        build_plant(ModelFile(PUMA), puma, 1e-3), puma, waving(3), 2.0, 60.0,
        Sampling(1000.0, 1, False, 0.3),
        progress=lambda now, total: done.append((now, total)),
        report_block=lambda time, truth: seen.append((time, truth)),
    )  # fmt: skip
    assert done == [(1000, 2300), (2000, 2300), (2300, 2300)]
    time = np.concatenate([t for t, _ in seen])
    np.testing.assert_allclose(time, np.arange(-300, 2000) / 1000, atol=1e-12)
    np.testing.assert_array_equal(rollout.time, time[300:])
    for name in vars(rollout.truth):
        whole = np.concatenate([getattr(truth, name) for _, truth in seen])
        np.testing.assert_array_equal(getattr(rollout.truth, name), whole[300:])
    started = waving(3).at(time[:1])
    np.testing.assert_allclose(seen[0][1].position[0], started.q[0], atol=1e-12)
    np.testing.assert_allclose(seen[0][1].velocity[0], started.qd[0], atol=1e-12)


def test_tracking_and_saturation_are_told_and_a_lost_or_unstable_run_is_refused(
    puma: tb.Tree,
) -> None:
    """The waving takes the shoulder to its limit."""
    done = run(puma, PUMA, waving(3), INSTANTS, 1e-3)
    away = done.truth.position - waving(3).at(done.time).q
    np.testing.assert_allclose(done.tracking_error, np.sqrt(np.mean(away**2, axis=0)), rtol=1e-9)
    limits = np.array([joint.max_effort for joint in puma.joints])
    at_limit = np.abs(done.truth.torque) == limits
    assert (np.abs(done.truth.torque) <= limits).all()
    np.testing.assert_array_equal(done.saturated_fraction, at_limit.mean(axis=0))
    assert 0 < done.saturated_fraction.max() < 1
    with refuses(SimulationDiverged, "shoulder"):
        run(with_all(puma, max_effort=0.5), PUMA, waving(3), INSTANTS, 1e-3)
    strong, plant = with_all(puma, max_effort=np.inf), build_plant(ModelFile(PUMA), puma, 1e-3)
    with refuses(SimulationDiverged, "1.00 s"):
        simulate_motion(plant, strong, waving(3), 1.0, 1e5, replace(INSTANTS, warm_up=0.0))
