"""The plant's wrench in bedplate axes, and the check that it is the robot that was read."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ModelError
from testbed.robot.inertia import NOTHING
from testbed.robot.model_file import ModelFile
from testbed.simulation.build import build_plant
from testbed.simulation.plant import Plant, check_plant
from tests.helpers.plants import PUMA
from tests.helpers.robots import Robot, random_robot


@pytest.fixture(scope="module")
def plant(puma: tb.Tree) -> Plant:
    return build_plant(ModelFile(PUMA), puma, 1e-3)


def changed(tree: tb.Tree, k: int, **changes: object) -> tb.Tree:
    """The tree with one joint changed."""
    joints = list(tree.joints)
    joints[k] = replace(joints[k], **changes)  # type: ignore[arg-type]
    return replace(tree, joints=tuple(joints))


@pytest.mark.parametrize("seed", range(5))
def test_a_wrench_does_the_same_work_in_both_frames(seed: int, plant: Plant) -> None:
    """On any motion of the plate: force times velocity and moment times turning."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    origin = rng.normal(size=3)
    turned = replace(plant, plate_turn=turn, plate_origin=origin)
    sensed, velocity, spin = rng.normal(size=(4, 6)), rng.normal(size=3), rng.normal(size=3)
    here = turned.bedplate_wrench(sensed) @ np.concatenate([velocity, spin])
    at_sensor = velocity + np.cross(spin, origin)
    there = sensed @ np.concatenate([turn.T @ at_sensor, turn.T @ spin])
    np.testing.assert_allclose(here, there, atol=1e-12)


def test_the_robot_that_was_read_is_the_plant(puma: tb.Tree, plant: Plant) -> None:
    check_plant(plant, puma, PUMA)


@pytest.mark.parametrize("k", range(3))
@pytest.mark.parametrize("loss", [{"coulomb": 6.0}, {"viscous": 4.0}])
def test_other_friction_is_something_else_that_acts(
    loss: dict[str, float], k: int, puma: tb.Tree, plant: Plant
) -> None:
    with pytest.raises(ModelError, match=rf"something else acts on '{puma.names[k]}' \("):
        check_plant(plant, changed(puma, k, **loss), PUMA)


@pytest.mark.parametrize("k", range(3))
def test_a_rotor_too_many_is_felt(k: int, puma: tb.Tree, plant: Plant) -> None:
    with pytest.raises(ModelError, match="do not feel the robot that was read"):
        check_plant(plant, changed(puma, k, rotor_inertia=1e-4), PUMA)


@pytest.mark.parametrize("share", [1e-5, 1.0])
@pytest.mark.parametrize("k", range(3))
def test_another_mass_is_felt(k: int, share: float, puma: tb.Tree, plant: Plant) -> None:
    """A hundred thousandth of a link's mass is enough."""
    inertias = list(puma.inertias)
    more = tb.Inertia(share * inertias[k].mass, np.zeros(3), np.zeros((3, 3)))
    inertias[k] = inertias[k] + more
    with pytest.raises(ModelError, match="do not feel the robot that was read"):
        check_plant(plant, replace(puma, inertias=tuple(inertias)), PUMA)


def test_a_tare_that_the_plate_does_not_feel_is_refused(puma: tb.Tree, plant: Plant) -> None:
    light = replace(plant, tare=plant.tare + np.array([0, 0, 1e-3, 0, 0, 0]))
    with pytest.raises(ModelError, match=r"off by 0\.001 N"):
        check_plant(light, puma, PUMA)


def test_a_robot_that_stands_still_for_want_of_inertia_is_told_so(
    puma: tb.Tree, plant: Plant
) -> None:
    """What MuJoCo cannot accelerate, or only without end."""
    plant.model.dof_damping[:], kept = 1e300, plant.model.dof_damping.copy()
    try:
        with pytest.raises(ModelError, match="no finite acceleration"):
            check_plant(plant, puma, PUMA)
    finally:
        plant.model.dof_damping[:] = kept


def light_robot(seed: int, friction: float) -> tuple[Robot, str]:
    """A thousandth of the masses, a tenth of the lengths, and dry friction that none of it fits."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, 4)
    links = tuple(
        replace(x, mass=x.mass / 1e3, xyz=x.xyz / 10, com=x.com / 10, central=x.central / 1e5)
        for x in robot.links
    )
    small = replace(robot, links=links)
    text = small.mjcf().replace("<joint ", f'<joint frictionloss="{friction}" damping="0.01" ')
    return small, text


@pytest.mark.parametrize("friction", [0.0, 0.01, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_friction_that_light_links_alone_would_not_overcome_is_no_fault(
    seed: int, friction: float, tmp_path: Path
) -> None:
    path = tmp_path / "r.xml"
    path.write_text(light_robot(seed, friction)[1])
    build_plant(ModelFile(path), tb.load_tree(path), 5e-4)


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("joint", ["j1", "j2", "j3", "j4"])
def test_a_weak_spring_on_any_joint_of_a_light_robot_is_named(
    joint: str, seed: int, friction: float, tmp_path: Path
) -> None:
    """What was found there and what friction should do, in the joint's units; nothing elsewhere."""
    robot, text = light_robot(seed, friction)
    own = next(link for link in robot.links if link.name == joint)
    path = tmp_path / "r.xml"
    path.write_text(text)
    tree = tb.load_tree(path)
    plant = build_plant(ModelFile(path), tree, 5e-4)
    at = plant.order[tree.index(joint)]
    plant.model.jnt_stiffness[at], plant.model.qpos_spring[at] = 1e-3, 0.5
    with pytest.raises(ModelError, match=rf"acts on '{joint}' \(") as caught:
        check_plant(plant, tree, path)
    unit = "N m" if own.kind == "revolute" else "N"
    numbers = re.search(rf"\((\S+) {unit} found, (\S+) of friction expected\)", str(caught.value))
    assert numbers
    found, expected = map(float, numbers.groups())
    assert abs(found - expected) < 1e-3 * (0.5 + 3 + 1)  # the spring's, within the joint's range
    assert not any(f"'{link.name}'" in str(caught.value) for link in robot.links if link is not own)


def test_a_fluid_around_the_plant_is_found(puma: tb.Tree) -> None:
    plant = build_plant(ModelFile(PUMA), puma, 1e-3)
    plant.model.opt.density = 1.2
    with pytest.raises(ModelError, match="something else acts"):
        check_plant(plant, puma, PUMA)


@pytest.mark.parametrize("form", ["urdf", "xml"])
@pytest.mark.parametrize("seed", range(6))
def test_the_tare_is_the_pedestals_weight(seed: int, form: str, tmp_path: Path) -> None:
    """Whatever stands still between plate and first joint, where its centre is."""
    robot = random_robot(np.random.default_rng(seed), 3, gravity=(1.0, -2.0, -9.0))
    path = tmp_path / f"r.{form}"
    path.write_text(robot.urdf() if form == "urdf" else robot.mjcf())
    tree = tb.load_tree(path)
    found = build_plant(ModelFile(path), tree, 1e-3).tare
    np.testing.assert_allclose(found, tb.pedestal_wrench(tree), atol=1e-10)
    assert not np.allclose(found, 0)
    assert tree.pedestal is not NOTHING
