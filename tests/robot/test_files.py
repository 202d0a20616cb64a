"""Other people's model files, and what is known better: as it stands, or refused by name."""

from __future__ import annotations

import math
import sys
import xml.etree.ElementTree as ET
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from benchmarks.hostile.bombs import BOMBS
from testbed.core.base.errors import ModelError, UnknownName
from testbed.core.robot.drive_torque import drive_torque, friction_torque
from testbed.core.robot.friction import JOINT_LAWS, ROTOR, joint_law, joint_terms
from testbed.core.robot.locks import JointTravel
from testbed.core.robot.model_file import ModelFile
from testbed.core.robot.parsing import capture_stderr
from testbed.core.robot.refusals import FreeRootError
from testbed.core.robot.tree import MAX_COORDINATE, SETTABLE_FIELDS
from testbed.lab.simulation.plant import build_plant
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, assert_same_tree, random_robot
from tests.helpers.strategies import Rng, few, rngs, robots, trees, wrong_numbers


@given(robots())
@pytest.mark.slow
def test_a_file_of_either_format_is_the_robot_that_was_written(robot: Robot) -> None:
    """Of which Pinocchio says the same in tests of dynamics; MuJoCo's plate weighs it here."""
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


READ = {
    "a chain of 400 joints": 400, "400 sliding joints": 400, "a bush of 200": 200,
    "a mesh from a network": 2, "a mesh of a package": 2, "8 files in a row": 8,
    "a mesh of four thousand million triangles": 2, "two models of ten each": 112,
    "a large texture": 1, "a large arena": 1, "30 bodies deep": 31, "no time": 1,
    "a scene that holds itself": 2, "materials that are a device": 2,
    **dict.fromkeys((name for name in BOMBS if name.startswith("a mesh that is ")), 2),
}  # fmt: skip
"""Joints of what is odd and harmless; all other bombs are refused."""


@pytest.mark.slow
def test_a_file_that_would_grow_without_end_is_refused(tmp_path: Path) -> None:
    """It holds itself, copies itself, asks for arrays that no machine has, or for a deep stack.

    What only is long, or what nobody needs, is read.
    """
    for number, (name, make) in enumerate(BOMBS.items()):
        folder = tmp_path / f"{number}"
        folder.mkdir()
        for file, content in make().items():
            (folder / file).write_bytes(content)
        (model,) = folder.glob("model.*")
        if name in READ:
            assert tb.load_tree(model).n == READ[name], name
        else:
            with refuses(ModelError, model.name):
                tb.load_tree(model)
    with model.open("r+b") as long:
        long.truncate(2**27 + 1)
    with refuses(ModelError, "128 MiB"):
        tb.load_tree(model)


URDF = '<robot name="r"><link name="b"/><link name="l">{}</link>{}</robot>'
JOINT = '<joint name="{}" type="{}"><parent link="b"/><child link="l"/>{}</joint>'
INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    "</inertial>"
)
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
    return URDF.format("", JOINT.format("k", kind, more))


