"""Files with other inertials: read as meant, by all readers, and not another byte changed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.errors import ModelError
from testbed.experiment.wrong_prior import wrong_bodies
from testbed.robot.formats.xml_bytes import XmlBytes, comment
from testbed.robot.friction import drive_torque
from testbed.robot.inertia import Inertia
from testbed.robot.links import Fixed
from testbed.robot.load import mimic_joints
from testbed.robot.model_file import ModelFile
from testbed.robot.write_model import write_model
from tests.helpers.mujoco_inverse import by_mj_inverse
from tests.helpers.paths import REAL, ROOT
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, random_robot, random_states
from tests.helpers.strategies import few, robots, seeds

FIXED: tuple[Fixed, ...] = ("lump", "share")
MODELS = {
    "puma.xml": ROOT / "models/puma562.xml",
    "panda.urdf": REAL / "panda_description/urdf/panda.urdf",
    "g1.urdf": REAL / "g1_description/urdf/g1_29dof_rev_1_0.urdf",
}
CHANGED = re.compile(
    rb"<inertial\b[^>]*/>|<inertial>.*?</inertial>|<dynamics[^>]*/>|\s+(?:frictionloss|damping|armature)=\S+|\s+",
    re.DOTALL,
)
"""What may change, and blanks."""


def model_of(name: str) -> ModelFile:
    path = MODELS[name]
    return ModelFile(path, name == "g1.urdf", lock=dict.fromkeys(mimic_joints(path)))


def other(tree: tb.Tree, seed: int = 0, *, rotors: bool = False) -> tb.Tree:
    """The robot with other bodies and losses."""
    rng = np.random.default_rng(seed)
    kinds = ("coulomb", "viscous", "rotor_inertia")[: 3 if rotors else 2]
    losses: dict[str, dict[str, object]] = {
        name: {kind: float(rng.uniform(0, 5)) for kind in kinds} for name in tree.names
    }
    return wrong_bodies(tree, 0.5, rng).with_joints(losses)


def assert_same(one: tb.Tree, two: tb.Tree, tolerance: float = 1e-12) -> None:
    for a, b in zip(one.inertias, two.inertias, strict=True):
        assert a.mass == pytest.approx(b.mass, rel=tolerance)
        for left, right in ((a.first_moment, b.first_moment), (a.tensor, b.tensor)):
            np.testing.assert_allclose(left, right, atol=tolerance * (1 + np.abs(right).max()))
    for j, k in zip(one.joints, two.joints, strict=True):
        assert (j.coulomb, j.viscous, j.rotor_inertia) == (k.coulomb, k.viscous, k.rotor_inertia)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fixed"), [("puma.xml", "lump"), ("panda.urdf", "share"), ("g1.urdf", "lump")]
)
def test_what_is_written_is_read_and_the_rest_is_as_it_was(
    name: str, fixed: Fixed, tmp_path: Path
) -> None:
    model, path = model_of(name), tmp_path / f"written{Path(name).suffix}"
    wanted = other(model.tree(), rotors=name.endswith(".xml"))
    write_model(model, wanted, path, fixed=fixed, note=["made -- by a test", "é"])
    assert_same(replace(model, path=path).tree(), wanted)
    before, after = model.path.read_bytes(), path.read_bytes()
    note = re.search(rb"\s*<!-- made.*?-->", after)
    assert note is not None
    assert note[0].strip() == rb"<!-- made - - by a test \xe9 -->"
    left = after.replace(note[0], b"", 1)
    assert CHANGED.sub(b"", left) == CHANGED.sub(b"", before)
    write_model(model, model.tree(), path, note=["same"])  # nothing new: not a byte
    assert re.sub(rb"\n *<!-- same -->", b"", path.read_bytes(), count=1) == before


@given(robots((2, 6)), seeds)
@few(5)
@pytest.mark.slow
def test_a_written_robot_is_the_same_to_all_readers(robot: Robot, seed: int) -> None:
    """An identified robot goes back to its users: MuJoCo and Pinocchio compute its torques."""
    states = random_states(np.random.default_rng(seed), 5, len(robot.links))
    motion = tb.Motion(np.arange(5.0), *states)
    for ending, text in (("urdf", robot.urdf()), ("xml", robot.mjcf())):
        with TemporaryDirectory() as folder:
            source, path = Path(folder) / f"source.{ending}", Path(folder) / f"written.{ending}"
            source.write_text(text)
            wanted = other(tb.load_tree(source), seed, rotors=ending == "xml")
            assert write_model(ModelFile(source), wanted, path) == ()
            assert_same(tb.load_tree(path), wanted)
            ours = tb.joint_forces(wanted, motion)
            if ending == "urdf":
                theirs = by_pinocchio(path.read_text(), wanted, states).forces
            else:  # dry friction is the solver's
                free = wanted.with_joints({name: {"coulomb": 0.0} for name in wanted.names})
                ours = ours + drive_torque(free, *states[1:])
                theirs = by_mj_inverse(path, wanted, states)
            np.testing.assert_allclose(theirs, ours, atol=1e-10 * (1 + np.abs(ours).max()))


CARRYING = """<?xml version='1.0'?>\r
<robot name="r">\r
  <link name="base"/>\r
  <link  name = 'arm' ><!-- the arm --><inertial>\r
    <mass value='2'/><!-- weighed --><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>\r
  </inertial></link>\r
  <joint name="a" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>\r
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>\r
  <link name="tool"><inertial><origin xyz="0 0 1" rpy="0.3 0 0"/><mass value="1"/>\r
    <inertia ixx=".1" ixy="0" ixz="0" iyy=".2" iyz="0" izz=".2"/></inertial></link>\r
  <joint name="f" type="fixed"><parent link="arm"/><child link="tool"/>\r
    <origin xyz="0 0.5 0" rpy="0 0.2 0.1"/></joint>\r
  <link name="finger"><inertial><mass value="0.5"/>\r
    <inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"/></inertial></link>\r
  <joint name="grip" type="prismatic"><parent link="tool"/><child link="finger"/>\r
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>\r
  <link name="frame" />\r
  <joint name="g" type="fixed"><parent link="tool"/><child link="frame"/></joint>\r
