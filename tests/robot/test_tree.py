"""Two roads to one robot, what none can have, and what is known better than its file knows it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.errors import FreeRootError, ModelError, UnknownName
from testbed.robot.friction import LAWS, drive_torque, friction_torque, joint_law, joint_terms
from testbed.robot.locks import Travel
from testbed.robot.model_file import ModelFile
from testbed.robot.tree import FARTHEST, SETTABLE
from testbed.simulation.build import build_plant
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, assert_same_tree, random_robot, random_states
from tests.helpers.strategies import rngs, robots, trees, wrong_numbers


@given(robots(), rngs)
@pytest.mark.slow
def test_a_file_of_either_format_is_the_robot_that_was_written(
    robot: Robot, rng: np.random.Generator
) -> None:
    """Pinocchio reads the same URDF, and MuJoCo's plate weighs the same MJCF: no third answer."""
    limits = {"position_range": [-3, 3], "max_effort": 500}
    wanted = robot.tree().with_joints({link.name: limits for link in robot.links})
    with TemporaryDirectory() as folder:
        urdf, mjcf = Path(folder) / "r.urdf", Path(folder) / "r.xml"
        urdf.write_text(robot.urdf())
        mjcf.write_text(robot.mjcf())
        read = tb.load_tree(mjcf)
        assert_same_tree(read, wanted)
        faster = wanted.with_joints({link.name: {"max_velocity": 5} for link in robot.links})
        assert_same_tree(tb.load_tree(urdf).with_gravity(robot.gravity), faster)
        build_plant(ModelFile(mjcf), read, 1e-3)  # checks itself against MuJoCo
    states = random_states(rng, 3, read.n)
    witness = by_pinocchio(robot.urdf(), read, states)
    forces = tb.joint_forces(read, tb.Motion(np.arange(3.0), *states))
    np.testing.assert_allclose(forces, witness.forces, atol=1e-11 * np.abs(witness.wrench).max())


URDF = '<robot name="r"><link name="b"/><link name="l"/>{}</robot>'
JOINT = '<joint name="{}" type="{}"><parent link="b"/><child link="l"/>{}</joint>'
MJCF = "<mujoco><worldbody>{}</worldbody>{}</mujoco>"
BALL = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
HELD = f'<body name="a"><joint name="i"/>{BALL}</body>'
RUBS = f'<body><joint name="k" frictionloss="-1"/>{BALL}</body>'
FREE = f'<body><freejoint name="k"/>{BALL}<body><joint name="hip"/>{BALL}</body></body>'
FLOATS = (
    '<link name="w"/><joint name="k" type="floating"><parent link="w"/><child link="b"/></joint>'
)
HIP = JOINT.format("hip", "continuous", '<axis xyz="0 0 1"/>')


def turning(more: str, kind: str = "continuous") -> str:
    """A URDF of one joint."""
    return URDF.format(JOINT.format("k", kind, more))


REFUSED = {
    "mimic.urdf": (turning('<mimic joint="j"/>'), "'k'"),
    "loop.urdf": (URDF.format("".join(JOINT.format(j, "continuous", "") for j in "jk")), "'k'"),
    "axis.urdf": (turning('<axis xyz="0 0 0"/>'), "'k'"),
    "range.urdf": (turning('<limit lower="3" upper="-3"/>', "revolute"), "'k'"),
    "millimetres.urdf": (turning(f'<origin xyz="0 {-1.01 * FARTHEST} 0"/>'), "'k'"),
    "free.urdf": (URDF.format(FLOATS + HIP), "'k'"),
    "page.urdf": ("\n<!DOCTYPE html><html><br></html>", "web page"),
    "broken.xml": ("<mujoco><worldbody>", "XML"),
    "other.xml": ("<sdf/>", "<sdf>"),
    "friction.xml": (MJCF.format(RUBS, ""), "'k'"),
    "limit.xml": (
        MJCF.format(HELD, '<custom><numeric name="velocity_limit/j9" data="1"/></custom>'), "j9",
    ),
    "falling.xml": (MJCF.format(HELD, '<option gravity="0 0 nan"/>'), "nan"),
    "heavy.xml": (MJCF.format(HELD, '<option gravity="0 0 1e30"/>'), "1e+30"),
    "free.xml": (MJCF.format(FREE, ""), "'k'"),
}  # fmt: skip
"""What a file may not say; more is in the table of wrong command lines."""


def test_what_is_not_supported_is_named_with_its_file(tmp_path: Path) -> None:
    """In one line, not as a robot that is another; a humanoid that floats can be welded."""
    for name, (text, culprit) in REFUSED.items():
        (tmp_path / name).write_text(text)
        with refuses(FreeRootError if "free" in name else ModelError, name, culprit):
            tb.load_tree(tmp_path / name)
        if "free" in name:
            assert tb.load_tree(tmp_path / name, weld_root=True).names == ("hip",)
    with refuses(ModelError, "nowhere.xml"):
        tb.load_tree("nowhere.xml")


def test_bodies_and_joints_without_names_are_told_apart(tmp_path: Path) -> None:
    """Where the name that a body would have is another's already, too."""
    names = ["", "", ' name="body1"', ' name="body3"', ""]
    body = '<body{}><joint/><geom size="0.1" mass="1" pos="{} 0 0"/>'
    chain = "".join(body.format(name, k + 1) for k, name in enumerate(names))
    (tmp_path / "r.xml").write_text(MJCF.format(chain + "</body>" * len(names), ""))
    tree = tb.load_tree(tmp_path / "r.xml")
    bodies = {joint.body for joint in tree.joints}
    assert len(set(tree.names)) == len(bodies) == len(names)
    assert {"body1", "body3"} < bodies
    build_plant(ModelFile(tmp_path / "r.xml"), tree, 1e-3)


