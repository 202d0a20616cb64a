"""Joints that are held, joints that follow, bodies that cannot be: the tree is the file's robot."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.core.base.errors import ModelError, UnknownName
from testbed.core.robot.locks import JointLocks, parse_lock
from testbed.core.robot.model_file import ModelFile, mimic_joints, nearest_consistent_bodies
from testbed.core.robot.refusals import InertiaError, MimicError
from testbed.core.robot.repair import MIN_MASS_RATIO, MIN_MOMENT_RATIO
from testbed.core.robot.rigid_matter import (
    POINT_MASS_RADIUS_RATIO,
    inertia_flaw,
    nearest_consistent_inertia,
)
from testbed.core.robot.rotations import rpy_to_matrix
from testbed.lab.simulation.plant import build_plant
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, random_robot, random_states
from tests.helpers.strategies import Rng, few, rngs, robots

FORMS = ("urdf", "xml")


def written(robot: Robot | str, folder: Path | str, form: str = "urdf") -> Path:
    """A robot's file."""
    path = Path(folder) / f"r.{form}"
    text = robot if isinstance(robot, str) else robot.urdf() if form == "urdf" else robot.mjcf()
    path.write_text(text)
    return path


def assert_held(full: tb.Tree, path: Path, lock: JointLocks, held: Mapping[str, float]) -> tb.Tree:
    """What locked and standing joints need and exert is the same, whatever the others do.

    MuJoCo's plant agrees: it checks itself against the tree.
    """
    locked = tb.load_tree(path, lock=lock)
    assert set(locked.names) == set(full.names) - set(held)
    states = np.array(random_states(np.random.default_rng(0), 3, full.n))
    for name, position in held.items():
        states[:, :, full.index(name)] = [[position], [0.0], [0.0]]
    moving = [full.index(name) for name in locked.names]
    whole, part = (tb.Motion(np.arange(3.0), *s) for s in (states, states[:, :, moving]))
    wrench = tb.base_wrench(full, whole) + tb.pedestal_wrench(full)
    found = tb.base_wrench(locked, part) + tb.pedestal_wrench(locked)
    scale = np.abs(wrench).max()
    np.testing.assert_allclose(found, wrench, atol=1e-12 * scale)
    forces = tb.joint_forces(full, whole)[:, moving]
    np.testing.assert_allclose(tb.joint_forces(locked, part), forces, atol=1e-12 * scale)
    build_plant(ModelFile(path, lock=lock), locked, 1e-3)
    return locked


@given(robots((2, 8)), rngs, st.sampled_from(FORMS))
@pytest.mark.slow
def test_a_held_joint_is_one_that_stands_still(robot: Robot, rng: Rng, form: str) -> None:
    """An arm with a locked wrist is identified as the arm that it is; MuJoCo's plant agrees."""
    with TemporaryDirectory() as folder:
        path = written(robot, folder, form)
        full = tb.load_tree(path)
        names = rng.choice(full.names, size=int(rng.integers(1, full.n)), replace=False)
        held = {str(name): float(rng.uniform(-3, 3)) for name in names}
        assert_held(full, path, held, held)


STACKED = """<mujoco><compiler angle="degree" eulerseq="zyx"/>
<default><default class="turned"><joint ref="20" damping="1"/></default></default>
<option gravity="1 -2 -9"/><worldbody>
<frame pos="0 .1 .3" euler="10 20 30"><body name="base" pos=".1 0 0" axisangle="1 1 0 40">
 <joint name="a" axis="0 3 1" pos=".1 0 .2" range="10 80"/>
 <frame euler="0 50 0" pos="0 0 .1">
  <joint name="b" class="turned" axis="1 0 1" pos="0 .2 0"/></frame>
 <joint name="c" type="slide" axis="0 1 2" ref=".3"/>
 <joint name="d" class="turned" axis="1 1 1"/>
 <inertial mass="3" pos=".1 .2 .3" diaginertia=".2 .3 .4"/>
 <body name="tip" pos="0 0 .4" zaxis="1 0 1">
  <joint name="e" axis="0 1 0" ref="-15" pos="0 0 .1"/>
  <geom type="box" size=".1 .2 .05" pos=".1 0 0" mass="1"/></body>
 <body name="side" xyaxes="0 1 0 1 0 0"><joint name="f" type="slide" axis="1 0 0"/>
  <geom type="capsule" size=".05 .1" mass="2"/></body>
</body></frame></worldbody>
<custom><numeric name="velocity_limit/b" data="3"/></custom>
<actuator><motor joint="b"/><position joint="e"/></actuator>
<sensor><jointpos joint="d"/></sensor>
<keyframe><key qpos="0 0 0 0 0 0"/></keyframe></mujoco>"""