</robot>\r
"""


@pytest.mark.parametrize("fixed", FIXED)
def test_matter_of_what_moves_together_is_shared_as_asked(fixed: Fixed, tmp_path: Path) -> None:
    """Lumped into the links that joints carry, a held finger keeping its part; or in all."""
    source, path = tmp_path / "r.urdf", tmp_path / "w.urdf"
    source.write_bytes(CARRYING.encode())
    model = ModelFile(source, lock={"grip": 0.3})
    wanted = other(model.tree())
    write_model(model, wanted, path, fixed=fixed)
    assert_same(replace(model, path=path).tree(), wanted)
    free = tb.load_tree(path)  # the finger's joint is free in the file
    masses = [body.mass for body in free.inertias]
    assert sum(masses) == pytest.approx(wanted.inertias[0].mass, rel=1e-12)
    assert masses[1] == pytest.approx(wanted.inertias[0].mass * 0.5 / 3.5, rel=1e-9)
    for body in free.inertias:
        assert np.linalg.eigvalsh(body.pseudo)[0] > 0
    data = path.read_bytes()
    assert data.count(b"\r\n") == data.count(b"\n")
    assert b"<!-- the arm -->" in data
    assert b"<!-- weighed -->" in data
    assert b"<link  name = 'arm' >" in data
    assert b'<link name="frame" />' in data
    tool = re.search(rb'<link name="tool">.*?<mass value="([^"]*)"', data, re.DOTALL)
    assert tool is not None
    assert (float(tool[1]) == 0) == (fixed == "lump")


def test_odd_files_are_written_as_they_are_read(tmp_path: Path) -> None:
    """A byte order mark and accents stay; a link without inertial gets one; no inertia is lost."""
    accents = CARRYING.replace("<!-- the arm -->", "<!-- épaule > bras -->")
    bare = re.sub(r"<inertial>.*?</inertial>", "", CARRYING, flags=re.DOTALL)
    massless = CARRYING.replace('<mass value="1"/>', '<mass value="0"/>')
    source, path = tmp_path / "r.urdf", tmp_path / "w.urdf"
    for text in (accents, bare, massless):
        source.write_bytes(b"\xef\xbb\xbf" + text.encode())
        model = ModelFile(source, lock={"grip": None})
        body = Inertia.about_centre(2.0, [0.1, 0, 0], np.eye(3))
        wanted = replace(model.tree(), inertias=(body,))
        notes = write_model(model, wanted, path)
        assert_same(replace(model, path=path).tree(), wanted)
        assert path.read_bytes().startswith(b"\xef\xbb\xbf<?xml")
        assert ("épaule > bras".encode() in path.read_bytes()) == (text is accents)
        assert bool(notes) == (text is bare)


@pytest.mark.parametrize("form", ["urdf", "xml"])
@pytest.mark.parametrize("fixed", FIXED)
def test_a_repaired_pedestal_is_written_and_sound_links_stay(
    form: str, fixed: Fixed, tmp_path: Path
) -> None:
    """Else the copy is as impossible as the file was: nobody else can load it."""
    robot = random_robot(np.random.default_rng(1), 3)
    flat = replace(robot, pedestal=replace(robot.pedestal, central=np.diag([1e-3, 1e-3, 1e-2])))
    source, path = tmp_path / f"r.{form}", tmp_path / f"w.{form}"
    source.write_text(flat.urdf() if form == "urdf" else flat.mjcf())
    repaired = tb.load_tree(source)
    for wanted in (repaired, other(repaired)):
        write_model(ModelFile(source), wanted, path, fixed=fixed)
        read = tb.load_tree(path, repair={})  # refuses what cannot be
        assert_same(read, wanted)
        np.testing.assert_allclose(read.pedestal.pseudo, repaired.pedestal.pseudo, atol=1e-14)
        kept = [text for text in re.split(rb"(?=<link |<joint )", source.read_bytes())
                if b"_body" in text and b"pedestal" not in text]  # fmt: skip
        if form == "urdf" and wanted is repaired:
            assert all(text in path.read_bytes() for text in kept)
    given = {"j2_body": Inertia.about_centre(2.0, [0.1, 0, 0], np.eye(3))}
    model = ModelFile(source, repair=given | {"pedestal_body": repaired.pedestal})
    write_model(model, model.tree(), path, fixed=fixed)
    assert_same(tb.load_tree(path, repair={}), model.tree())
    with refuses(ModelError, "pedestal", str(source)):  # known, and not for an estimate to move
        heavier = repaired.with_inertia(-1, given["j2_body"])
        write_model(ModelFile(source), heavier, tmp_path / f"n.{form}")
    assert not (tmp_path / f"n.{form}").exists()


def test_a_flawed_link_on_a_held_joint_is_written_as_one_that_can_be(tmp_path: Path) -> None:
    """Held, it hides in its carrier's matter; in the file it moves, and nobody else can load it."""
    robot = random_robot(np.random.default_rng(0), 3)
    flat = replace(robot.links[2], central=np.diag([1e-3, 1e-3, 1e-2]))
    source, path = tmp_path / "r.urdf", tmp_path / "w.urdf"
    source.write_text(replace(robot, links=(*robot.links[:2], flat)).urdf())
    model = ModelFile(source, lock={"j3": 0.3})
    wanted = other(model.tree())
    for fixed in FIXED:
        write_model(model, wanted, path, fixed=fixed)
        assert tb.load_tree(path, repair={}).n == 3
        assert_same(replace(model, path=path).tree(), wanted)