def test_a_joint_without_limits_is_read_and_rests_at_zero_or_near_it(tmp_path: Path) -> None:
    """Zero is what exporters write for a limit that they do not know."""
    zeros = '<limit lower="0" upper="0" effort="0" velocity="0"/>'
    for kind, limit in (("revolute", zeros), ("continuous", ""), ("prismatic", zeros)):
        (tmp_path / "r.urdf").write_text(turning(limit, kind))
        joint = tb.load_tree(tmp_path / "r.urdf").joints[0]
        assert np.isinf([*joint.position_range, joint.max_velocity, joint.max_effort]).all()
    for low, high, rest in ((-1, 2, 0), (1, 2, 1.5), (0.5, math.inf, 0.5), (-math.inf, -2, -2)):
        assert Travel(low, high).rest == rest


# what is known better than the file knows it

VALUES: dict[str, Any] = {
    "position_range": [-0.5, 1.5], "max_velocity": 0.2, "max_effort": 30, "coulomb": 0.7,
    "viscous": 0.0, "rotor_inertia": 1e-3,
}  # fmt: skip


def test_everything_settable_is_set_and_nothing_else(puma: tb.Tree) -> None:
    assert set(VALUES) == set(SETTABLE)
    for name, value in VALUES.items():
        changed = puma.with_joints({"elbow": {name: value}})
        wanted = replace(puma.joints[2], **{name: value})
        assert_same_tree(changed, replace(puma, joints=(*puma.joints[:2], wanted)))
    for settings, *culprits in (
        ({"elbo": {}}, "'elbo'", "'elbow'"),
        ({"elbow": {"max_speed": 1.0}}, "'max_speed'", "max_velocity"),
    ):
        with refuses(UnknownName, *culprits):
            puma.with_joints(settings)


@given(st.sampled_from(SETTABLE), wrong_numbers, wrong_numbers)
def test_what_no_joint_can_have_is_refused(name: str, a: Any, b: Any) -> None:
    """Robots with friction that drives them would be identified as such."""
    tree = random_robot(np.random.default_rng(0), 3).tree()
    value = [a, b] if name == "position_range" else a
    ranges = name == "position_range" and {type(a), type(b)} == {float} and a <= b
    if not ranges and not (name.startswith("max") and a == math.inf):
        with refuses(ModelError, "'j2'"):
            tree.with_joints({"j2": {name: value}})


def test_gravity_is_replaced_or_the_files_or_down(puma: tb.Tree) -> None:
    np.testing.assert_array_equal(puma.with_gravity([0, 0, -1.62]).gravity, [0, 0, -1.62])
    np.testing.assert_array_equal(puma.with_gravity(None).gravity, puma.gravity)
    np.testing.assert_array_equal(tb.Tree("b", (), ()).gravity, [0.0, 0.0, -9.81])
    assert not puma.with_gravity((0, 0, 0)).gravity.any()
    wrong: list[Any] = [1e-300, 1e4 * 1.01, 10**400, math.nan, math.inf, True, None, []]
    for each in wrong:
        with refuses(ModelError, "gravity"):
            puma.with_gravity([0, 0, each])


# what joints' torques hold besides

UNITS = {
    "coulomb": ("N m", "N"), "viscous": ("N m s/rad", "N s/m"), "offset": ("N m", "N"),
    "rotor": ("kg m^2", "kg"), "asymmetric": ("N m s/rad", "N s/m"),
    "quadratic": ("N m s^2/rad^2", "N s^2/m^2"), "square_root": ("N m s^.5/rad^.5", "N s^.5/m^.5"),
}  # fmt: skip


@given(trees((2, 6)), rngs)
def test_friction_and_rotors_are_the_textbooks_with_their_units(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """Simulation and estimator read the same laws: wrong here is wrong in both, unseen."""
    values = rng.uniform(0, 5, (3, tree.n))
    keys = ("coulomb", "viscous", "rotor_inertia")
    given = {n: dict(zip(keys, values[:, k], strict=True)) for k, n in enumerate(tree.names)}
    tree = tree.with_joints(given)
    qd, qdd = rng.normal(size=(2, 50, tree.n))
    qd[0] = 0.0
    expected = values[0] * np.sign(qd) + values[1] * qd
    np.testing.assert_allclose(friction_torque(tree, qd), expected, rtol=1e-14)
    np.testing.assert_allclose(drive_torque(tree, qd, qdd), expected + values[2] * qdd, rtol=1e-13)
    smooth = values[0] * np.tanh(qd / 0.05) + values[1] * qd
    np.testing.assert_allclose(friction_torque(tree, qd, 0.05), smooth, rtol=1e-12)
    for term in joint_terms(tree, LAWS):
        joint = tree.joints[term.joint]
        assert term.unit(tree) == UNITS[term.law.kind][not joint.revolute]
        assert term.name(tree) == f"{term.law.kind}/{joint.name}"
    for law, field in (("coulomb", 0), ("viscous", 1), ("rotor", 2)):
        np.testing.assert_array_equal(joint_law(law).coefficients(tree), values[field])


def test_laws_are_found_by_name() -> None:
    columns = [float(joint_law(law.kind).column(-0.25, 3.0)) for law in LAWS]
    assert columns == [-1.0, -0.25, 1.0, 3.0, 0.25, -0.0625, -0.5]
    assert joint_law("stribeck@0.08").column(-0.08, 0.0) == pytest.approx(-np.exp(-1))
    for wrong in ("viscos", *(f"stribeck@{x}" for x in ("", "0", "fast", "-1", "inf"))):
        with refuses(UnknownName, f"'{wrong}'", "viscous", "stribeck@0.1"):
            joint_law(wrong)