REFUSED = {
    "mimic.urdf": (turning('<mimic joint="j"/>'), "'k'"),
    "loop.urdf": (URDF.format("", "".join(JOINT.format(j, "continuous", "") for j in "jk")), "'k'"),
    "axis.urdf": (turning('<axis xyz="0 0 0"/>'), "'k'"),
    "range.urdf": (turning('<limit lower="3" upper="-3"/>', "revolute"), "'k'"),
    "millimetres.urdf": (turning(f'<origin xyz="0 {-1.01 * MAX_COORDINATE} 0"/>'), "'k'"),
    "free.urdf": (URDF.format("", FLOATS + HIP), "'k'"),
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


BODY = """<body pos="0 0 {0}"><joint pos="0 {1} 0"/>
<inertial mass="{2}" pos="{3} 0 0" diaginertia="{4} {4} {4}"/></body>"""
NAMES = ["a\u009bb", "a\u202eb", "a\ufeffb", "a\u2028b", "a&#10;b", "a" * 201]
NAMED = {
    "r.urdf": URDF.format(INERTIAL, JOINT.format("@", "continuous", "")),
    "r.xml": MJCF.format(f'<body name="b"><joint name="@"/>{BALL}</body>', ""),
}
"""A joint of a name that is still to be given."""


def test_what_is_not_supported_or_no_robots_is_named_with_its_file(tmp_path: Path) -> None:
    """In one line, not as a robot that is another; a humanoid that floats can be welded.

    An extreme number would overflow far from its file; a name could rewrite a terminal.
    """
    refused = [(file, text, culprit) for file, (text, culprit) in REFUSED.items()]
    for number in ("1e300", "-1e13", "9" * 400):
        for place in range(5):
            values = [number if k == place else "1" for k in range(5)]
            refused.append(("r.xml", MJCF.format(BODY.format(*values), ""), ""))
    for file, text in NAMED.items():
        refused += [(file, text.replace("@", name), "") for name in NAMES]
    for file, text, culprit in refused:
        (tmp_path / file).write_text(text, encoding="utf-8")
        with refuses(FreeRootError if "free" in file else ModelError, file, culprit):
            tb.load_tree(tmp_path / file)
        if "free" in file:
            assert tb.load_tree(tmp_path / file, weld_root=True).names == ("hip",)
    with refuses(ModelError, "nowhere.xml"):
        tb.load_tree("nowhere.xml")


def test_names_of_all_scripts_and_encodings_are_read(tmp_path: Path) -> None:
    """Robots are named in the language of those who build them."""
    for file, text in NAMED.items():
        path = tmp_path / file
        for name in ("Gelenk-Ä/1", "关节 1", "a" * 200, "j.1[0]"):
            path.write_text(text.replace("@", name), encoding="utf-8")
            assert tb.load_tree(path).names == (name,)
        for encoding in ("latin-1", "utf-16"):
            head = f'<?xml version="1.0" encoding="{encoding}"?>'
            path.write_bytes((head + text.replace("@", "\u00e9")).encode(encoding))
            if file == "r.urdf":
                assert tb.load_tree(path).names == ("\u00e9",)
            else:  # MuJoCo reads no other
                with refuses(ModelError, "UTF-8"):
                    tb.load_tree(path)


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
        assert JointTravel(low, high).rest_position == rest


# numbers of a URDF

EDITS = "0123456789.,eE+-_ \t\n;xinfapd/\u00a0\uff11\u0663"
ODD = ["3 ", "3\n", ".5", "+3", "-0.0", "1e-320", "3,5", "3 4", "", "0x10", "1_0", "1e400",
       "\uff13", "nan", "inf", "0 0,1 0.2", "0 0.1", "0 0 1 2", "0\t1\n0 "]  # fmt: skip


def urdf(seed: int) -> ET.Element:
    """A random robot with every number there is."""
    root = ET.fromstring(random_robot(np.random.default_rng(seed), 3).urdf())
    for inertial in root.iterfind("link/inertial/origin"):
        inertial.set("rpy", "0.1 -0.2 0.3")
    for joint in root.iterfind("joint"):
        ET.SubElement(joint, "dynamics", damping="0.5", friction="0.25")
    return root


def parts_of(root: ET.Element) -> list[tuple[ET.Element, ET.Element, ET.Element]]:
    """All that stands in links and joints: in which, in which of its elements, and itself."""
    return [(owner, holder, part) for owner in root for holder in owner.iter() for part in holder]


def load(root: ET.Element) -> tb.Tree | str:
    """The robot, or the line that refuses it."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "r.urdf").write_bytes(ET.tostring(root))
        try:
            return tb.load_tree(Path(folder) / "r.urdf", repair={})
        except ModelError as error:
            return str(error)


def texts(plain: str) -> st.SearchStrategy[str]:
    """A number's text with some letters edited, or an odd one."""
    edits = st.tuples(st.integers(0, len(plain)), st.integers(0, 2), st.text(EDITS, max_size=2))
    return st.sampled_from(ODD) | edits.map(lambda e: plain[: e[0]] + e[2] + plain[sum(e[:2]) :])


@given(st.data(), st.integers(0, 10**6), st.integers(0, 5))
@few(100)
@pytest.mark.slow
def test_numbers_are_read_as_stated_or_refused(data: st.DataObject, which: int, seed: int) -> None:
    """Never passed over: urdfdom reads '3,5' as 3, and a missing mass as none."""
    root = urdf(seed)
    parts = [each for each in parts_of(root) if each[2].tag not in ("parent", "child")]
    numbers = [(owner, part, key) for owner, _, part in parts for key in part.attrib]
    owner, element, key = numbers[which % len(numbers)]
    name, tag = owner.get("name", ""), element.tag
    before = element.get(key, "")
    text = data.draw(texts(before))
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    stated = bool(values) and len(values) == len(before.split())
    element.set(key, text)
    found = load(root)
    if isinstance(found, str):
        assert f"'{name}'" in found
        assert "\n" not in found
        assert stated or (key in found and f"<{tag}>" in found)
        return
    assert stated, f"{text!r} was taken for numbers"
    element.set(key, " ".join(map(repr, values)))
    again = load(root)
    assert isinstance(again, tb.Tree)
    assert_same_tree(found, again, 0.0)  # to the last bit
    if key == "value":
        bodies = dict(zip([j.body for j in found.joints], found.inertias, strict=True))
        assert bodies.get(name, found.pedestal).mass == values[0]
    if tag == "dynamics":
        joint = found.joints[found.index(name)]
        friction = max(values[0], 0.0)  # that drives is taken as none
        assert (joint.viscous, joint.coulomb)[key == "friction"] == (values[0], friction)[
            key == "friction"
        ]


def test_what_is_misspelled_missing_or_doubled_is_not_passed_over() -> None:
    """A body without its mass is another robot."""
    count = len(parts_of(urdf(3)))
    for k, flaw in product(range(count), ("tag", "keys", "missing", "twice", "name")):
        root = urdf(3)
        owner, holder, part = parts_of(root)[k]
        if flaw == "tag":
            part.tag = part.tag[:1] + part.tag[2:]
        elif flaw == "keys" and part.attrib:
            part.attrib = {key[:1] + key[2:]: text for key, text in part.attrib.items()}
        elif flaw == "missing" and part.tag in ("mass", "inertia", "parent", "child"):
            holder.remove(part)
        elif flaw == "twice":
            holder.append(part)
        elif flaw == "name":
            owner.set("name", next(x.get("name", "") for x in root.iter(owner.tag) if x != owner))
        else:
            continue
        found = load(root)
        if (part.tag, flaw) == ("origin", "twice"):  # the first counts, as for URDF's own parser
            assert isinstance(found, tb.Tree)
            assert [each.code for each in found.diagnostics] == ["model.origins"]
            assert_same_tree(found, load(urdf(3)), 0.0)  # type: ignore[arg-type]
            found = str(found.diagnostics[0])
        assert f"'{owner.get('name')}'" in str(found), (part.tag, flaw)


OTHERS = ('<vendor:plug at="1"/>', "<density>7800</density>", "<xacro:property/>")
KEYS = ("iyx", "vendor:unit", "max_velocity", "velocities", "quat_xyzw")


def test_what_robots_parsers_ignore_is_ignored_and_said(tmp_path: Path) -> None:
    """Unknown names anywhere, with prefixes that stand nowhere; Pinocchio is the witness."""
    path, plain = tmp_path / "r.urdf", urdf(3)
    for k, (_, _, part) in enumerate(parts_of(plain)):
        root = ET.fromstring(ET.tostring(plain))
        owner, holder, same = parts_of(root)[k]
        key, mark = KEYS[k % len(KEYS)], f"<mark{k}/>"
        holder.append(ET.fromstring(mark))
        same.set("mark", "0.5")
        root.set("xmlns", "http://www.ros.org")
        text = ET.tostring(root, encoding="unicode").replace(' mark="0.5"', f' {key}="0.5"')
        path.write_text(text.replace(f"<mark{k} />", OTHERS[k % len(OTHERS)]))
        found = tb.load_tree(path, repair={})
        (said,) = (each for each in found.diagnostics if each.code == "model.ignored")
        assert f"'{key}' in <{part.tag}> of {owner.tag} '{owner.get('name')}'" in said.text
        assert said.level == "info"
        assert said.text.startswith("r.urdf")
        assert_same_tree(found, load(plain), 0.0)  # type: ignore[arg-type]
        model = pin.buildModelFromUrdf(str(path))
        np.testing.assert_allclose(
            [each.mass for each in found.inertias], [each.mass for each in model.inertias[1:]]
        )


@pytest.mark.parametrize("k", range(3))
def test_a_link_called_world_is_a_link(k: int, tmp_path: Path) -> None:
    """MuJoCo has a world of its own, and would merge a root of this name into it."""
    plants, masses = [], []
    for name in ("dummy", "world"):
        root, path = urdf(3), tmp_path / f"{name}.urdf"
        old = root.findall("link")[k].get("name")
        for each in root.iter():
            for key in ("name", "link"):
                if each.tag != "joint" and each.get(key) == old:
                    each.set(key, name)
        path.write_bytes(ET.tostring(root))
        tree = tb.load_tree(path)
        plants.append(build_plant(ModelFile(path), tree, 1e-3))
        masses.append(sum(each.mass for each in (tree.pedestal, *tree.inertias)))
    one, other = plants
    np.testing.assert_array_equal(one.tare, other.tare)
    np.testing.assert_array_equal(one.model.body_mass, other.model.body_mass)
    np.testing.assert_allclose([each.model.body_mass.sum() for each in plants], masses)
    assert one.tare[2] > 0


# what MuJoCo's files may say

ARM = """<mujoco model="arm"><compiler angle="radian" {compiler}/><option {option}>{flags}</option>
<worldbody>{around}<body name="up"><joint name="j1" axis="0 0 1" range="-2 2" {joint}/>
<inertial mass="2" pos=".1 0 .2" diaginertia=".1 .1 .05"/>{geom}
<body name="fore" pos="0 0 .5" {fore}><joint name="j2" axis="0 1 0" range="-2 2"/>
<inertial mass="1" pos="0 .1 .2" diaginertia=".05 .05 .02"/>{geom}
<body name="tool" pos="0 0 .4"><geom size=".05" mass=".5"/></body></body></body></worldbody>
{more}</mujoco>"""
PARTS = ("compiler", "option", "flags", "around", "joint", "geom", "fore", "more")
MARKER = '<body name="marker" mocap="true" pos="1 0 0"><geom size=".1"/></body>'
TENDON = '<tendon><fixed name="t" {}><joint joint="j1" coef="1"/></fixed></tendon>'
LEFT_OUT: list[dict[str, str]] = [
    {"joint": 'stiffness="5" springref="1"'},
    {"joint": 'springdamper="0.1 0.7"'},
    {"joint": 'damping="1 2 3"'},
    {"more": TENDON.format('stiffness="9" springlength="0.3"')},
    {"more": TENDON.format('damping="3"')},
    {"more": TENDON.format('armature="3"')},
    {"more": TENDON.format('range="-.1 .1"')},
    {"fore": 'gravcomp="1"'},
    {"option": 'density="1000" viscosity="2"'},
    {"compiler": 'fusestatic="true"', "around": MARKER, "more": '<size nkey="3"/>'},
]
"""What acts besides on the arm; the last does not."""


def arm(path: Path, **parts: str) -> tb.Tree:
    """Two links and a tool; the plant of the file is the tree's, which checks itself."""
    path.write_text(ARM.format(**dict.fromkeys(PARTS, "") | parts))
    tree = tb.load_tree(path)
    build_plant(ModelFile(path), tree, 1e-3)
    return tree


def test_what_else_acts_on_a_robot_is_left_out_and_said(tmp_path: Path) -> None:
    """A spring would be identified as gravity; the plant leaves it out, too."""
    for parts in LEFT_OUT:
        tree = arm(tmp_path / "r.xml", **parts)
        assert len(tree.diagnostics) == (parts is not LEFT_OUT[-1]), parts
        assert [body.mass for body in tree.inertias] == [2.0, 1.5]


def test_what_mujoco_compiles_is_the_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Flags and limits are the tree's; MuJoCo's own compiler is the witness of masses."""
    path, here = tmp_path / "r.xml", tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    flags = '<flag gravity="disable" frictionloss="disable"/>'
    tree = arm(path, flags=flags, joint='frictionloss="2" damping="1"')
    assert not tree.gravity.any()
    assert (tree.joints[0].coulomb, tree.joints[0].viscous) == (0.0, 1.0)
    tree = arm(path, joint='actuatorfrcrange="-2 60" frictionloss="2"')
    assert (tree.joints[0].max_effort, tree.joints[0].coulomb) == (2.0, 2.0)
    assert list(here.iterdir()) == []  # MuJoCo likes to leave MUJOCO_LOG.TXT
    for also in ("", 'inertiafromgeom="true"', 'balanceinertia="true"'):
        geom = '<geom size=".04" mass="1"/>' if "fromgeom" in also else ""
        tree = arm(path, compiler=f'settotalmass="7" {also}', geom=geom)
        model = mujoco.MjModel.from_xml_path(str(path))
        fore = model.body("fore").subtreemass[0]
        own = [model.body("up").subtreemass[0] - fore, fore]
        np.testing.assert_allclose([body.mass for body in tree.inertias], own, rtol=1e-12)
        assert sum(own) == pytest.approx(7.0)


def test_what_python_prints_meanwhile_is_no_complaint(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line of progress during the reading of a model would refuse the model."""
    with open(2, "w", closefd=False) as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        with capture_stderr() as said:
            print("reading ...", file=sys.stderr, flush=True)
            assert said() == ""
        assert sys.stderr is stream


@given(st.sampled_from(SETTABLE_FIELDS), wrong_numbers, wrong_numbers)
def test_what_no_joint_can_have_is_refused(name: str, a: Any, b: Any) -> None:
    """Robots with friction that drives them would be identified as such."""
    tree = random_robot(np.random.default_rng(0), 3).tree()
    value = [a, b] if name == "position_range" else a
    ranges = name == "position_range" and {type(a), type(b)} == {float} and a <= b
    if not ranges and not (name.startswith("max") and a == math.inf):
        with refuses(ModelError, "'j2'"):
            tree.with_joints({"j2": {name: value}})
    for settings, *culprits in (({"j": {}}, "'j'", "'j3'"), ({"j2": {"max_speed": 1.0}}, "'j2'")):
        with refuses(UnknownName, *culprits):
            tree.with_joints(settings)


def test_gravity_is_replaced_or_the_files_or_down(puma: tb.Tree) -> None:
    """On the moon a robot weighs a sixth; a mistake in a unit would be identified as masses."""
    for asked, found in (([0, 0, -1.62], [0, 0, -1.62]), (None, puma.gravity), ((0, 0, 0), 0)):
        np.testing.assert_array_equal(puma.with_gravity(asked).gravity, found)
    np.testing.assert_array_equal(tb.Tree("b", (), ()).gravity, [0.0, 0.0, -9.81])
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
COLUMNS = dict(zip(UNITS, [-1.0, -0.25, 1.0, 3.0, 0.25, -0.0625, -0.5], strict=True))
"""Of the laws that are shipped, at a velocity of -0.25 and an acceleration of 3."""


@given(trees((2, 6)), rngs)
def test_friction_and_rotors_are_the_textbooks_with_their_units(tree: tb.Tree, rng: Rng) -> None:
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
    for term in joint_terms(tree, JOINT_LAWS):
        joint = tree.joints[term.joint]
        units = UNITS.get(term.law.kind, (term.law.revolute_unit, term.law.prismatic_unit))
        assert term.unit(tree) == units[not joint.revolute]
        assert term.name(tree) == f"{term.law.kind}/{joint.name}"


def test_laws_are_found_by_name() -> None:
    """Another law than the one asked for would be fitted; a file adds one."""
    columns = {kind: float(joint_law(kind).column(-0.25, 3.0)) for kind in COLUMNS}
    assert columns == COLUMNS
    files = {path.stem for path in (ROOT / "testbed/core/robot/laws").glob("[a-z]*.py")}
    assert files == {law.kind for law in JOINT_LAWS[4:]}
    speeds = np.linspace(-2.0, 2.0, 9)
    for law in JOINT_LAWS:
        assert joint_law(law.kind) is law
        assert law.columns(speeds, speeds).shape == speeds.shape
        assert np.isfinite(law.columns(speeds, speeds)).all()
        sliding = law.revolute_unit.replace("N m", "N").replace("rad", "m")  # torque to force
        assert law == ROTOR or law.prismatic_unit == sliding
    assert joint_law("stribeck@0.08").column(-0.08, 0.0) == pytest.approx(-np.exp(-1))
    for wrong in ("viscos", *(f"stribeck@{x}" for x in ("", "0", "fast", "-1", "inf"))):
        with refuses(UnknownName, f"'{wrong}'", "viscous", "stribeck@0.1"):
            joint_law(wrong)
