"""Files with other inertials: read as meant, by all readers, and not another byte changed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import testbed as tb
from testbed.experiment.wrong_prior import wrong_bodies
from testbed.robot.friction import drive_torque
from testbed.robot.inertia import Inertia
from testbed.robot.links import Fixed
from testbed.robot.load import mimic_joints
from testbed.robot.model_file import ModelFile
from testbed.robot.write_model import write_model
from tests.helpers.mujoco_inverse import by_mj_inverse
from tests.helpers.paths import GOLDEN, REAL, ROOT
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.robots import random_robot, random_states

MODELS = {
    "puma.xml": ROOT / "models/puma562.xml",
    "puma.urdf": ROOT / "models/puma562.urdf",
    "ur5.urdf": GOLDEN / "robots/ur5.urdf",
    "gantry.urdf": GOLDEN / "robots/gantry_ppp_rrr.urdf",
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


@pytest.mark.parametrize("fixed", ["lump", "share"])
@pytest.mark.parametrize("name", MODELS)
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


@pytest.mark.parametrize("name", ["puma.xml", "puma.urdf", "panda.urdf"])
def test_a_tree_as_it_was_changes_nothing_but_the_comment(name: str, tmp_path: Path) -> None:
    model, path = model_of(name), tmp_path / f"written{Path(name).suffix}"
    write_model(model, model.tree(), path, note=["same"])
    assert re.sub(rb"\n *<!-- same -->", b"", path.read_bytes(), count=1) == model.path.read_bytes()


@pytest.mark.parametrize("seed", range(8))
def test_random_trees_by_two_formats_and_three_readers(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, 3 + seed)
    for ending, text in (("urdf", robot.urdf()), ("xml", robot.mjcf())):
        source, path = tmp_path / f"source.{ending}", tmp_path / f"written.{ending}"
        source.write_text(text)
        wanted = other(tb.load_tree(source), seed, rotors=ending == "xml")
        assert write_model(ModelFile(source), wanted, path) == ()
        assert_same(tb.load_tree(path), wanted)
        compiled = mujoco.MjModel.from_xml_path(str(path))
        for joint, body in zip(wanted.joints, wanted.inertias, strict=True):
            there = compiled.body(joint.body).id
            assert compiled.body_mass[there] == pytest.approx(body.mass, rel=1e-12)
            place = compiled.body_ipos[there]
            np.testing.assert_allclose(place, body.com, atol=1e-12)
        if ending == "urdf":
            read = pin.buildModelFromUrdf(str(path))
            for joint, body in zip(wanted.joints, wanted.inertias, strict=True):
                assert read.inertias[read.getJointId(joint.name)].mass == body.mass


def test_torques_of_the_written_file_in_other_engines(tmp_path: Path) -> None:
    """Plain Pinocchio and mj_inverse, on an unseen motion; dry friction is the solver's there."""
    rng = np.random.default_rng(3)
    robot = random_robot(rng, 6)
    states = random_states(rng, 20, 6)
    motion = tb.Motion(np.arange(20.0), *states)
    for ending, text in (("urdf", robot.urdf()), ("xml", robot.mjcf())):
        source, path = tmp_path / f"source.{ending}", tmp_path / f"written.{ending}"
        source.write_text(text)
        wanted = other(tb.load_tree(source), 5, rotors=ending == "xml")
        write_model(ModelFile(source), wanted, path)
        ours = tb.joint_forces(wanted, motion)
        if ending == "urdf":
            theirs = by_pinocchio(path.read_text(), wanted, states).forces
        else:
            ours = ours + drive_torque(wanted.with_joints(FREE_OF_DRY), *states[1:])
            theirs = by_mj_inverse(path, wanted, states)
        np.testing.assert_allclose(theirs, ours, atol=1e-10 * np.abs(ours).max())


FREE_OF_DRY = {f"j{k}": {"coulomb": 0.0} for k in range(1, 7)}


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


@pytest.mark.parametrize("fixed", ["lump", "share"])
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


def test_a_byte_order_mark_and_accents_stay(tmp_path: Path) -> None:
    text = CARRYING.replace("<!-- the arm -->", "<!-- épaule > bras -->")
    source, path = tmp_path / "r.urdf", tmp_path / "w.urdf"
    source.write_bytes(b"\xef\xbb\xbf" + text.encode())
    model = ModelFile(source, lock={"grip": None})
    wanted = other(model.tree())
    write_model(model, wanted, path)
    assert_same(replace(model, path=path).tree(), wanted)
    assert "<!-- épaule > bras -->".encode() in path.read_bytes()
    assert path.read_bytes().startswith(b"\xef\xbb\xbf<?xml")


