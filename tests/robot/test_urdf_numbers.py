"""A number of a URDF file is read as it stands, or refused by name; never passed over."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import testbed as tb
from testbed.errors import ModelError
from testbed.robot.model_file import ModelFile
from testbed.simulation.build import build_plant
from tests.helpers.robots import random_robot

Place: TypeAlias = tuple[str, str, str]  # holder, element, attribute

PLACES: list[Place] = [
    ("link/inertial", "mass", "value"),
    *(("link/inertial", "inertia", key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    *(("link/inertial", "origin", key) for key in ("xyz", "rpy")),
    *(("joint", "origin", key) for key in ("xyz", "rpy")),
    ("joint", "axis", "xyz"),
    *(("joint", "limit", key) for key in ("lower", "upper", "effort", "velocity")),
    *(("joint", "dynamics", key) for key in ("damping", "friction")),
]
EDITS = "0123456789.,eE+-_ \t\n;xinfapd/\u00a0\uff11\u0663"


def urdf(seed: int) -> ET.Element:
    """A random robot with every number there is."""
    root = ET.fromstring(random_robot(np.random.default_rng(seed), 3).urdf())
    for inertial in root.iterfind("link/inertial/origin"):
        inertial.set("rpy", "0.1 -0.2 0.3")
    for joint in root.iterfind("joint"):
        ET.SubElement(joint, "dynamics", damping="0.5", friction="0.25")
    return root


def same_bits(a: tb.Tree, b: tb.Tree) -> bool:
    parts = [
        [
            *(np.ravel(getattr(j, key)) for j in tree.joints for key in vars(j) if key in NUMBERS),
            *(np.ravel(x) for i in (*tree.inertias, tree.pedestal) for x in vars(i).values()),
        ]
        for tree in (a, b)
    ]
    return all(np.array_equal(one, two) for one, two in zip(*parts, strict=True))


NUMBERS = (
    "axis", "offset", "rotation", "position_range", "max_velocity", "max_effort", "coulomb",
    "viscous",
)  # fmt: skip


def stated(text: str, count: int) -> list[float] | None:
    """What a text says to a person who knows Python's numbers."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return None
    return values if len(values) == count else None


def load(root: ET.Element, folder: Path) -> tb.Tree | str:
    """The robot, or the line that refuses it."""
    (folder / "r.urdf").write_bytes(ET.tostring(root))
    try:
        return tb.load_tree(folder / "r.urdf", repair={})
    except ModelError as error:
        return str(error)


def check_law(root: ET.Element, place: Place, owner: int, text: str, folder: Path) -> None:
    """The law for one text in one place."""
    holder, tag, key = place
    element = root.findall(f"{holder}/{tag}")[owner]
    name = root.findall(holder.removesuffix("/inertial"))[owner].get("name", "")
    values = stated(text, len(element.get(key, "").split()))
    element.set(key, text)
    found = load(root, folder)
    if isinstance(found, str):
        assert f"'{name}'" in found
        assert "\n" not in found
        assert values is not None or (key in found and f"<{tag}>" in found)
        return
    assert values is not None, f"{text!r} was taken for numbers"
    element.set(key, " ".join(repr(value) for value in values))
    again = load(root, folder)
    assert isinstance(again, tb.Tree)
    assert same_bits(found, again)
    if key in READ:
        np.testing.assert_array_equal(READ[key](found, name), np.ravel(values))


READ: dict[str, Callable[[tb.Tree, str], object]] = {
    "value": lambda tree, name: [
        tree.pedestal.mass if name.startswith("pedestal") else inertia_of(tree, name).mass
    ],
    "damping": lambda tree, name: [tree.joints[tree.index(name)].viscous],
    "friction": lambda tree, name: [tree.joints[tree.index(name)].coulomb],
}
"""Where a tree holds what an attribute states."""


def inertia_of(tree: tb.Tree, link: str) -> tb.Inertia:
    return tree.inertias[[joint.body for joint in tree.joints].index(link)]