@given(
    st.fixed_dictionaries(
        {}, optional={n: st.none() | st.floats(0.2 if n == "a" else -1.5, 1.3) for n in "abcdef"}
    ).filter(lambda lock: 0 < len(lock) < 6)
)
@few(10)
@pytest.mark.slow
def test_joints_of_one_body_are_held_each(lock: dict[str, float | None]) -> None:
    """In degrees, counted from references, within frames, before and behind others; or at rest."""
    rests = {"a": np.radians(45)}
    held = {name: rests.get(name, 0.0) if q is None else q for name, q in lock.items()}
    with TemporaryDirectory() as folder:
        path = written(STACKED, folder, "xml")
        assert_held(tb.load_tree(path), path, lock, held)


def inserted(text: str, joint: str, more: str) -> str:
    """A URDF with one more element in a joint."""
    return re.sub(f'(name="{joint}" .*?)(?=<limit)', rf"\1{more}", text, count=1, flags=re.DOTALL)


@pytest.mark.parametrize("pitch", [np.pi / 2, 1.5707963])
def test_offset_and_multiplier_say_where_a_follower_is(pitch: float, tmp_path: Path) -> None:
    """Through a chain of followers; on a wrist at a quarter turn, whose rpy has no inverse."""
    text = random_robot(np.random.default_rng(6), 5).urdf()
    turned = f'<origin xyz="0 0 1" rpy="0.4 {pitch!r} -0.9"/><axis xyz="1 2 -3"/>'
    text = re.sub('(?<=<child link="j2_body"/>)<origin.*?/><axis.*?/>', turned, text)
    full = tb.load_tree(written(text, tmp_path))
    text = inserted(text, "j4", '<mimic joint="j2" multiplier="-0.5" offset="0.25"/>')
    path = written(inserted(text, "j5", '<mimic joint="j4" offset="0.25"/>'), tmp_path)
    with pytest.raises(MimicError) as caught:
        tb.load_tree(path)
    assert caught.value.masters == {"j4": "j2", "j5": "j4"}
    assert mimic_joints(path) == ("j4", "j5")
    rest = assert_held(full, path, {"j4": None, "j5": None}, {"j4": 0.25, "j5": 0.5})
    held = {"j2": 0.6, "j4": -0.05, "j5": 0.2}
    assert assert_held(full, path, {"j2": 0.6}, held).diagnostics == ()
    astray = tb.load_tree(path, lock={"j2": 0.6, "j4": 0.1})
    for tree, culprit in ((rest, "'j2'"), (astray, "'j4'")):  # not where they would be taken
        assert [each for each in tree.diagnostics if culprit in each.text]


