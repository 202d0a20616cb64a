"""Other people's model files: read as they stand, or refused at once, by name, in one line."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.errors import ModelError
from testbed.robot.model_file import ModelFile
from testbed.simulation.build import build_plant
from tests.helpers.paths import ROOT
from tests.helpers.robots import random_robot
from tests.helpers.strategies import few
from tests.helpers.work import counted_calls

MASS = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
BODY = f"<body><joint/>{MASS}</body>"
WORLD = "<mujoco>{}<worldbody>{}</worldbody></mujoco>"
INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    "</inertial>"
)


def chain(links: int, kind: str) -> str:
    """Links in a row."""
    return (
        '<robot name="r"><link name="l0"/>'
        + "".join(
            f'<link name="l{k + 1}">{INERTIAL}</link><joint name="j{k}" '
            f'type="{kind if k else "continuous"}"><parent link="l{k}"/><child link="l{k + 1}"/>'
            "</joint>"
            for k in range(links)
        )
        + "</robot>"
    )


def refusal(path: Path) -> str:
    """The line that refuses a file; found with little work."""
    with counted_calls() as calls, pytest.raises(ModelError) as caught:
        tb.load_tree(path)
    assert calls.count < 5_000_000
    said = str(caught.value)
    assert said.isprintable()
    assert len(said) < 1000
    assert path.name in said
    return said


# bombs: a small file that would take all memory, or all time; nightly there are more


def test_a_file_that_would_grow_without_end_is_refused(tmp_path: Path) -> None:
    """It holds itself, copies itself, asks for arrays that no machine has, or for a deep stack."""
    (tmp_path / "b.xml").write_text(WORLD.format('<asset><model file="./r.xml"/></asset>', BODY))
    cable = f'<body><joint/>{MASS}<composite type="cable" count="1000000 1 1"/></body>'
    for word, head, inside in (
        ("itself", '<include file="r.xml"/>', BODY),
        ("itself", '<include file="b.xml"/>', BODY),
        ("over 10^24", "", '<replicate count="100">' * 12 + BODY + "</replicate>" * 12),
        ("6000", "", f'<replicate count="6000">{BODY}</replicate>'),
        ("limits", "", cable),
        (
            "height",
            '<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>',
            "",
        ),
        ("nuserdata", '<size memory="900G" nuserdata="2000000000"/>', BODY),
        ("size", '<custom><numeric name="n" size="500000000"/></custom>', BODY),
        ("deep", "<a>" * 3000 + "</a>" * 3000, BODY),
    ):
        (tmp_path / "r.xml").write_text(WORLD.format(head, inside))
        assert word in refusal(tmp_path / "r.xml")
    arms = f'<replicate count="12" euler="0 0 30" sep="-">{BODY}</replicate>'
    (tmp_path / "r.xml").write_text(WORLD.format('<size memory="900G"/>', arms))
    assert tb.load_tree(tmp_path / "r.xml").n == 12  # what is meant in earnest is read


def test_models_that_hold_ten_each_are_counted(tmp_path: Path) -> None:
    """Seven files of ten lines would become ten million bodies."""
    assets = "".join(f'<model name="m{i}" file="{{0}}"/>' for i in range(10))
    attached = "".join(
        f'<frame><attach model="m{i}" body="b" prefix="p{i}"/></frame>' for i in range(10)
    )
    for k in range(7):
        head = f"<asset>{assets.format(f'l{k + 1}.xml')}</asset>"
        text = WORLD.format(head, f'<body name="b">{attached}</body>')
        (tmp_path / f"l{k}.xml").write_text(text)
    (tmp_path / "l7.xml").write_text(WORLD.format("", f'<body name="b"><joint/>{MASS}</body>'))
    refusal(tmp_path / "l0.xml")
    assert tb.load_tree(tmp_path / "l6.xml").n == 10
    for k in range(9):  # files in each other
        (tmp_path / f"f{k}.xml").write_text(f'<mujoco><include file="f{k + 1}.xml"/></mujoco>')
    (tmp_path / "f9.xml").write_text(WORLD.format("", BODY))
    assert "8" in refusal(tmp_path / "f0.xml")
    assert tb.load_tree(tmp_path / "f2.xml").n == 1


@pytest.mark.slow
def test_a_file_too_long_for_a_parser_is_refused_and_a_long_one_is_read(tmp_path: Path) -> None:
    """Stacks would run out: no message at all. What only is long is read, in linear work."""
    path = tmp_path / "r.urdf"
    for word, text in (
        ("200000", f"<robot>{'<a/>' * 200_001}</robot>"),
        ("1000", chain(1200, "continuous")),
        ("chain", chain(9000, "fixed")),
    ):
        path.write_text(text)
        assert word in refusal(path)
    with path.open("r+b") as file:
        file.truncate(2**27 + 1)
    assert "128 MiB" in refusal(path)
    path.write_text(random_robot(np.random.default_rng(0), 150).urdf())
    tb.load_tree(path)  # what is imported once does not count
    with counted_calls() as calls:
        assert tb.load_tree(path).n == 150
    assert calls.count < 4000 * 150


BODIES = [
    f'<body pos="0 0 {{}}"><joint/>{MASS}</body>',
    f'<body><joint pos="0 {{}} 0"/>{MASS}</body>',
    '<body><joint/><inertial mass="1" pos="{} 0 0" diaginertia="1 1 1"/></body>',
    '<body><joint/><inertial mass="{}" pos="0 0 0" diaginertia="1 1 1"/></body>',
    '<body><joint/><inertial mass="1" pos="0 0 0" diaginertia="{0} {0} {0}"/></body>',
]
NAMES = ["a\u009bb", "a\u202eb", "a\ufeffb", "a\u2028b", "a&#10;b", "a" * 201]
PLACES = {
    "r.urdf": [
        chain(1, "continuous").replace('"j0"', '"@"'),
        chain(1, "continuous").replace('"l1"', '"@"'),
        chain(1, "continuous").replace('"r"', '"@"'),
        chain(1, "continuous").replace('"continuous"', '"@"'),
    ],
    "r.xml": [
        WORLD.format("", f'<body name="b"><joint name="@"/>{MASS}</body>'),
        WORLD.format("", f'<body name="@"><joint name="j"/>{MASS}</body>'),
        WORLD.format("", BODY).replace("<mujoco>", '<mujoco model="@">'),
        WORLD.format('<asset><mesh file="@"/></asset>', BODY),
    ],
}


def test_numbers_and_names_that_no_robot_has_are_refused(tmp_path: Path) -> None:
    """An extreme number would overflow far from its file; a name could rewrite a terminal."""
    for number in ("1e300", "-1e13", "9" * 400):
        for body in BODIES:
            (tmp_path / "r.xml").write_text(WORLD.format("", body.format(number)))
            refusal(tmp_path / "r.xml")
    for k, name in enumerate(NAMES):
        for file, texts in PLACES.items():
            text = texts[k % len(texts)].replace("@", name)
            (tmp_path / file).write_text(text, encoding="utf-8")
            refusal(tmp_path / file)
    for name in ("Gelenk-Ä/1", "关节 1", "a" * 200, "j.1[0]"):
        for file, texts in PLACES.items():
            (tmp_path / file).write_text(texts[0].replace("@", name), encoding="utf-8")
            assert tb.load_tree(tmp_path / file).names == (name,)
    for encoding in ("latin-1", "utf-16"):
        head = f'<?xml version="1.0" encoding="{encoding}"?>'
        (tmp_path / "r.xml").write_bytes(
            (head + PLACES["r.xml"][0].replace("@", "\u00e9")).encode(encoding)
        )
        assert "UTF-8" in refusal(tmp_path / "r.xml")  # MuJoCo reads no other
        text = head + PLACES["r.urdf"][0].replace("@", "\u00e9")
        (tmp_path / "r.urdf").write_bytes(text.encode(encoding))
        assert tb.load_tree(tmp_path / "r.urdf").names == ("\u00e9",)


# numbers of a URDF

Place = tuple[str, str, str]  # holder, element, attribute
NUMBERS: list[Place] = [
    ("link/inertial", "mass", "value"),
    *(("link/inertial", "inertia", key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    *(("link/inertial", "origin", key) for key in ("xyz", "rpy")),
    *(("joint", "origin", key) for key in ("xyz", "rpy")),
    ("joint", "axis", "xyz"),
    *(("joint", "limit", key) for key in ("lower", "upper", "effort", "velocity")),
    *(("joint", "dynamics", key) for key in ("damping", "friction")),
]
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


def load(root: ET.Element) -> tb.Tree | str:
    """The robot, or the line that refuses it."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "r.urdf").write_bytes(ET.tostring(root))
        try:
            return tb.load_tree(Path(folder) / "r.urdf", repair={})
        except ModelError as error:
            return str(error)


