"""Files with other inertials: read as meant, by all readers, and not another byte changed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.bodies.write_model import FixedLinkShare, write_model, write_models
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import ModelError
from testbed.core.robot.drive_torque import drive_torque
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.model_file import ModelFile, mimic_joints
from testbed.lab.experiment.evaluate import perturbed_robot
from tests.helpers.paths import REAL, ROOT
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.plants import by_mj_inverse
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, assert_same_tree, random_robot, random_states
from tests.helpers.strategies import few, robots, seeds

FIXED: tuple[FixedLinkShare, ...] = ("lump", "share")
CHANGED = re.compile(
    rb"<inertial\b[^>]*/>|<inertial>.*?</inertial>|<dynamics[^>]*/>|\s+(?:frictionloss|damping|armature)=\S+|\s+",
    re.DOTALL,
)
"""What may change, and blanks."""


def other(tree: tb.Tree, seed: int = 0, *, rotors: bool = False) -> tb.Tree:
    """The robot with other bodies and losses."""
    rng = np.random.default_rng(seed)
    kinds = ("coulomb", "viscous", "rotor_inertia")[: 3 if rotors else 2]
    losses: dict[str, dict[str, object]] = {
        name: {kind: float(rng.uniform(0, 5)) for kind in kinds} for name in tree.names
    }
    return perturbed_robot(tree, 0.5, rng).with_joints(losses)


def rewritten(model: ModelFile, wanted: tb.Tree, path: Path, **how: Any) -> tuple[Diagnostic, ...]:
    """What is said of a file that is written, and then read as the robot that is wanted."""
    notes = write_model(model, wanted, path, **how)
    assert_same_tree(replace(model, path=path).tree(), wanted)
    return notes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "fixed"),
    [
        (ROOT / "models/puma562.xml", "lump"),
        (REAL / "panda_description/urdf/panda.urdf", "share"),
        (REAL / "g1_description/urdf/g1_29dof_rev_1_0.urdf", "lump"),
    ],
)
def test_what_is_written_is_read_the_rest_stays(
    path: Path, fixed: FixedLinkShare, tmp_path: Path
) -> None:
    """Comments, quotes and blanks of other people's files stay: differences stay readable."""
    model = ModelFile(path, path.stem.startswith("g1"), lock=dict.fromkeys(mimic_joints(path)))
    made = tmp_path / f"written{path.suffix}"
    wanted = other(model.tree(), rotors=path.suffix == ".xml")
    rewritten(model, wanted, made, fixed=fixed, note=["made -- by a test", "é"])
    before, after = path.read_bytes(), made.read_bytes()
    note = re.search(rb"\s*<!-- made.*?-->", after)
    assert note is not None
    assert note[0].strip() == rb"<!-- made - - by a test \xe9 -->"
    left = after.replace(note[0], b"", 1)
    assert CHANGED.sub(b"", left) == CHANGED.sub(b"", before)
    write_model(model, model.tree(), made, note=["same"])  # nothing new: not a byte
    assert re.sub(rb"\n *<!-- same -->", b"", made.read_bytes(), count=1) == before


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
            assert rewritten(ModelFile(source), wanted, path) == ()
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
  <link  name = 'arm' note="x > y"><inertial>\r
    <mass value='2'/><!-- weighed --><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>\r
  </inertial></link>\r
  <joint name="a" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>\r
    <!-- épaule > <link name="bras"/> -->\r
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