def test_nothing_is_written_where_it_may_not_be(tmp_path: Path) -> None:
    source = tmp_path / "r.urdf"
    source.write_text(random_robot(np.random.default_rng(0), 3).urdf())
    model, before = ModelFile(source), source.read_bytes()
    wanted = other(model.tree())
    (tmp_path / "link.urdf").symlink_to(source)
    for place in (source, tmp_path / "link.urdf"):
        with refuses(tb.TestbedError, str(place), "--in-place"):
            write_model(model, wanted, place)
    with refuses(tb.TestbedError, "w.xml", ".urdf"):
        write_model(model, wanted, tmp_path / "w.xml")
    assert source.read_bytes() == before
    write_model(model, wanted, source, over_source=True)
    assert_same(tb.load_tree(source), wanted)
    (note,) = write_model(model, other(model.tree(), rotors=True), tmp_path / "w.urdf")
    assert "j1 " in note  # URDF has no place for rotors' inertias


def mjcf(compiler: str = "", before: str = "", inside: str = "") -> str:
    return (
        f'<mujoco><compiler angle="radian" {compiler}/>{before}<worldbody>'
        '<frame pos="0 0 1"><body><joint axis="0 1 0" damping="1"/>'
        '<inertial mass="1" pos="0 0 .1" quat="1 1 0 0" diaginertia="1 2 2"/>'
        f'<body pos="0 0 1"><joint/><geom size=".1"/>{inside}</body></body></frame>'
        "</worldbody></mujoco>"
    )


def written(text: str, folder: Path) -> tuple[tuple[str, ...], Path, tb.Tree]:
    source, path = folder / "r.xml", folder / "w.xml"
    source.write_text(text)
    model = ModelFile(source)
    wanted = other(model.tree(), rotors=True)
    return write_model(model, wanted, path), path, wanted


