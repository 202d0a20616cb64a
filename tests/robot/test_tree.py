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
from testbed.robot.rotations import from_rpy
from testbed.robot.tree import FARTHEST, SETTABLE
from testbed.simulation.build import build_plant
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, random_robot, random_states
from tests.helpers.strategies import rngs, robots, trees, wrong_numbers

SAME = 1e-12  # two readers, two rounding histories


def assert_same_tree(a: tb.Tree, b: tb.Tree) -> None:
    """In whatever order their joints stand."""
    assert set(a.names) == set(b.names)
    for one, inertia in zip(a.joints, a.inertias, strict=True):
        k = b.index(one.name)
        two = b.joints[k]
        assert (one.kind, one.body) == (two.kind, two.body)
        of = [(*t.names, None)[j.parent] for t, j in ((a, one), (b, two))]
        assert of[0] == of[1]
        for what in ("axis", "offset", "rotation", "position_range", "max_effort", "coulomb",
                     "viscous", "rotor_inertia", "max_velocity"):  # fmt: skip
            np.testing.assert_allclose(getattr(one, what), getattr(two, what), rtol=0, atol=SAME)
        np.testing.assert_allclose(inertia.pseudo, b.inertias[k].pseudo, atol=SAME)
    np.testing.assert_allclose(a.pedestal.pseudo, b.pedestal.pseudo, atol=SAME)
    np.testing.assert_allclose(a.gravity, b.gravity, atol=SAME)


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


@given(rngs)
def test_an_inertia_seen_from_elsewhere_is_the_same_body(rng: np.random.Generator) -> None:
    com, at, angles = rng.uniform(-2, 2, (3, 3))
    central, turn = np.diag([0.3, 0.4, 0.5]), from_rpy(angles)
    moved = tb.Inertia.about_centre(2.0, com, central).moved(turn, at)
    np.testing.assert_allclose(moved.com, at + turn @ com, atol=1e-12)
    np.testing.assert_allclose(moved.central, turn @ central @ turn.T, atol=1e-11)
    np.testing.assert_allclose(tb.Inertia.of_pseudo(moved.pseudo).tensor, moved.tensor, atol=1e-12)


URDF = '<robot name="r"><link name="b"/><link name="l"/>{}</robot>'
JOINT = '<joint name="{}" type="{}"><parent link="b"/><child link="l"/>{}</joint>'
MJCF = "<mujoco><worldbody>{}</worldbody>{}</mujoco>"
BALL = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
HELD = f'<body name="a"><joint name="i"/>{BALL}</body>'
REFUSED = {
    "ball.xml": (MJCF.format(f'<body><joint name="k" type="ball"/>{BALL}</body>', ""), "'k'"),
    "planar.urdf": (URDF.format(JOINT.format("k", "planar", "")), "'k'"),
    "mimic.urdf": (URDF.format(JOINT.format("k", "continuous", '<mimic joint="j"/>')), "'k'"),
    "loop.urdf": (URDF.format("".join(JOINT.format(j, "continuous", "") for j in "jk")), "'k'"),
    "broken.xml": ("<mujoco><worldbody>", "XML"),
    "broken.urdf": ("<robot><link>", "XML"),
    "page.urdf": ("\n<!DOCTYPE html><html><br></html>", "web page"),
    "other.xml": ("<sdf/>", "<sdf>"),
    "still.urdf": ('<robot name="r"><link name="b"/></robot>', "joint"),
    "axis.urdf": (URDF.format(JOINT.format("k", "continuous", '<axis xyz="0 0 0"/>')), "'k'"),
    "range.urdf": (
        URDF.format(JOINT.format("k", "revolute", '<limit lower="3" upper="-3"/>')), "'k'",
    ),
    "friction.xml": (
        MJCF.format(f'<body><joint name="k" frictionloss="-1"/>{BALL}</body>', ""), "'k'",
    ),
    "limit.xml": (
        MJCF.format(HELD, '<custom><numeric name="velocity_limit/j9" data="1"/></custom>'), "j9",
    ),
    "falling.xml": (MJCF.format(HELD, '<option gravity="0 0 nan"/>'), "nan"),
    "heavy.xml": (MJCF.format(HELD, '<option gravity="0 0 1e30"/>'), "1e+30"),
}  # fmt: skip


def test_what_is_not_supported_is_named_with_its_file(tmp_path: Path) -> None:
    """In one line, not as a robot that is another."""
    for name, (text, culprit) in REFUSED.items():
        (tmp_path / name).write_text(text)
        with refuses(ModelError, name, culprit):
            tb.load_tree(tmp_path / name)
    with refuses(ModelError, "nowhere.xml"):
        tb.load_tree("nowhere.xml")


def test_a_free_root_is_refused_by_name_and_can_be_welded(tmp_path: Path) -> None:
    """A humanoid's file says that it floats; on the plate it stands."""
    leg = JOINT.format("hip", "continuous", '<axis xyz="0 0 1"/>')
    floating = (
        '<link name="w"/><joint name="float" type="floating"><parent link="w"/><child link="b"/>'
        f"</joint>{leg}"
    )
    hip = f'<freejoint name="float"/>{BALL}<body><joint name="hip"/>{BALL}</body>'
    for name, text in (
        ("free.xml", MJCF.format(f"<body>{hip}</body>", "")),
        ("free.urdf", URDF.format(floating)),
    ):
        (tmp_path / name).write_text(text)
        with refuses(FreeRootError, "--weld-root", "'float'"):
            tb.load_tree(tmp_path / name)
        assert tb.load_tree(tmp_path / name, weld_root=True).names == ("hip",)


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