def test_matter_of_what_moves_together_is_shared_as_asked(tmp_path: Path) -> None:
    """Lumped into the links that joints carry, a held finger keeping its part; or in all.

    A byte order mark and accents stay; a link without inertial gets one on lines of its own; no
    inertia is lost.
    """
    bare = re.sub(r">\s*<inertial>.*?</inertial></link>", " />", CARRYING, flags=re.DOTALL)
    massless = CARRYING.replace('<mass value="1"/>', '<mass value="0"/>')
    source, path = tmp_path / "r.urdf", tmp_path / "w.urdf"
    body = Inertia.about_centre(3.0, [0.1, 0, 0], np.eye(3))
    texts = (bare, "lump"), (massless, "lump"), (CARRYING, "lump"), (CARRYING, "share")
    for text, fixed in texts:
        source.write_bytes(b"\xef\xbb\xbf" + text.encode())
        model = ModelFile(source, lock={"grip": 0.3})
        notes = rewritten(model, replace(other(model.tree()), inertias=(body,)), path, fixed=fixed)
        assert bool(notes) == (text is bare)  # no measure of what to share
        data = path.read_bytes()
        for kept in ("\ufeff<?xml", 'épaule > <link name="bras"/> -->', '<link name="frame" />'):
            assert kept.encode() in data
        assert data.count(b"\r\n") == data.count(b"\n")
        if text is bare:
            start, _, end = data.partition(b"<inertial>")
            assert start.endswith(b"\r\n  <link  name = 'arm' note=\"x > y\">\r\n    ")
            assert end.partition(b"</inertial>")[2].startswith(b"\r\n  </link>\r\n  <joint")
        if text is CARRYING:
            free = tb.load_tree(path)  # the finger's joint is free in the file
            masses = [each.mass for each in free.inertias]
            assert masses == pytest.approx([3.0 * 3 / 3.5, 3.0 * 0.5 / 3.5], rel=1e-9)
            assert all(np.linalg.eigvalsh(each.pseudo)[0] > 0 for each in free.inertias)
            tool = re.search(rb'<link name="tool">.*?<mass value="([^"]*)"', data, re.DOTALL)
            assert tool is not None
            assert (float(tool[1]) == 0) == (fixed == "lump")


@pytest.mark.parametrize("form", ["urdf", "xml"])
def test_what_cannot_be_is_written_as_what_can_sound_links_stay(form: str, tmp_path: Path) -> None:
    """Else the copy is as impossible as the file was: nobody else can load it."""
    robot = random_robot(np.random.default_rng(1), 3)
    flat = np.diag([1e-3, 1e-3, 1e-2])
    odd = replace(robot, pedestal=replace(robot.pedestal, central=flat))
    held = replace(robot, links=(*robot.links[:2], replace(robot.links[2], central=flat)))
    source, path = tmp_path / f"r.{form}", tmp_path / f"w.{form}"
    for flawed, lock in ((held, {"j3": 0.3}), (odd, {})):  # on a held joint it hides
        source.write_text(flawed.urdf() if form == "urdf" else flawed.mjcf())
        model = ModelFile(source, lock=lock)
        for fixed in FIXED:
            rewritten(model, other(model.tree()), path, fixed=fixed)
            assert tb.load_tree(path, repair={}).n == 3  # refuses what cannot be
    repaired = model.tree()
    write_model(model, repaired, path)
    assert_same_tree(tb.load_tree(path, repair={}), repaired)
    given = {"j2_body": Inertia.about_centre(2.0, [0.1, 0, 0], np.eye(3))}
    model = ModelFile(source, repair=given | {"pedestal_body": repaired.pedestal})
    write_model(model, model.tree(), path)
    assert_same_tree(tb.load_tree(path, repair={}), model.tree())
    with refuses(ModelError, "pedestal", str(source)):  # known, and not for an estimate to move
        heavier = repaired.with_inertia(-1, given["j2_body"])
        write_model(ModelFile(source), heavier, tmp_path / f"n.{form}")
    assert not (tmp_path / f"n.{form}").exists()


def test_nothing_is_written_where_it_may_not_be(tmp_path: Path) -> None:
    """Somebody's model would be lost, or a copy stand under a name that no reader takes."""
    source = tmp_path / "r.urdf"
    source.write_text(random_robot(np.random.default_rng(0), 3).urdf())
    model, before = ModelFile(source), source.read_bytes()
    wanted = other(model.tree())
    (tmp_path / "link.urdf").symlink_to(source)
    places = {"r.urdf": "--in-place", "link.urdf": "--in-place", "w.xml": ".urdf"}
    for name, culprit in places.items():
        with refuses(tb.TestbedError, name, culprit):
            write_model(model, wanted, tmp_path / name)
    assert source.read_bytes() == before
    rewritten(model, wanted, source, over_source=True)
    (note,) = write_model(model, other(model.tree(), rotors=True), tmp_path / "w.urdf")
    assert "j1 " in note.text  # URDF has no place for rotors' inertias
    source.write_text(source.read_text(), encoding="utf-16")
    with refuses(ModelError, "r.urdf"):
        write_model(model, other(model.tree()), tmp_path / "w.urdf")


def mjcf(compiler: str = "", before: str = "", inside: str = "") -> str:
    """Bodies without names, in a frame, one of a geom."""
    return (
        f'<mujoco><compiler angle="radian" {compiler}/>{before}<worldbody>'
        '<frame pos="0 0 1"><body><joint axis="0 1 0" damping="1"/>'
        '<inertial mass="1" pos="0 0 .1" quat="1 1 0 0" diaginertia="1 2 2"/>'
        f'<body pos="0 0 1"><joint/><geom size=".1"/>{inside}</body></body></frame>'
        "</worldbody></mujoco>"
    )


