"""Bodies that cannot be: judged with what is fixed to them, repaired to the nearest that can."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import InertiaError, UnknownName
from testbed.robot.inertia import Inertia, inertia_flaw, nearest_body
from testbed.robot.load import nearest_bodies
from testbed.robot.model_file import ModelFile
from testbed.robot.repair import THINNEST
from testbed.robot.rotations import from_rpy
from testbed.robot.write_model import write_model
from testbed.simulation.build import build_plant
from tests.helpers.paths import REAL
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.robots import Robot, random_robot, random_states

FRAMES = {
    "massless": (0.0, (0.0, 0.0, 0.0)),
    "a gramme's millionth": (1e-9, (0.0, 0.0, 0.0)),
    "a point": (0.02, (0.0, 0.0, 0.0)),
    "rounding": (1e-6, (-1.99e-22, 8.5e-23, 3e-6)),
    "thin": (0.05, (1e-5, 1e-5, 2.002e-5)),
    "inertia without mass": (0.0, (5.3e-7, 5.7e-7, 8.4e-7)),
}
"""Mass and principal moments of links that files fix to others."""

NEVER = {
    "a point": (1.3, (0.0, 0.0, 0.0)),
    "triangle": (0.3, (1e-3, 1e-3, 1e-2)),
    "negative moment": (0.3, (1e-3, 1e-3, -1e-3)),
    "no mass": (0.0, (1e-3, 1e-3, 1e-3)),
}
"""Of links that move, and that no body is near by rounding."""


def with_frames(rng: np.random.Generator, robot: Robot, form: str) -> str:
    """The robot's text with a flawed link of each kind fixed to some link."""
    root = ET.fromstring(robot.urdf() if form == "urdf" else robot.mjcf())
    for k, (mass, moments) in enumerate(FRAMES.values()):
        xyz, com = (" ".join(map(repr, rng.uniform(-0.2, 0.2, 3).tolist())) for _ in range(2))
        if form == "urdf":
            on = rng.choice([link.get("name", "") for link in root.findall("link")])
            joint = ET.SubElement(root, "joint", name=f"weld{k}", type="fixed")
            ET.SubElement(joint, "parent", link=str(on))
            ET.SubElement(joint, "child", link=f"frame{k}")
            ET.SubElement(joint, "origin", xyz=xyz, rpy="0.3 -0.2 0.1")
            _inertial(ET.SubElement(root, "link", name=f"frame{k}"), mass, moments, com)
        else:
            bodies = list(root.iter("body"))
            body = ET.SubElement(
                bodies[rng.integers(len(bodies))], "body", name=f"frame{k}", pos=xyz
            )
            diagonal = " ".join(map(repr, moments))
            ET.SubElement(body, "inertial", mass=repr(mass), pos=com, diaginertia=diagonal)
    return ET.tostring(root, encoding="unicode")


def _inertial(
    link: ET.Element, mass: float, moments: tuple[float, ...], com: str = "0 0 0"
) -> None:
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=com)
    ET.SubElement(inertial, "mass", value=repr(mass))
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    ET.SubElement(
        inertial, "inertia", dict(zip(keys, (*map(repr, moments), "0", "0", "0"), strict=True))
    )


def set_link(text: str, name: str, mass: float, moments: tuple[float, ...]) -> str:
    """A robot's text with another inertia of one link, in either format."""
    root = ET.fromstring(text)
    (link,) = (e for tag in ("link", "body") for e in root.iter(tag) if e.get("name") == name)
    (inertial,) = link.findall("inertial")
    if link.tag == "body":
        diagonal = " ".join(map(repr, moments))
        inertial.attrib = {
            "mass": repr(mass),
            "pos": inertial.get("pos", ""),
            "diaginertia": diagonal,
        }
    else:
        (origin,) = inertial.findall("origin")
        link.remove(inertial)
        _inertial(link, mass, moments, origin.get("xyz", ""))
    return ET.tostring(root, encoding="unicode")


