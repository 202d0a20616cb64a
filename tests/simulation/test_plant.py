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
from testbed.core.base.errors import ModelError
from testbed.core.robot.model_file import ModelFile
from testbed.lab.simulation.plant import Plant, build_plant, check_plant
from testbed.lab.simulation.rollout import Sampling
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
    smooth = build_plant(ModelFile(PUMA), puma, 1e-4, friction=False)
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
        at = plant.order[joint]
        plant.model.jnt_stiffness[at], plant.model.qpos_spring[at] = 1e-3, 0.5
        with refuses(ModelError, f"'{tree.names[joint]}'"):
            check_plant(plant, tree, path)