@st.composite
def edited(draw: st.DrawFn) -> tuple[ET.Element, Place, int, str]:
    """A robot, a place in it, whose it is, and a text that differs by some letters."""
    root, place, owner = (
        urdf(draw(st.integers(0, 5))),
        draw(st.sampled_from(PLACES)),
        draw(st.integers(0, 2)),
    )
    text = root.findall(f"{place[0]}/{place[1]}")[owner].get(place[2], "")
    edits = st.tuples(st.integers(0, 60), st.integers(0, 2), st.text(EDITS, max_size=2))
    for where, length, new in draw(st.lists(edits, min_size=1, max_size=3)):
        at = where % (len(text) + 1)
        text = text[:at] + new + text[at + length :]
    return root, place, owner, text


@given(case=edited())
@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@pytest.mark.slow
def test_edited_numbers_are_read_as_they_stand_or_refused(
    case: tuple[ET.Element, Place, int, str], tmp_path: Path
) -> None:
    check_law(*case, tmp_path)


TEXTS = [
    "3 ", " 3", "3\n", "+3", "3.", ".5", "3E0", "0", "-0.0", "1e-320", "3,5", "3 4", "", " ", "pi",
    "0x10", "1_0", "1e", "1e400", "1d0", "3f", "--3", "\uff13", "nan", "inf", "-Infinity",
    "9" * 5000,
    "0 0,1 0.2", "0 0.1", "0 0 pi", "0 0 1 2", "0 1 0", "0\t1\n0 ", "0 1 0.",
]  # fmt: skip


@pytest.mark.parametrize("place", PLACES, ids="/".join)
@pytest.mark.parametrize("text", TEXTS, ids=lambda text: repr(text)[:20])
def test_odd_numbers_are_read_as_they_stand_or_refused(
    text: str, place: Place, tmp_path: Path
) -> None:
    check_law(urdf(1), place, 1, text, tmp_path)


@pytest.mark.parametrize("text", ["3 ", "3\n", "\t3"])
def test_blanks_around_a_mass_do_not_lose_it(text: str, tmp_path: Path) -> None:
    root = urdf(2)
    root.findall("link/inertial/mass")[2].set("value", text)
    path = tmp_path / "r.urdf"
    path.write_bytes(ET.tostring(root))
    tree = tb.load_tree(path)
    assert tree.inertias[tree.index("j2")].mass == 3.0
    build_plant(ModelFile(path), tree, 1e-3)


MISSPELLED = {
    "<intertial>": ("inertial", "inertial"),
    "<Inertial>": ("inertial", "inertial"),
    "<masss": ("mass", "mass"),
    "<orgin": ("inertial/origin", "origin"),
}


@pytest.mark.parametrize("what", MISSPELLED)
def test_misspelled_elements_are_not_passed_over(what: str, tmp_path: Path) -> None:
    root = urdf(3)
    place, meant = MISSPELLED[what]
    link = root.findall("link")[1]
    found = link.find(place if place.startswith("inertial") else f"inertial/{place}")
    assert found is not None
    found.tag = what.strip("<>")
    (tmp_path / "r.urdf").write_bytes(ET.tostring(root))
    with pytest.raises(ModelError, match=f"'{link.get('name')}'.*did you mean <{meant}>"):
        tb.load_tree(tmp_path / "r.urdf")


@pytest.mark.parametrize(
    ("place", "old", "new"),
    [
        ("link/inertial/mass", "value", "Value"),
        ("link/inertial/mass", "value", "val"),
        ("link/inertial/inertia", "ixx", "Ixx"),
        ("link/inertial/origin", "xyz", "xzy"),
        ("joint/origin", "rpy", "rypp"),
        ("joint/origin", "rpy", "quat_xyzw"),
        ("joint/axis", "xyz", "xyx"),
        ("joint/limit", "effort", "efort"),
        ("joint/dynamics", "damping", "dampng"),
    ],
)
def test_misspelled_attributes_are_not_passed_over(
    place: str, old: str, new: str, tmp_path: Path
) -> None:
    root = urdf(3)
    element = root.findall(place)[1]
    element.set(new, element.attrib.pop(old))
    (tmp_path / "r.urdf").write_bytes(ET.tostring(root))
    owner = root.findall(place.partition("/")[0])[1].get("name")
    said = rf"'{owner}': <{place.rpartition('/')[2]}>.*\b{old}\b"  # what it should have been
    with pytest.raises(ModelError, match=said):
        tb.load_tree(tmp_path / "r.urdf")