def test_a_link_without_inertial_gets_one(tmp_path: Path) -> None:
    text = CARRYING.replace('<link name="frame" />', '<link name="frame"/>')
    source, path = tmp_path / "r.urdf", tmp_path / "w.urdf"
    source.write_bytes(re.sub(r"<inertial>.*?</inertial>", "", text, flags=re.DOTALL).encode())
    model = ModelFile(source, lock={"grip": None})
    body = Inertia.about_centre(2.0, [0.1, 0, 0], np.eye(3))
    wanted = replace(model.tree(), inertias=(body,))
    notes = write_model(model, wanted, path)
    assert_same(replace(model, path=path).tree(), wanted)
    assert any("no measure" in line for line in notes)
    assert b"<inertial>" in path.read_bytes()


@pytest.mark.parametrize("fixed", ["lump", "share"])
def test_inertia_without_mass_is_not_lost(fixed: Fixed, tmp_path: Path) -> None:
    source, path = tmp_path / "r.urdf", tmp_path / "w.urdf"
    source.write_text(CARRYING.replace('<mass value="1"/>', '<mass value="0"/>'))
    model = ModelFile(source, lock={"grip": None})
    wanted = other(model.tree())
    write_model(model, wanted, path, fixed=fixed)
    assert_same(replace(model, path=path).tree(), wanted)


def test_nothing_is_written_where_it_may_not_be(tmp_path: Path) -> None:
    source = tmp_path / "r.urdf"
    source.write_text(random_robot(np.random.default_rng(0), 3).urdf())
    model, before = ModelFile(source), source.read_bytes()
    wanted = other(model.tree())
    (tmp_path / "link.urdf").symlink_to(source)
    for place in (source, tmp_path / "link.urdf"):
        with pytest.raises(tb.TestbedError, match="in-place"):
            write_model(model, wanted, place)
    with pytest.raises(tb.TestbedError, match=r"ends in \.urdf"):
        write_model(model, wanted, tmp_path / "w.xml")
    assert source.read_bytes() == before
    write_model(model, wanted, source, over_source=True)
    assert_same(tb.load_tree(source), wanted)


def test_what_urdf_has_no_place_for_is_said(tmp_path: Path) -> None:
    source = tmp_path / "r.urdf"
    source.write_text(random_robot(np.random.default_rng(0), 3).urdf())
    model = ModelFile(source)
    (note,) = write_model(model, other(model.tree(), rotors=True), tmp_path / "w.urdf")
    assert "rotors' inertias (j1 " in note


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


@pytest.mark.parametrize(
    ("compiler", "said"),
    [
        ('boundmass="500"', 'boundmass="500"'),
        ('boundinertia="500"', 'boundinertia="500"'),
        ('balanceinertia="true"', "balanceinertia"),
    ],
)
def test_what_mujoco_makes_of_it_is_said(compiler: str, said: str, tmp_path: Path) -> None:
    notes, _, _ = written(mjcf(compiler), tmp_path)
    assert any(said in note for note in notes)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (mjcf('inertiafromgeom="true"'), "inertiafromgeom"),
        (mjcf('settotalmass="5"'), "settotalmass"),
        ("<!DOCTYPE mujoco>" + mjcf(), "DOCTYPE"),
        (
            mjcf(inside='<replicate count="2"><body><geom size="1"/></body></replicate>'),
            "replicate",
        ),
    ],
)
def test_files_that_cannot_be_edited_are_refused(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(tb.TestbedError, match=said):
        written(text, tmp_path)
    assert not (tmp_path / "w.xml").exists()


def test_classes_give_way_and_disabled_friction_is_said(tmp_path: Path) -> None:
    classes = '<default><joint damping="3" armature="0.1" frictionloss="2"/></default>'
    notes, path, wanted = written(mjcf(before=classes), tmp_path)
    assert notes == ()
    assert_same(tb.load_tree(path), wanted)
    option = '<option><flag frictionloss="disable"/></option>'
    notes, _, _ = written(mjcf(before=option), tmp_path)
    assert any("not read" in note for note in notes)


def test_bodies_of_another_file_are_not_looked_for(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text('<mujoco><body><joint/><geom size="1"/></body></mujoco>')
    with pytest.raises(tb.TestbedError, match="include"):
        written(mjcf(inside='<include file="arm.xml"/>'), tmp_path)