SAID = [
    ("", mjcf(inside='<body pos=".1 0 0"><geom size=".05"/></body>')),
    ("", mjcf(before='<default><joint damping="3" armature=".1" frictionloss="2"/></default>')),
    ('boundmass="500"', mjcf('boundmass="500"')),
    ('boundinertia="500"', mjcf('boundinertia="500"')),
    ("balanceinertia", mjcf('balanceinertia="true"')),
    ("friction", mjcf(before='<option><flag frictionloss="disable"/></option>')),
]
REFUSED = [
    ("inertiafromgeom", mjcf('inertiafromgeom="true"')),
    ("settotalmass", mjcf('settotalmass="5"')),
    ("DOCTYPE", "<!DOCTYPE mujoco>" + mjcf()),
    ("replicate", mjcf(inside='<replicate count="2"><body><geom size="1"/></body></replicate>')),
    ("include", mjcf(inside='<include file="arm.xml"/>')),
]


def test_what_readers_would_make_otherwise_is_said_or_refused(tmp_path: Path) -> None:
    """Nothing is written that would be read as another robot."""
    source, path = tmp_path / "r.xml", tmp_path / "w.xml"
    for said, text in SAID:
        source.write_text(text)
        model = ModelFile(source)
        wanted = other(model.tree(), rotors=True)
        notes = write_model(model, wanted, path) if said else rewritten(model, wanted, path)
        assert [note for note in notes if said not in str(note)] == []
        assert bool(notes) == bool(said)
        if not said:
            masses = mujoco.MjModel.from_xml_path(str(path)).body_mass
            assert masses.sum() == pytest.approx(sum(x.mass for x in wanted.inertias), rel=1e-9)
    path.unlink()
    (tmp_path / "arm.xml").write_text('<mujoco><body><joint/><geom size="1"/></body></mujoco>')
    for said, text in REFUSED:
        source.write_text(text)
        with refuses(tb.TestbedError, said, "r.xml"):
            write_model(ModelFile(source), other(ModelFile(source).tree()), path)
        assert not path.exists()


@pytest.mark.slow
@few(6)
@given(robots((2, 6)), seeds)
def test_many_robots_as_files_and_mujocos_fields_are_as_meant(robot: Robot, seed: int) -> None:
    """A batch of models from the archive moves as the files do, and both as the trees."""
    for ending, text in (("urdf", robot.urdf()), ("xml", robot.mjcf())):
        with TemporaryDirectory() as folder:
            source, out = Path(folder, f"robot.{ending}"), Path(folder, "out")
            source.write_text(text)
            model = ModelFile(source)
            trees = [other(model.tree(), seed + k) for k in range(3)]
            write_models(model, trees, out, note=["a draw"])
            draws, batch = np.load(out / "robots.npz"), mujoco.MjModel.from_xml_path(str(source))
            names = {batch.body(k).name for k in range(batch.nbody)}
            kept = [k for k, name in enumerate(draws["bodies"]) if name in names]
            bodies = [batch.body(draws["bodies"][k]).id for k in kept]
            dofs = [batch.joint(name).dofadr[0] for name in draws["joints"]]
            for k, tree in enumerate(trees):
                path = out / f"robot_{k:04d}.{ending}"
                assert_same_tree(replace(tb.load_tree(path), name=tree.name), tree, 1e-9)
                for field in ("body_mass", "body_ipos", "body_inertia", "body_iquat"):
                    getattr(batch, field)[bodies] = draws[field][k][kept]
                for field in ("dof_frictionloss", "dof_damping"):
                    values = getattr(batch, field)
                    values[dofs] = draws[field][k].reshape(-1, *[1] * (values.ndim - 1))
                alone = mujoco.MjModel.from_xml_path(str(path))
                one, two = (inverse(each, tree.n, seed) for each in (batch, alone))
                np.testing.assert_allclose(one, two, atol=1e-9 * np.abs(two).max())


def inverse(model: mujoco.MjModel, n: int, seed: int) -> Array:
    """What MuJoCo says a state needs."""
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    mujoco.mj_setConst(model, data)
    data.qpos[:], data.qvel[:], data.qacc[:] = rng.normal(size=(3, n))
    mujoco.mj_inverse(model, data)
    return np.array(data.qfrc_inverse)