@pytest.mark.parametrize("place", ["link/inertial", "link/inertial/mass", "joint/origin"])
def test_what_stands_twice_is_refused(place: str, tmp_path: Path) -> None:
    root = urdf(3)
    holder = root.findall(place.rpartition("/")[0])[1]
    tag = place.rpartition("/")[2]
    holder.append(holder.findall(tag)[0])
    (tmp_path / "r.urdf").write_bytes(ET.tostring(root))
    with pytest.raises(ModelError, match=f"more than one <{tag}>"):
        tb.load_tree(tmp_path / "r.urdf")


def test_links_in_a_ring_beside_the_robot_are_not_lost(tmp_path: Path) -> None:
    """No parser finds them from the root, and their masses would be gone."""
    root = urdf(3)
    for k in (1, 2):
        ET.SubElement(root, "link", name=f"ring{k}")
        joint = ET.SubElement(root, "joint", name=f"r{k}", type="continuous")
        ET.SubElement(joint, "parent", link=f"ring{k}")
        ET.SubElement(joint, "child", link=f"ring{3 - k}")
    (tmp_path / "r.urdf").write_bytes(ET.tostring(root))
    with pytest.raises(ModelError, match="'ring1' hangs on no root"):
        tb.load_tree(tmp_path / "r.urdf")


def test_what_the_parser_complains_of_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Were the strict reading not there, urdfdom's own complaint would stop the file."""
    from testbed.robot.formats import urdf as road
    from testbed.robot.formats import urdf_xml

    root = urdf(3)
    root.findall("link/inertial/mass")[1].set("value", "3 ")
    (tmp_path / "r.urdf").write_bytes(ET.tostring(root))
    monkeypatch.setattr(urdf_xml, "rewrite_numbers", lambda *args, **kwargs: None)
    monkeypatch.setattr(road, "_link_flaw", lambda link, path: None)
    with pytest.raises(ModelError, match="not a valid URDF"):
        tb.load_tree(tmp_path / "r.urdf")


def test_an_inertia_that_is_no_number_is_told_by_its_link(tmp_path: Path) -> None:
    root = urdf(3)
    root.findall("link/inertial/origin")[1].set("rpy", "0 nan 0")
    (tmp_path / "r.urdf").write_bytes(ET.tostring(root))
    with pytest.raises(ModelError, match="'j1_body' has a mass centre or inertia frame"):
        tb.load_tree(tmp_path / "r.urdf")


def test_friction_that_drives_is_refused_by_the_joint_s_name(tmp_path: Path) -> None:
    root = ET.fromstring(random_robot(np.random.default_rng(0), 2).urdf())
    for k, joint in enumerate(root.findall("joint")):
        for old in joint.findall("dynamics"):
            joint.remove(old)
        ET.SubElement(joint, "dynamics", {"friction": "-0.25" if k == 1 else "0.5"})
    found = load(root, tmp_path)
    assert isinstance(found, str)
    assert f"'{root.findall('joint')[1].get('name')}'" in found
    assert "friction" in found


@pytest.mark.parametrize("part", ["mass", "inertia"])
def test_an_inertial_has_a_mass_and_an_inertia(part: str, tmp_path: Path) -> None:
    root = urdf(3)
    link = root.findall("link")[1]
    inertial = link.find("inertial")
    assert inertial is not None
    lost = inertial.find(part)
    assert lost is not None
    inertial.remove(lost)
    (tmp_path / "r.urdf").write_bytes(ET.tostring(root))
    said = f"the inertial of link '{link.get('name')}' lacks a mass or an inertia"
    with pytest.raises(ModelError, match=said):
        tb.load_tree(tmp_path / "r.urdf")