def numbers_of(tree: tb.Tree) -> list[list[float]]:
    """All of a robot."""
    parts = (*tree.joints, *tree.inertias, tree.pedestal)
    values = [value for part in parts for value in vars(part).values()]
    return [np.ravel(value).tolist() for value in values if not isinstance(value, str)]


@st.composite
def texts(draw: st.DrawFn, plain: str) -> str:
    """A number's text with some letters edited, or an odd one."""
    if draw(st.booleans()):
        return draw(st.sampled_from(ODD))
    edits = st.tuples(st.integers(0, 60), st.integers(0, 2), st.text(EDITS, max_size=2))
    for where, length, new in draw(st.lists(edits, min_size=1, max_size=3)):
        at = where % (len(plain) + 1)
        plain = plain[:at] + new + plain[at + length :]
    return plain


@given(st.data(), st.sampled_from(NUMBERS), st.integers(0, 2), st.integers(0, 5))
@few(100)
@pytest.mark.slow
def test_a_number_is_read_as_it_stands_or_refused_by_name(
    data: st.DataObject, place: Place, owner: int, seed: int
) -> None:
    """Never passed over: urdfdom reads '3,5' as 3, and a missing mass as none."""
    root, (holder, tag, key) = urdf(seed), place
    element = root.findall(f"{holder}/{tag}")[owner]
    name = root.findall(holder.removesuffix("/inertial"))[owner].get("name", "")
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
    assert numbers_of(found) == numbers_of(again)  # to the last bit
    if key == "value":
        bodies = dict(zip([j.body for j in found.joints], found.inertias, strict=True))
        assert bodies.get(name, found.pedestal).mass == values[0]
    if tag == "dynamics":
        joint = found.joints[found.index(name)]
        assert (joint.viscous if key == "damping" else joint.coulomb) == values[0]