def written(text: str, folder: Path, form: str = "urdf") -> Path:
    path = folder / f"r.{form}"
    path.write_text(text)
    return path


def assert_same(a: tb.Tree, b: tb.Tree) -> None:
    for one, other in zip((*a.inertias, a.pedestal), (*b.inertias, b.pedestal), strict=True):
        np.testing.assert_allclose(one.pseudo, other.pseudo, rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize("seed", range(10))
def test_flaws_of_fixed_links_are_their_carrier_s_and_harmless(seed: int, tmp_path: Path) -> None:
    """Dynamics are those of Pinocchio's own fusing, nothing is repaired, MuJoCo simulates it."""
    rng = np.random.default_rng(seed)
    text = with_frames(rng, random_robot(rng, int(rng.integers(1, 7))), "urdf")
    path = written(text, tmp_path)
    tree = tb.load_tree(path, repair={})
    assert tree.warnings == ()
    states = random_states(rng, 5, tree.n)
    witness = by_pinocchio(text, tree, states)
    motion = tb.Motion(np.arange(5.0), *states)
    scale = np.abs(witness.wrench).max()
    np.testing.assert_allclose(tb.joint_forces(tree, motion), witness.forces, atol=1e-12 * scale)
    np.testing.assert_allclose(tb.base_wrench(tree, motion), witness.wrench, atol=1e-12 * scale)
    build_plant(ModelFile(path, repair={}), tree, 1e-3)  # checks itself


@pytest.mark.parametrize("seed", range(10))
def test_the_same_holds_of_mjcf(seed: int, tmp_path: Path) -> None:
    """Whose bodies are those of a URDF with the same links."""
    robot = random_robot(np.random.default_rng(seed), 4)
    texts = {}
    for form in ("urdf", "xml"):
        rng = np.random.default_rng(seed)
        texts[form] = with_frames(rng, robot, form)
    path = written(texts["xml"], tmp_path, "xml")
    tree = tb.load_tree(path, repair={})
    assert tree.warnings == ()
    build_plant(ModelFile(path, repair={}), tree, 1e-3)
    bare = robot.tree()
    heavier = sum(mass for mass, _ in FRAMES.values())
    total = [sum(i.mass for i in (*t.inertias, t.pedestal)) for t in (tree, bare)]
    assert total[0] - total[1] == pytest.approx(heavier, rel=1e-9)


@pytest.mark.parametrize("seed", range(50))
def test_the_nearest_body_is_the_projection_of_what_was_given(seed: int) -> None:
    """Optimality of the nearest matrix in a cone, of second moments about the same mass centre."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    second = axes * (rng.uniform(-0.5, 1.0, 3) * 0.1) @ axes.T
    if np.linalg.eigvalsh(second)[-1] <= 0:
        second = -second
    mass, com = rng.uniform(0.1, 9), rng.normal(size=3) * 0.2
    given = Inertia.about_centre(mass, com, np.trace(second) * np.eye(3) - second)
    found = nearest_body(given, THINNEST, 1.0, 1.0)
    assert inertia_flaw("b", found.mass, found.central) is None
    assert found.mass == mass
    np.testing.assert_allclose(found.com, com, rtol=1e-13)
    new = _second(found)
    change, slack = new - second, new - THINNEST * np.linalg.eigvalsh(second)[-1] * np.eye(3)
    size = np.abs(second).max()
    for matrix in (change, slack):
        assert np.linalg.eigvalsh(matrix)[0] >= -1e-12 * size
    assert abs(np.sum(change * slack)) <= 1e-12 * size**2


def _second(body: Inertia) -> Array:
    return np.asarray(np.trace(body.central) / 2 * np.eye(3) - body.central)


@pytest.mark.parametrize("form", ["urdf", "xml"])
@pytest.mark.parametrize("kind", NEVER)
@pytest.mark.parametrize("seed", range(3))
def test_what_cannot_be_is_refused_or_repaired(
    seed: int, kind: str, form: str, tmp_path: Path
) -> None:
    """The repair is possible, alters no other body and needs none again; the plant has the same."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, 4)
    k = int(rng.integers(4))
    name, text = f"{robot.links[k].name}_body", robot.urdf() if form == "urdf" else robot.mjcf()
    sound = tb.load_tree(written(text, tmp_path, form))
    path = written(set_link(text, name, *NEVER[kind]), tmp_path, form)
    with pytest.raises(InertiaError, match=f"'{name}'.*`testbed new`"):
        tb.load_tree(path, repair={})
    found = nearest_bodies(path)
    assert list(found.bodies) == [name]
    assert inertia_flaw(name, found.bodies[name].mass, found.bodies[name].central) is None
    tree, again = tb.load_tree(path), tb.load_tree(path, repair=found.bodies)
    (line,) = tree.warnings
    assert f"'{name}'" in line
    assert again.warnings == ()
    assert_same(tree, again)
    others = [j for j, joint in enumerate(tree.joints) if joint.body != name]
    for j in others:
        np.testing.assert_array_equal(tree.inertias[j].pseudo, sound.inertias[j].pseudo)
    build_plant(ModelFile(path, repair=found.bodies), tree, 1e-3)
    build_plant(ModelFile(path), tree, 1e-3)


@pytest.mark.parametrize("form", ["urdf", "xml"])
@pytest.mark.parametrize("kind", NEVER)
def test_a_written_file_has_only_bodies_that_can_be(kind: str, form: str, tmp_path: Path) -> None:
    """Those that were repaired, too, whatever else was changed."""
    robot = random_robot(np.random.default_rng(2), 4)
    text = with_frames(np.random.default_rng(2), robot, form)
    path = written(set_link(text, "j3_body", *NEVER[kind]), tmp_path, form)
    model = ModelFile(path)
    tree = model.tree().with_inertia(1, Inertia.about_centre(5.0, (0, 0, 0.1), np.eye(3)))
    write_model(model, tree, tmp_path / f"w.{form}")
    assert_same(tb.load_tree(tmp_path / f"w.{form}", repair={}), tree)


@pytest.mark.parametrize("form", ["urdf", "xml"])
@pytest.mark.parametrize("seed", range(5))
def test_bodies_that_can_be_are_not_touched(seed: int, form: str, tmp_path: Path) -> None:
    robot = random_robot(np.random.default_rng(seed), 5)
    path = written(robot.urdf() if form == "urdf" else robot.mjcf(), tmp_path, form)
    found = nearest_bodies(path)
    assert (found.links, found.bodies, found.notes) == ({}, {}, ())
    assert_same(tb.load_tree(path), tb.load_tree(path, repair={}))


@pytest.mark.parametrize("form", ["urdf", "xml"])
@pytest.mark.parametrize("moments", [(1e-3, 1e-3, 2.0001e-3), (-2e-22, 2e-3, 2e-3)], ids=str)
def test_rounding_is_corrected_and_said_whatever_is_asked_for(
    moments: tuple[float, ...], form: str, tmp_path: Path
) -> None:
    robot = random_robot(np.random.default_rng(1), 3)
    text = robot.urdf() if form == "urdf" else robot.mjcf()
    path = written(set_link(text, "j2_body", 0.5, moments), tmp_path, form)
    tree = tb.load_tree(path, repair={})
    (line,) = tree.warnings
    assert "'j2_body' is corrected within rounding" in line
    body = tree.inertias[1]
    assert inertia_flaw("j2_body", body.mass, body.central) is None
    np.testing.assert_allclose(np.linalg.eigvalsh(body.central), moments, atol=2e-4 * 2e-3)
    build_plant(ModelFile(path, repair={}), tree, 1e-3)


def test_a_chain_s_bare_end_gets_matter_and_a_frame_on_the_way_does_not(tmp_path: Path) -> None:
    robot = random_robot(np.random.default_rng(3), 3)
    chain = replace(robot, links=tuple(replace(x, parent=k - 1) for k, x in enumerate(robot.links)))
    root = ET.fromstring(chain.urdf())
    for link in root.findall("link"):
        if link.get("name") in ("j1_body", "j3_body"):
            link.remove(link.findall("inertial")[0])
    path = written(ET.tostring(root, encoding="unicode"), tmp_path)
    with pytest.raises(InertiaError, match="'j3_body' moves"):
        tb.load_tree(path, repair={})
    tree = tb.load_tree(path)
    masses = [inertia.mass for inertia in tree.inertias]
    assert masses[0] == 0
    assert 0 < masses[2] < 1e-4 * masses[1]
    assert tb.load_tree(path, repair={}, lock={"j3": None}).n == 2  # held, it is a frame


def test_a_robot_without_any_mass_is_read_as_it_stands(tmp_path: Path) -> None:
    root = ET.fromstring(random_robot(np.random.default_rng(3), 3).urdf())
    for link in root.findall("link"):
        link.remove(link.findall("inertial")[0])
    tree = tb.load_tree(written(ET.tostring(root, encoding="unicode"), tmp_path), repair={})
    assert not any(inertia.pseudo.any() for inertia in tree.inertias)


def test_bodies_are_given_for_links_that_carry_others(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path = written(with_frames(rng, random_robot(rng, 3), "urdf"), tmp_path)
    body = Inertia.about_centre(2.0, (0.1, 0, 0), np.eye(3))
    tree = tb.load_tree(path, repair={"j2_body": body})
    np.testing.assert_allclose(tree.inertias[1].pseudo, body.pseudo, rtol=1e-15)
    build_plant(ModelFile(path, repair={"j2_body": body}), tree, 1e-3)
    for name in ("frame0", "j2_bdy"):
        with pytest.raises(UnknownName, match=f"'{name}'"):
            tb.load_tree(path, repair={name: body})
    flat = Inertia.about_centre(2.0, np.zeros(3), np.diag([1.0, 1.0, 9.0]))
    with pytest.raises(InertiaError, match="'j2_body'"):
        tb.load_tree(path, repair={"j2_body": flat})


def test_angles_rounded_in_the_file_are_right_ones_and_others_stay(tmp_path: Path) -> None:
    """In tree and plant."""
    root = ET.fromstring(random_robot(np.random.default_rng(3), 4).urdf())
    said = {
        "j1": ("1.5708 0 -3.14159", (np.pi / 2, 0, -np.pi)),
        "j2": ("0 -1.57079 6.283185", (0, -np.pi / 2, 2 * np.pi)),
        "j3": ("1.5709 2e-6 0", (1.5709, 0, 0)),
        "j4": ("0.785398 1e-4 1.5707", (0.785398, 1e-4, 1.5707)),
    }
    for element in root.findall("joint"):
        element.findall("origin")[0].set("rpy", said[element.get("name", "")][0])
    path = written(ET.tostring(root, encoding="unicode"), tmp_path)
    tree = tb.load_tree(path)
    for joint in tree.joints:
        wanted = from_rpy(said[joint.name][1])
        np.testing.assert_allclose(joint.rotation, wanted, atol=1e-15)
    build_plant(ModelFile(path), tree, 1e-3)


def test_a_robot_without_a_name_is_called_after_its_file(tmp_path: Path) -> None:
    root = ET.fromstring(random_robot(np.random.default_rng(0), 2).urdf())
    del root.attrib["name"]
    path = written(ET.tostring(root, encoding="unicode"), tmp_path)
    tree = tb.load_tree(path)
    assert tree.name == "r"
    build_plant(ModelFile(path), tree, 1e-3)


@pytest.mark.parametrize("name", ["xarm7", "kinova"])
def test_formulas_of_robots_with_rounded_angles_hold_no_rounding(name: str) -> None:
    """No parameter is a combination with a millionth of another."""
    tree = tb.load_tree(next(REAL.rglob(f"{name}.urdf")))
    for model in ("dynamic", "reaction"):
        matrix = tb.minimal_set(tree, model).matrix
        assert np.abs(matrix[matrix != 0]).min() > 1e-5