def test_bodies_without_names_in_frames_and_of_geoms_are_found(tmp_path: Path) -> None:
    inside = '<body pos=".1 0 0"><geom size=".05"/></body>'
    notes, path, wanted = written(mjcf(inside=inside), tmp_path)
    assert notes == ()
    assert_same(tb.load_tree(path), wanted)
    compiled = mujoco.MjModel.from_xml_path(str(path))
    total = sum(body.mass for body in wanted.inertias)
    assert float(compiled.body_mass.sum()) == pytest.approx(total, rel=1e-9)
    assert b"quat" not in path.read_bytes()


def test_what_readers_would_make_otherwise_is_said_or_refused(tmp_path: Path) -> None:
    """Nothing is written that would be read as another robot."""
    for said, compiler, before in (
        ('boundmass="500"', 'boundmass="500"', ""),
        ('boundinertia="500"', 'boundinertia="500"', ""),
        ("balanceinertia", 'balanceinertia="true"', ""),
        ("friction", "", '<option><flag frictionloss="disable"/></option>'),
    ):
        notes, path, _ = written(mjcf(compiler, before), tmp_path)
        assert any(said in note for note in notes)
    classes = '<default><joint damping="3" armature="0.1" frictionloss="2"/></default>'
    notes, path, wanted = written(mjcf(before=classes), tmp_path)
    assert notes == ()
    assert_same(tb.load_tree(path), wanted)
    path.unlink()
    (tmp_path / "arm.xml").write_text('<mujoco><body><joint/><geom size="1"/></body></mujoco>')
    copies = '<replicate count="2"><body><geom size="1"/></body></replicate>'
    for said, text in (
        ("inertiafromgeom", mjcf('inertiafromgeom="true"')),
        ("settotalmass", mjcf('settotalmass="5"')),
        ("DOCTYPE", "<!DOCTYPE mujoco>" + mjcf()),
        ("replicate", mjcf(inside=copies)),
        ("include", mjcf(inside='<include file="arm.xml"/>')),
    ):
        with refuses(tb.TestbedError, said, "r.xml"):
            written(text, tmp_path)
        assert not path.exists()


# edits of XML as bytes

TEXT = b"""<?xml version="1.0"?>
<!-- a <link name="no"/> here -->
<robot name = "r">
  <link name='a' note="x > y"><mass value="1" /></link>
\t<link name="b"
        note='"'   />
  <link/><link></link>
</robot>
"""


EDITS: list[tuple[int, dict[str, str | None], bytes, bytes]] = [
    (0, {"name": "c"}, b"'a'", b"'c'"),
    (0, {"name": None, "note": "z"}, b" name='a' note=\"x > y\"", b' note="z"'),
    (1, {"more": "1 2"}, b"note='\"'   />", b'note=\'"\' more="1 2"   />'),
    (1, {"note": "n", "name": "m"}, b'"b"\n        note=\'"\'', b"\"m\"\n        note='n'"),
    (2, {"p": "1", "q": "2"}, b"<link/>", b'<link p="1" q="2"/>'),
    (3, {"p": None}, b"<link></link>", b"<link></link>"),
]


def test_what_was_asked_of_a_file_is_there_and_not_another_byte_has_changed() -> None:
    """Comments, quotes and blanks of other people's files stay: their differences stay readable."""
    for place, values, old, new in EDITS:
        found = XmlBytes(TEXT, "r.urdf")
        found.set(found.root.children[place], **values)
        assert found.edited() == TEXT.replace(old, new)


def test_what_is_put_into_a_file_stands_on_its_own_line() -> None:
    """Indented as its element is; one without an end tag gets one."""
    end = b"\r\n"
    found = XmlBytes(TEXT.replace(b"\n", end), "r.urdf")
    for element, name in zip(found.root.children, ("first", "second", "", "third"), strict=True):
        if name:
            found.insert(element, f"<{name}/>")
    wanted = TEXT.replace(b'y">', b'y">\n    <first/>')
    wanted = wanted.replace(b"note='\"'   />", b"note='\"'>\n\t  <second/>\n\t</link>")
    wanted = wanted.replace(b"<link></link>", b"<link>\n  <third/></link>")
    assert found.edited() == wanted.replace(b"\n", end)
    for data in (TEXT.decode().encode("utf-16"), b"<robot>", b"", b"<!DOCTYPE robot><robot/>"):
        with refuses(ModelError, "r.urdf"):
            XmlBytes(data, "r.urdf")
    assert comment(["a -- b", "  c---d", "ü"]) == "<!-- a - - b c- - -d \\xfc -->"