# what is known better than the file knows it

VALUES: dict[str, Any] = {
    "position_range": [-0.5, 1.5], "max_velocity": 0.2, "max_effort": 30, "coulomb": 0.7,
    "viscous": 0.0, "rotor_inertia": 1e-3,
}  # fmt: skip


def test_everything_settable_is_set_and_nothing_else(puma: tb.Tree) -> None:
    assert set(VALUES) == set(SETTABLE)
    for name, value in VALUES.items():
        changed = puma.with_joints({"elbow": {name: value}})
        for old, new in zip(puma.joints, changed.joints, strict=True):
            for key, before in vars(old).items():
                expected = value if (new.name, key) == ("elbow", name) else before
                assert np.array_equal(getattr(new, key), expected), key
        assert changed.inertias is puma.inertias
    for settings, *culprits in (
        ({"elbo": {}}, "'elbo'", "'elbow'"),
        ({"elbow": {"max_speed": 1.0}}, "'max_speed'", "max_velocity"),
        ({"elbow": {"offset": [0, 0, 0]}}, "'offset'"),
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
    wrong: tuple[Any, ...] = (
        1e300,
        1e-300,
        1e4 * 1.01,
        10**400,
        math.nan,
        math.inf,
        True,
        None,
        [],
    )
    for each in wrong:
        with refuses(ModelError, "gravity"):
            puma.with_gravity([0, 0, each])


def test_flaws_of_joints_begin_where_their_limits_end(puma: tb.Tree) -> None:
    """A joint a kilometre away is a file in millimetres."""
    cases: list[tuple[str, Any, Any]] = [
        ("offset", np.array([FARTHEST, 0, -FARTHEST]), np.array([0, 1.01 * FARTHEST, 0])),
        ("axis", np.array([0, 0, 1.0]), np.array([0, 0, 1.1])),
        ("position_range", (1.0, 1.0), (1.0, 0.99)),
        ("viscous", 0.0, math.inf),
        ("max_effort", math.inf, 0.0),
    ]
    for key, good, bad in cases:
        assert not replace(puma.joints[0], **{key: good}).flaw(), key
        assert replace(puma.joints[0], **{key: bad}).flaw(), key


def test_a_joint_without_limits_is_read_and_can_be_given_them(tmp_path: Path) -> None:
    """Zero is what exporters write for a limit that they do not know."""
    zeros = '<limit lower="0" upper="0" effort="0" velocity="0"/>'
    for kind, limit in (("revolute", zeros), ("continuous", ""), ("prismatic", zeros)):
        (tmp_path / "r.urdf").write_text(URDF.format(JOINT.format("j", kind, limit)))
        joint = tb.load_tree(tmp_path / "r.urdf").joints[0]
        assert np.isinf([*joint.position_range, joint.max_velocity, joint.max_effort]).all()
        assert joint.with_settings({"max_effort": 7.0}).max_effort == 7.0


def test_a_joint_rests_at_zero_or_near_it() -> None:
    """Held joints without a position go there."""
    inf = math.inf
    for low, high, rest in ((-1, 2, 0), (1, 2, 1.5), (-3, -2, -2.5), (0.5, inf, 0.5),
                            (-inf, -0.5, -0.5), (-inf, inf, 0)):  # fmt: skip
        assert Travel(low, high).rest == rest


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
    assert not friction_torque(tree.without_friction(), qd).any()
    smooth = values[0] * np.tanh(qd / 0.05) + values[1] * qd
    np.testing.assert_allclose(friction_torque(tree, qd, 0.05), smooth, rtol=1e-12)
    for term in joint_terms(tree, LAWS):
        joint = tree.joints[term.joint]
        assert term.unit(tree) == UNITS[term.law.kind][not joint.revolute]
        assert term.name(tree) == f"{term.law.kind}/{joint.name}"
    for law, field in (("coulomb", 0), ("viscous", 1), ("rotor", 2)):
        np.testing.assert_array_equal(joint_law(law).coefficients(tree), values[field])
    assert not joint_law("offset").coefficients(tree).any()


def test_laws_are_found_by_name() -> None:
    assert [joint_law(law.kind) for law in LAWS] == list(LAWS)
    columns = [float(law.column(-0.25, 3.0)) for law in LAWS]
    assert columns == [-1.0, -0.25, 1.0, 3.0, 0.25, -0.0625, -0.5]
    assert joint_law("stribeck@0.08") is joint_law("stribeck@0.080")
    assert joint_law("stribeck@0.08").column(-0.08, 0.0) == pytest.approx(-np.exp(-1))
    for wrong in ("viscos", *(f"stribeck@{x}" for x in ("", "0", "fast", "-1", "inf"))):
        with refuses(UnknownName, f"'{wrong}'", "viscous", "stribeck@0.1"):
            joint_law(wrong)
