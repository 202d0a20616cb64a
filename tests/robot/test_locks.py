"""A locked joint holds: the tree without it is the tree with it, standing still."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
import pytest

import testbed as tb
from testbed.errors import MimicError, ModelError, UnknownName
from testbed.robot.load import mimic_joints
from testbed.robot.locks import parse_lock
from testbed.robot.model_file import ModelFile
from testbed.simulation.build import build_plant
from tests.helpers.paths import GOLDEN, REAL, ROOT
from tests.helpers.robots import random_robot, random_states

SAMPLES = 5


def assert_held(full: tb.Tree, locked: tb.Tree, held: Mapping[str, float], seed: int = 0) -> None:
    """What locked and standing joints need and exert is the same, whatever the others do."""
    assert set(locked.names) == set(full.names) - set(held)
    states = np.array(random_states(np.random.default_rng(seed), SAMPLES, full.n))
    for name, position in held.items():
        states[:, :, full.index(name)] = [[position], [0.0], [0.0]]
    moving = [full.index(name) for name in locked.names]
    whole, part = (tb.Motion(np.zeros(SAMPLES), *s) for s in (states, states[:, :, moving]))
    wrench = tb.base_wrench(full, whole) + tb.pedestal_wrench(full)
    forces = tb.joint_forces(full, whole)[:, moving]
    scale = np.abs(wrench).max()
    np.testing.assert_allclose(
        tb.base_wrench(locked, part) + tb.pedestal_wrench(locked), wrench, atol=1e-12 * scale
    )
    np.testing.assert_allclose(tb.joint_forces(locked, part), forces, atol=1e-12 * scale)


@pytest.mark.parametrize("form", ["urdf", "xml"])
@pytest.mark.parametrize("seed", range(15))
def test_a_locked_joint_is_one_that_stands_still(seed: int, form: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(2, 9)))
    path = tmp_path / f"r.{form}"
    path.write_text(robot.urdf() if form == "urdf" else robot.mjcf())
    full = tb.load_tree(path)
    names = rng.choice(full.names, size=int(rng.integers(1, full.n)), replace=False)
    held = {str(name): float(rng.uniform(-3, 3)) for name in names}
    locked = tb.load_tree(path, lock=held)
    assert_held(full, locked, held, seed)
    build_plant(ModelFile(path, lock=held), locked, 1e-3)  # checks itself against MuJoCo's plate


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, 1.5707963, np.pi])
@pytest.mark.parametrize("axis", ["1 0 0", "0 1 0", "0 0 1", "1 2 -3"])
def test_origins_turn_exactly_where_roll_and_yaw_are_one(
    pitch: float, axis: str, tmp_path: Path
) -> None:
    path = tmp_path / "r.urdf"
    text = random_robot(np.random.default_rng(4), 3).urdf()
    start = text.index("<origin", text.index('<joint name="j2"'))
    end = text.index("<limit", start)
    turned = f'<origin xyz="0 0 1" rpy="0.4 {pitch!r} -0.9"/><axis xyz="{axis}"/>'
    path.write_text(text[:start] + turned + text[end:])
    for position in (0.3, -np.pi / 2, 1.5707963):
        held = {"j2": position}
        assert_held(tb.load_tree(path), tb.load_tree(path, lock=held), held)


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
<sensor><jointpos joint="d"/><actuatorpos actuator="{}"/></sensor>
<keyframe><key qpos="0 0 0 0 0 0"/></keyframe></mujoco>""".replace(
    '<actuatorpos actuator="{}"/>', ""
)


@pytest.mark.parametrize(
    "held",
    [
        {"a": 0.7},
        {"b": -1.1},
        {"c": 0.4, "a": 1.0},
        {"d": 0.9, "b": 0.2},
        {"a": 0.2, "b": 0.3, "c": -0.2, "d": 0.4},
        {"e": 2.0, "c": 0.0},
        {"b": np.radians(20), "f": 0.3},
    ],
    ids=str,
)
def test_joints_of_one_body_are_locked_each(held: dict[str, float], tmp_path: Path) -> None:
    """In degrees, counted from references, within frames, before and behind others."""
    path = tmp_path / "r.xml"
    path.write_text(STACKED)
    locked = tb.load_tree(path, lock=held)
    assert_held(tb.load_tree(path), locked, held)
    build_plant(ModelFile(path, lock=held), locked, 1e-3)