def test_an_equality_between_joints_is_a_follower(tmp_path: Path) -> None:
    """Where the follower stands is where MuJoCo's own constraint is met; loops are refused."""

    def constrained(inside: str) -> Path:
        text = STACKED.replace("<actuator>", f"<equality>{inside}</equality><actuator>")
        return written(text, tmp_path, "xml")

    free = tb.load_tree(constrained(""))
    path = constrained('<joint joint1="e" joint2="b" polycoef="0.1 -0.7 0.3 0.2 -0.1"/>')
    with refuses(MimicError, "--lock b"):
        tb.load_tree(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.joint("b").qpos = 0.4  # turns from a reference of 20 degrees
    mujoco.mj_forward(model, data)
    follower = float(data.joint("e").qpos[0] - data.efc_pos[0])
    assert_held(free, path, {"b": 0.4}, {"b": 0.4, "e": follower})
    assert mimic_joints(path) == ("e",)
    inactive = '<weld body1="tip" active="false"/>'
    path = constrained(f'<joint joint1="f" polycoef="0.1 0 0 0 0"/>{inactive}')
    assert_held(free, path, {}, {"f": 0.1})
    with refuses(ModelError, "'w'", "--lock"):
        tb.load_tree(constrained('<weld name="w" body1="tip"/>'))


def test_what_cannot_be_held_is_named(tmp_path: Path) -> None:
    """In either format; the ends of a range are within it, but for rounding."""
    robot = random_robot(np.random.default_rng(6), 3)
    every: dict[str, Any] = dict.fromkeys(("j1", "j2", "j3"))
    for form in FORMS:
        path = written(robot, tmp_path, form)
        assert tb.load_tree(path, lock={"j2": 3.0 + 1e-7}).n == 2
        for place, culprit in ((-3.001, "'j2'"), (float("nan"), "nan"), ("up", "'up'")):
            with refuses(ModelError, culprit):
                tb.load_tree(path, lock={"j2": place})  # type: ignore[dict-item]
        with refuses(UnknownName, "'j4'"):
            tb.load_tree(path, lock={"j4": None})
        with refuses(ModelError, "joint"):
            tb.load_tree(path, lock=every)
    for mimic in ("<mimic/>", '<mimic joint="j2"/>'):
        with refuses(ModelError, "'j2'"):
            tb.load_tree(written(inserted(robot.urdf(), "j2", mimic), tmp_path), lock={"j2": 0.0})
    assert parse_lock(["a", "b=-0.5", "c=1e-2"]) == {"a": None, "b": -0.5, "c": 0.01}
    for wrong in (["=1"], ["a="], ["a=nan"], ["a=1", "a=2"]):
        with refuses(ModelError):
            parse_lock(wrong)


# bodies that cannot be

FRAMES = [
    (0.0, (0.0, 0.0, 0.0)), (1e-9, (0.0, 0.0, 0.0)), (0.02, (0.0, 0.0, 0.0)),
    (1e-6, (-1.99e-22, 8.5e-23, 3e-6)), (0.05, (1e-5, 1e-5, 2.002e-5)),
    (0.0, (5.3e-7, 5.7e-7, 8.4e-7)),
]  # fmt: skip
"""Mass and principal moments of links that files fix to others."""
FRAME = """<joint name="weld{0}" type="fixed"><parent link="{1}"/><child link="frame{0}"/>
<origin xyz="0.1 0 0.2" rpy="0.3 -0.2 0.1"/></joint><link name="frame{0}"><inertial>
<origin xyz="0.1 -0.1 0"/><mass value="{2}"/>
<inertia ixx="{3}" iyy="{4}" izz="{5}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
NEVER = [
    (1.3, (0.0, 0.0, 0.0)), (0.3, (1e-3, 1e-3, 1e-2)), (0.3, (1e-3, 1e-3, -1e-3)),
    (0.0, (1e-3, 1e-3, 1e-3)),
]  # fmt: skip
"""Of links that move, and that no body is near by rounding."""


def spoiled(robot: Robot, mass: float, moments: tuple[float, ...]) -> Robot:
    """With another mass and moments of the second link."""
    one, two, *others = robot.links
    return replace(robot, links=(one, replace(two, mass=mass, central=np.diag(moments)), *others))


@given(robots((1, 6)), rngs)
@few(5)
@pytest.mark.slow
def test_flaws_of_fixed_links_are_their_carriers_and_harmless(robot: Robot, rng: Rng) -> None:
    """Dynamics are those of Pinocchio's own fusing; MuJoCo simulates it."""
    links = ["pedestal_body", *(f"{link.name}_body" for link in robot.links)]
    more = [
        FRAME.format(k, rng.choice(links), mass, *moments)
        for k, (mass, moments) in enumerate(FRAMES)
    ]
    text = robot.urdf().replace("</robot>", "".join(more) + "</robot>")
    with TemporaryDirectory() as folder:
        path = written(text, folder)
        tree = tb.load_tree(path, repair={}).with_gravity(robot.gravity)
        assert tree.diagnostics == ()
        build_plant(ModelFile(path, repair={}), tb.load_tree(path, repair={}), 1e-3)
    states = random_states(rng, 3, tree.n)
    witness = by_pinocchio(text, tree, states)
    motion, scale = tb.Motion(np.arange(3.0), *states), np.abs(witness.wrench).max()
    np.testing.assert_allclose(tb.joint_forces(tree, motion), witness.forces, atol=1e-12 * scale)
    np.testing.assert_allclose(tb.base_wrench(tree, motion), witness.wrench, atol=1e-12 * scale)


@given(rngs)
@few(10)
def test_the_nearest_body_is_the_projection_of_what_was_given(rng: Rng) -> None:
    """Optimality of the nearest matrix in a cone, of second moments about the same mass centre."""
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    second = axes * (rng.uniform(-0.5, 1.0, 3) * 0.1) @ axes.T
    second = second if np.linalg.eigvalsh(second)[-1] > 0 else -second
    mass, com = rng.uniform(0.1, 9), rng.normal(size=3) * 0.2
    given = tb.Inertia.about_centre(mass, com, np.trace(second) * np.eye(3) - second)
    found = nearest_consistent_inertia(given, MIN_MOMENT_RATIO, 1.0, 1.0)
    assert inertia_flaw("b", found.mass, found.central) is None
    assert found.mass == mass
    np.testing.assert_allclose(found.com, com, rtol=1e-13)
    new = np.trace(found.central) / 2 * np.eye(3) - found.central
    change, slack = (
        new - second,
        new - MIN_MOMENT_RATIO * np.linalg.eigvalsh(second)[-1] * np.eye(3),
    )
    size = np.abs(second).max()
    assert min(np.linalg.eigvalsh(matrix)[0] for matrix in (change, slack)) >= -1e-12 * size
    assert abs(np.sum(change * slack)) <= 1e-12 * size**2


@given(robots((2, 4)), st.sampled_from(NEVER), st.sampled_from(FORMS))
@few(12)
@pytest.mark.slow
def test_a_body_that_cannot_be_is_refused_or_repaired_alone(
    robot: Robot, never: tuple[float, tuple[float, ...]], form: str
) -> None:
    """The repair is possible, alters no other body and needs none again; the plant has the same."""
    with TemporaryDirectory() as folder:
        path = written(robot, folder, form)
        sound, found = tb.load_tree(path), nearest_consistent_bodies(path)
        assert (found.links, found.bodies, found.diagnostics) == ({}, {}, ())
        for mass, moment in ((-1.0, 1e-3), (1.0, float("nan"))):  # no body is near
            written(spoiled(robot, mass, (1e-3, 1e-3, moment)), folder, form)
            with refuses(ModelError, "'j2_body'"):
                tb.load_tree(path)
        written(spoiled(robot, *never), folder, form)
        with refuses(InertiaError, "'j2_body'"):
            tb.load_tree(path, repair={})
        found = nearest_consistent_bodies(path)
        (body,) = found.bodies.values()
        assert inertia_flaw("j2_body", body.mass, body.central) is None
        tree, again = tb.load_tree(path), tb.load_tree(path, repair=found.bodies)
        assert (len(tree.diagnostics), again.diagnostics) == (1, ())
        for k, three in enumerate(zip(tree.inertias, again.inertias, sound.inertias, strict=True)):
            new, same, old = (each.pseudo for each in three)
            np.testing.assert_allclose(same, new, rtol=1e-13, atol=1e-16)
            assert tree.joints[k].name == "j2" or np.array_equal(new, old)
        build_plant(ModelFile(path), tree, 1e-3)
        written(spoiled(robot, 0.5, (1e-3, 1e-3, 2.0001e-3)), folder, form)
        rounded = tb.load_tree(path, repair={})  # whatever is asked for: it is rounding, and said
        assert [each.code for each in rounded.diagnostics] == ["model.rounding"]
        moments = np.linalg.eigvalsh(rounded.inertias[rounded.index("j2")].central)
        np.testing.assert_allclose(moments, [1e-3, 1e-3, 2e-3], atol=2e-7)


OUT_OF_SCALE: list[dict[str, Any]] = [
    *({"mass": mass} for mass in (1e6, 1e-9)),
    *({"central": moment * np.eye(3)} for moment in (1e6, 2e6)),
    *({"com": np.array([place, 0.0, 0.0])} for place in (1e3, -1e3)),
]
"""Numbers that no robot of a metre has: tons, micrograms, radii of gyration of a kilometre."""


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("number", OUT_OF_SCALE)
def test_bodies_out_of_scale_become_usual(
    form: str, number: dict[str, Any], tmp_path: Path
) -> None:
    """By its name and number; else torques would be taken for those of another robot."""
    robot = random_robot(np.random.default_rng(5), 4)
    sound = tb.load_tree(written(robot, tmp_path, form))
    assert sound.diagnostics == ()
    at, (one, two, *others) = sound.index("j2"), robot.links
    odd = replace(two, **number)
    path = written(replace(robot, links=(one, odd, *others)), tmp_path, form)
    tree = tb.load_tree(path)
    (said,) = tree.diagnostics
    radius = np.sqrt(np.trace(odd.central) / 2 / odd.mass + odd.com @ odd.com)
    assert f"'j2_body' has a mass of {odd.mass:.4g} kg" in said.text
    assert f"{radius:.4g} m" in said.text
    masses = [each.mass for k, each in enumerate(sound.inertias) if k != at]
    assert tree.inertias[at].mass == pytest.approx(np.mean(masses))
    for k, (new, before) in enumerate(zip(tree.inertias, sound.inertias, strict=True)):
        assert k == at or np.array_equal(new.pseudo, before.pseudo)
    build_plant(ModelFile(path), tree, 1e-3)
    with refuses(InertiaError, "'j2_body'"):
        tb.load_tree(path, repair={})
    assert tb.load_tree(path, repair=nearest_consistent_bodies(path).bodies).diagnostics == ()


def test_a_chains_bare_end_gets_matter_and_a_frame_on_the_way_does_not(tmp_path: Path) -> None:
    """Else half of what exporters write is refused, or simulated with joints that carry nothing."""
    robot = random_robot(np.random.default_rng(3), 3)
    chain = replace(robot, links=tuple(replace(x, parent=k - 1) for k, x in enumerate(robot.links)))
    bare_link = r'(<link name="j[13]_body">)<inertial>.*?</inertial>'
    path = written(re.sub(bare_link, r"\1", chain.urdf()), tmp_path)
    with refuses(InertiaError, "'j3_body'"):
        tb.load_tree(path, repair={})
    mended = tb.load_tree(path)
    bare, arm, end = mended.inertias
    assert bare.mass == 0
    assert end.mass == pytest.approx(MIN_MASS_RATIO * (arm.mass + mended.pedestal.mass))
    square, *others = (
        float(np.trace(each.pseudo[:3, :3])) / each.mass for each in (end, arm, mended.pedestal)
    )
    assert square == pytest.approx(
        POINT_MASS_RADIUS_RATIO**2 * max(others)
    )  # its size fits the robot's
    assert tb.load_tree(path, repair={}, lock={"j3": None}).n == 2  # held, it is a frame
    body = tb.Inertia.about_centre(2.0, (0.1, 0, 0), np.eye(3))
    given = tb.load_tree(path, repair={"j2_body": body, "j3_body": body})
    np.testing.assert_allclose(given.inertias[1].pseudo, body.pseudo, rtol=1e-15)
    flat = tb.Inertia.about_centre(2.0, np.zeros(3), np.diag([1.0, 1.0, 9.0]))
    for name, wrong, kind in (("j2_bdy", body, UnknownName), ("j2_body", flat, InertiaError)):
        with refuses(kind, f"'{name}'"):
            tb.load_tree(path, repair={"j3_body": body, name: wrong})


def test_angles_rounded_in_the_file_are_right_ones_and_others_stay(tmp_path: Path) -> None:
    """Else formulas hold millionths of every parameter."""
    text = random_robot(np.random.default_rng(3), 1).urdf()
    for said, meant in (
        ("1.5708 0 -3.14159", (np.pi / 2, 0, -np.pi)),
        ("0 -1.57079 6.283185", (0, -np.pi / 2, 2 * np.pi)),
        ("1.5709 2e-6 0", (1.5709, 0, 0)),
        ("0.785398 1e-4 1.5707", (0.785398, 1e-4, 1.5707)),
    ):
        path = written(re.sub('rpy=".*?"', f'rpy="{said}"', text), tmp_path)
        turn = tb.load_tree(path).joints[0].rotation
        np.testing.assert_allclose(turn, rpy_to_matrix(meant), atol=1e-15)