SPOILED = [
    ("link/inertial", "", "intertial"), ("link/inertial/mass", "", "masss"),
    ("link/inertial/mass", "value", "Value"), ("link/inertial/inertia", "ixx", "Ixx"),
    ("joint/origin", "rpy", "quat_xyzw"), ("joint/axis", "xyz", "xyx"),
    ("joint/limit", "effort", "efort"), ("joint/dynamics", "damping", "dampng"),
]  # fmt: skip


def test_what_is_misspelled_missing_or_doubled_is_not_passed_over() -> None:
    """A body without its mass is another robot."""
    for place, old, new in SPOILED:
        root = urdf(3)
        owner = root.findall(place.partition("/")[0])[1].get("name", "")
        element = root.findall(place)[1]
        if old:
            element.set(new, element.attrib.pop(old))
        else:
            element.tag = new
        found = str(load(root))
        assert f"'{owner}'" in found
        assert (old or place.rpartition("/")[2]) in found
    for place in ("link/inertial", "link/inertial/mass", "joint/origin"):
        root = urdf(3)
        holder = root.findall(place.rpartition("/")[0])[1]
        holder.append(holder.findall(place.rpartition("/")[2])[0])
        assert f"<{holder[-1].tag}>" in str(load(root))
    for part in ("mass", "inertia"):
        root = urdf(3)
        inertial = root.findall("link/inertial")[1]
        inertial.remove(inertial.findall(part)[0])
        assert "'j1_body'" in str(load(root))
    ring = "".join(
        f'<link name="ring{k}"/><joint name="r{k}" type="continuous"><parent link="ring{k}"/>'
        f'<child link="ring{3 - k}"/></joint>'
        for k in (1, 2)
    )
    text = ET.tostring(urdf(3)).decode()
    for culprit, old, new in (
        ("'ring1'", "</robot>", ring + "</robot>"),
        ("'j1", 'link name="j2_body"', 'link name="j1_body"'),
        ("'j1", 'joint name="j2"', 'joint name="j1"'),
    ):
        assert culprit in str(load(ET.fromstring(text.replace(old, new))))