@pytest.mark.parametrize(
    "name", ["ur5_robot", "kinova", "g1_29dof_rev_1_0", "icub_reduced", "tiago_no_hand", "xarm7"]
)
def test_other_peoples_joints_can_be_locked(name: str) -> None:
    path = next(REAL.rglob(f"{name}.urdf"))
    full = tb.load_tree(path, weld_root=True)
    rng = np.random.default_rng(1)
    held = {}
    for joint in rng.choice(full.names, size=full.n // 2, replace=False):
        low, high = np.clip(full.joints[full.index(joint)].position_range, -3, 3)
        held[str(joint)] = float(rng.uniform(low, high))
    locked = tb.load_tree(path, weld_root=True, lock=held)
    assert_held(full, locked, held)


def test_a_prismatic_arm_locks_its_axes() -> None:
    path = GOLDEN / "robots/gantry_ppp_rrr.urdf"
    full = tb.load_tree(path)
    held = dict(zip(full.names, (0.3, -0.2, 0.1, 0.5), strict=False))
    assert_held(full, tb.load_tree(path, lock=held), held)


def test_a_joint_rests_at_zero_or_in_the_middle_of_its_range(tmp_path: Path) -> None:
    (tmp_path / "r.xml").write_text(STACKED)
    full = tb.load_tree(tmp_path / "r.xml")
    rests = {"a": np.radians(45), "b": 0.0, "f": 0.0}
    for name, position in rests.items():
        locked = tb.load_tree(tmp_path / "r.xml", lock={name: None})
        assert_held(full, locked, {name: position})
    puma = ROOT / "models/puma562.urdf"
    text = puma.read_text().replace('lower="-2.793" upper="2.793"', 'lower="0.5" upper="0.9"')
    (tmp_path / "p.urdf").write_text(text)
    locked = tb.load_tree(tmp_path / "p.urdf", lock={"waist": None})
    assert_held(tb.load_tree(tmp_path / "p.urdf"), locked, {"waist": 0.7})


def test_at_zero_nothing_is_rounded(tmp_path: Path) -> None:
    """Locking a UR5's wrist is what writing "fixed" into its file is, to the last bit."""
    path = REAL / "ur_description/urdf/ur5_robot.urdf"
    revolute = '<joint name="wrist_3_joint" type="revolute">'
    text = path.read_text()
    assert revolute in text
    (tmp_path / "r.urdf").write_text(text.replace(revolute, revolute.replace("revolute", "fixed")))
    fixed = tb.load_tree(tmp_path / "r.urdf")
    locked = tb.load_tree(path, lock={"wrist_3_joint": 0.0})
    for one, two in zip(fixed.inertias, locked.inertias, strict=True):
        assert one.mass == two.mass
        np.testing.assert_array_equal(one.first_moment, two.first_moment)
        np.testing.assert_array_equal(one.tensor, two.tensor)


# joints that follow others

PANDA = REAL / "panda_description/urdf/panda.urdf"


def without_mimics(path: Path, folder: Path) -> Path:
    """The same robot, its followers let loose."""
    text = "".join(line for line in path.read_text().splitlines(True) if "<mimic" not in line)
    (folder / path.name).write_text(text)
    return folder / path.name


def test_a_follower_is_refused_with_the_options_that_help() -> None:
    with pytest.raises(MimicError, match="--lock panda_finger_joint1 .*--lock-mimic") as caught:
        tb.load_tree(PANDA)
    assert caught.value.masters == {"panda_finger_joint2": "panda_finger_joint1"}
    assert "\n" not in str(caught.value)


def test_a_locked_master_takes_its_followers_along(tmp_path: Path) -> None:
    full = tb.load_tree(without_mimics(PANDA, tmp_path))
    held = {"panda_finger_joint1": 0.03}
    locked = tb.load_tree(PANDA, lock=held)
    assert_held(full, locked, held | {"panda_finger_joint2": 0.03})
    assert locked.warnings == ()
    build_plant(ModelFile(PANDA, lock=held), locked, 1e-3)


def test_followers_alone_stand_where_their_masters_zeros_take_them(tmp_path: Path) -> None:
    full = tb.load_tree(without_mimics(PANDA, tmp_path))
    lock = dict.fromkeys(mimic_joints(PANDA))
    assert lock == {"panda_finger_joint2": None}
    locked = tb.load_tree(PANDA, lock=lock)
    assert_held(full, locked, {"panda_finger_joint2": 0.0})
    assert "panda_finger_joint1" in locked.warnings[0]
    assert tb.load_tree(PANDA, lock=lock | {"panda_finger_joint1": 0.02}).n == 7


@pytest.mark.parametrize(
    "name",
    ["panda", "talos_full_v2", "romeo", "baxter", "pr2", "tiago_pro", "alex_psyonic_hands"],
)
def test_every_robot_with_followers_loads_with_them_locked(name: str) -> None:
    path = next(REAL.rglob(f"{name}.urdf"))
    followers = mimic_joints(path)
    tree = tb.load_tree(path, weld_root=True, lock=dict.fromkeys(followers))
    assert followers
    assert not set(followers) & set(tree.names)


@pytest.mark.parametrize("offset", [0.0, 0.25])
def test_offset_and_multiplier_say_where_a_follower_is(offset: float, tmp_path: Path) -> None:
    robot = random_robot(np.random.default_rng(6), 5).urdf()
    (tmp_path / "full.urdf").write_text(robot)
    for follower, master, slope in (("j4", "j2", -0.5), ("j5", "j4", 2.0)):
        start = robot.index("<limit", robot.index(f'<joint name="{follower}"'))
        mimic = f'<mimic joint="{master}" multiplier="{slope}" offset="{offset}"/>'
        robot = robot[:start] + mimic + robot[start:]
    (tmp_path / "r.urdf").write_text(robot)
    full = tb.load_tree(tmp_path / "full.urdf")
    first = offset - 0.5 * 0.6
    held = {"j2": 0.6, "j4": first, "j5": offset + 2 * first}
    assert_held(full, tb.load_tree(tmp_path / "r.urdf", lock={"j2": 0.6}), held)
    rest = {"j4": offset, "j5": offset + 2 * offset}
    locked = tb.load_tree(tmp_path / "r.urdf", lock={"j4": None, "j5": None})
    assert_held(full, locked, rest)
    assert len(locked.warnings) == 1  # j4 stands, and j5 is where j4 takes it


EQUALITY = '<equality><joint joint1="e" joint2="{}" polycoef="0.1 -0.7 0.3 0.2 -0.1"/></equality>'


@pytest.mark.parametrize("master", ["b", "f"])
def test_an_equality_between_joints_is_a_follower(master: str, tmp_path: Path) -> None:
    """Where the follower stands is where MuJoCo's own constraint is met."""
    path, free = tmp_path / "r.xml", tmp_path / "free.xml"
    free.write_text(STACKED)
    path.write_text(STACKED.replace("<actuator>", EQUALITY.format(master) + "<actuator>"))
    with pytest.raises(MimicError, match=f"--lock {master}"):
        tb.load_tree(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    q = 0.4
    data.joint(master).qpos = q
    mujoco.mj_forward(model, data)
    follower = float(data.joint("e").qpos[0] - data.efc_pos[0])
    held = {master: q}
    locked = tb.load_tree(path, lock=held)
    assert_held(tb.load_tree(free), locked, held | {"e": follower})
    assert mimic_joints(path) == ("e",)
    build_plant(ModelFile(path, lock=held), locked, 1e-3)


def test_an_equality_without_a_second_joint_holds_the_first(tmp_path: Path) -> None:
    path, free = tmp_path / "r.xml", tmp_path / "free.xml"
    free.write_text(STACKED)
    constant = '<equality><joint joint1="f" polycoef="0.1 0 0 0 0"/></equality><actuator>'
    path.write_text(STACKED.replace("<actuator>", constant))
    assert_held(tb.load_tree(free), tb.load_tree(path), {"f": 0.1})


def test_an_inactive_equality_does_nothing(tmp_path: Path) -> None:
    path = tmp_path / "r.xml"
    off = '<equality><weld body1="tip" active="false"/></equality><actuator>'
    path.write_text(STACKED.replace("<actuator>", off))
    assert tb.load_tree(path).n == 6


TENDON = (
    '<tendon><fixed name="t" {}><joint joint="e" coef="1"/><joint joint="f" coef="2"/></fixed>'
    "</tendon><actuator>"
)


@pytest.mark.parametrize("lock", [{}, {"e": 0.0}, {"e": 0.0, "f": 0.0}, {"a": 0.5}])
@pytest.mark.parametrize(
    "acts", ["", 'stiffness="3"', 'range="-1 1"', 'frictionloss="1"', 'armature="1"']
)
def test_a_tendon_is_left_out_whichever_joints_are_held(
    acts: str, lock: dict[str, float | None], tmp_path: Path
) -> None:
    path = tmp_path / "r.xml"
    path.write_text(STACKED.replace("<actuator>", TENDON.format(acts)))
    tree = tb.load_tree(path, lock=lock)
    assert tree.n == 6 - len(lock)
    assert [line for line in tree.warnings if "'t'" in line] == list(tree.warnings)
    assert len(tree.warnings) == bool(acts)
    build_plant(ModelFile(path, lock=lock), tree, 1e-3)


# what cannot be locked

WRONG: dict[str, tuple[dict[str, float | None], type[Exception], str]] = {
    "unknown": ({"weist": None}, UnknownName, "did you mean 'waist'"),
    "out of range": ({"waist": 4.0}, ModelError, "'waist' cannot be held at 4, out of its range"),
    "not a number": ({"waist": float("nan")}, ModelError, "cannot be held at nan"),
    "text": ({"waist": "up"}, ModelError, "cannot be held at 'up'"),  # type: ignore[dict-item]
    "everything": (
        dict.fromkeys(("waist", "shoulder", "elbow")),
        ModelError,
        "no joint that moves",
    ),
}


@pytest.mark.parametrize("what", WRONG)
@pytest.mark.parametrize("form", ["urdf", "xml"])
def test_what_cannot_be_locked_is_said(what: str, form: str) -> None:
    lock, error, said = WRONG[what]
    with pytest.raises(error, match=said):
        tb.load_tree(ROOT / f"models/puma562.{form}", lock=lock)


@pytest.mark.parametrize("axis", ["0 0 0", "1e-200 0 0"])
def test_an_axis_without_direction_is_refused_locked_or_not(axis: str, tmp_path: Path) -> None:
    text = random_robot(np.random.default_rng(6), 3).urdf()
    start = text.index("<axis", text.index('<joint name="j2"'))
    end = text.index("/>", start)
    (tmp_path / "r.urdf").write_text(f'{text[:start]}<axis xyz="{axis}"{text[end:]}')
    for lock in ({}, {"j2": 0.5}):
        with pytest.raises(ModelError, match="'j2' has no direction"):
            tb.load_tree(tmp_path / "r.urdf", lock=lock)


@pytest.mark.parametrize("side", [-1, 1])
def test_the_ends_of_a_range_are_within_it_but_for_rounding(side: int, tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(random_robot(np.random.default_rng(6), 3).urdf())
    for beyond in (0.0, 1e-7):
        assert tb.load_tree(tmp_path / "r.urdf", lock={"j2": side * (3.0 + beyond)}).n == 2
    with pytest.raises(ModelError, match=r"out of its range -3 \.\.\. 3"):
        tb.load_tree(tmp_path / "r.urdf", lock={"j2": side * 3.001})


def test_a_mimic_without_a_joint_is_refused(tmp_path: Path) -> None:
    text = random_robot(np.random.default_rng(6), 3).urdf()
    start = text.index("<limit", text.index('<joint name="j2"'))
    (tmp_path / "r.urdf").write_text(f"{text[:start]}<mimic/>{text[start:]}")
    with pytest.raises(ModelError, match="'j2': <mimic> names no joint"):
        tb.load_tree(tmp_path / "r.urdf")


def test_joints_that_follow_in_a_circle_are_refused(tmp_path: Path) -> None:
    text = random_robot(np.random.default_rng(6), 3).urdf()
    for follower, master in (("j2", "j3"), ("j3", "j2")):
        start = text.index("<limit", text.index(f'<joint name="{follower}"'))
        text = f'{text[:start]}<mimic joint="{master}"/>{text[start:]}'
    (tmp_path / "r.urdf").write_text(text)
    with pytest.raises(ModelError, match="follows itself"):
        tb.load_tree(tmp_path / "r.urdf", lock={"j2": 0.0})


def test_locks_are_typed_as_joints_and_positions() -> None:
    assert parse_lock(["a", "b=-0.5", "c=1e-2"]) == {"a": None, "b": -0.5, "c": 0.01}
    for wrong in ("", "=1", "a=", "a=x", "a=1 2", "a=nan"):
        with pytest.raises(ModelError, match="JOINT=q"):
            parse_lock([wrong])
    with pytest.raises(ModelError, match="two positions"):
        parse_lock(["a=1", "a=2"])


@pytest.mark.parametrize(
    "constraint",
    [
        '<weld name="w" body1="tip"/>',
        '<joint name="a" joint1="f" joint2="e"/><joint name="w" joint1="f" joint2="e"/>',
    ],
)
def test_a_closed_loop_is_refused(constraint: str, tmp_path: Path) -> None:
    path = tmp_path / "r.xml"
    equality = f"<equality>{constraint}</equality><actuator>"
    path.write_text(STACKED.replace("<actuator>", equality))
    with pytest.raises(ModelError, match="equality constraint 'w'.* closes a loop"):
        tb.load_tree(path)