# what MuJoCo's files may say

ARM = """<mujoco model="arm"><compiler angle="radian" {compiler}/><option {option}>{flags}</option>
<worldbody>{around}<body name="up"><joint name="j1" axis="0 0 1" range="-2 2" {joint}/>
<inertial mass="2" pos=".1 0 .2" diaginertia=".1 .1 .05"/>{geom}
<body name="fore" pos="0 0 .5" {fore}><joint name="j2" axis="0 1 0" range="-2 2"/>
<inertial mass="1" pos="0 .1 .2" diaginertia=".05 .05 .02"/>{geom}
<body name="tool" pos="0 0 .4"><geom size=".05" mass=".5"/></body></body></body></worldbody>
{more}</mujoco>"""
PARTS = ("compiler", "option", "flags", "around", "joint", "geom", "fore", "more")
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
]


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
        assert len(tree.warnings) == 1, parts
        assert [body.mass for body in tree.inertias] == [2.0, 1.5]
    marker = '<body name="marker" mocap="true" pos="1 0 0"><geom size=".1"/></body>'
    compiler, more = 'fusestatic="true"', '<size nkey="3"/>'
    tree = arm(tmp_path / "r.xml", compiler=compiler, around=marker, more=more)
    assert tree.warnings == ()
    assert [body.mass for body in tree.inertias] == [2.0, 1.5]


@pytest.mark.parametrize("also", ["", 'inertiafromgeom="true"', 'balanceinertia="true"'])
def test_what_the_compiler_makes_of_a_file_is_the_robot(also: str, tmp_path: Path) -> None:
    """MuJoCo's own compiler is the witness."""
    geom = '<geom size=".04" mass="1"/>' if "fromgeom" in also else ""
    tree = arm(tmp_path / "r.xml", compiler=f'settotalmass="7" {also}', geom=geom)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "r.xml"))
    fore = model.body("fore").subtreemass[0]
    own = [model.body("up").subtreemass[0] - fore, fore]
    np.testing.assert_allclose([body.mass for body in tree.inertias], own, rtol=1e-12)
    assert sum(own) == pytest.approx(7.0)


def test_flags_and_limits_of_a_file_are_those_of_the_tree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    flags = '<flag gravity="disable" frictionloss="disable"/>'
    tree = arm(tmp_path / "r.xml", flags=flags, joint='frictionloss="2" damping="1"')
    assert not tree.gravity.any()
    assert (tree.joints[0].coulomb, tree.joints[0].viscous) == (0.0, 1.0)
    tree = arm(tmp_path / "r.xml", joint='actuatorfrcrange="-2 60" frictionloss="2"')
    assert (tree.joints[0].max_effort, tree.joints[0].coulomb) == (2.0, 2.0)
    assert list((tmp_path / "here").iterdir()) == []  # MuJoCo likes to leave MUJOCO_LOG.TXT


def test_a_plant_whose_plate_does_not_weigh_the_robot_is_refused(tmp_path: Path) -> None:
    """An arm beside the plate, or a clipped sensor: external identification would be wrong."""
    text = (ROOT / "models/puma562.xml").read_text()
    other = f'<body pos="1 0 0"><joint name="j3" axis="0 1 0"/>{MASS}</body></worldbody>'
    sensor = '<force name="bedplate_force"'
    for old, new in (("</worldbody>", other), (sensor, sensor + ' cutoff="50"')):
        (tmp_path / "r.xml").write_text(text.replace(old, new))
        with pytest.raises(ModelError):
            build_plant(ModelFile(tmp_path / "r.xml"), tb.load_tree(tmp_path / "r.xml"), 1e-3)
