"""Two roads to one robot, and what is refused on both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import testbed as tb
from testbed.errors import FreeRootError, ModelError, UnknownName
from tests.helpers.paths import ROOT
from tests.helpers.robots import random_robot

SAME = 1e-12  # two readers, two rounding histories


def assert_same_tree(a: tb.Tree, b: tb.Tree) -> None:
    assert set(a.names) == set(b.names)
    for name in a.names:
        one, two = a.joints[a.index(name)], b.joints[b.index(name)]
        assert (one.kind, one.body) == (two.kind, two.body)
        parents = [
            t.names[t.parents[t.index(name)]] if t.parents[t.index(name)] >= 0 else None
            for t in (a, b)
        ]
        assert parents[0] == parents[1]
        for what in ("axis", "offset", "rotation", "position_range"):
            np.testing.assert_allclose(getattr(one, what), getattr(two, what), rtol=0, atol=SAME)
        for what in ("max_effort", "coulomb", "viscous", "rotor_inertia"):
            assert getattr(one, what) == pytest.approx(getattr(two, what), rel=SAME)
        assert_same_inertia(a.inertias[a.index(name)], b.inertias[b.index(name)])
    assert_same_inertia(a.pedestal, b.pedestal)
    np.testing.assert_allclose(a.gravity, b.gravity, atol=SAME)


def assert_same_inertia(a: tb.Inertia, b: tb.Inertia) -> None:
    assert a.mass == pytest.approx(b.mass, rel=SAME)
    np.testing.assert_allclose(a.first_moment, b.first_moment, rtol=0, atol=SAME)
    np.testing.assert_allclose(a.tensor, b.tensor, rtol=0, atol=SAME)


def test_the_puma_is_the_same_robot_in_both_files(puma: tb.Tree) -> None:
    other = tb.load_tree(ROOT / "models/puma562.urdf")
    assert_same_tree(puma, other)
    assert [j.max_velocity for j in puma.joints] == [j.max_velocity for j in other.joints]


@pytest.mark.parametrize("seed", range(30))
def test_both_readers_return_the_robot_that_was_written(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(1, 9)))
    (tmp_path / "r.urdf").write_text(robot.urdf())
    (tmp_path / "r.xml").write_text(robot.mjcf())
    urdf, mjcf = tb.load_tree(tmp_path / "r.urdf"), tb.load_tree(tmp_path / "r.xml")
    assert_same_tree(urdf, mjcf)
    direct = robot.tree()
    for joint, inertia in zip(direct.joints, direct.inertias, strict=True):
        read = mjcf.joints[mjcf.index(joint.name)]
        np.testing.assert_allclose(read.rotation, joint.rotation, atol=SAME)
        np.testing.assert_allclose(read.offset, joint.offset, atol=SAME)
        assert_same_inertia(mjcf.inertias[mjcf.index(joint.name)], inertia)


def test_topology_of_the_puma(puma: tb.Tree) -> None:
    assert puma.names == ("waist", "shoulder", "elbow")
    assert puma.parents == (-1, 0, 1)
    np.testing.assert_array_equal(puma.reach, np.triu(np.ones((3, 3))))


def test_reach_says_who_lies_on_whose_chain() -> None:
    tree = random_robot(np.random.default_rng(3), 12).tree()
    for j in range(tree.n):
        assert tuple(np.flatnonzero(tree.reach[:, j])) == tree.chain(j)


def test_links_behind_fixed_joints_are_merged(tmp_path: Path) -> None:
    """A tool welded to a link is part of it: mass, first moment and inertia add up."""
    urdf, mjcf = tmp_path / "r.urdf", tmp_path / "r.xml"
    urdf.write_text(
        '<robot name="r"><link name="b"/>'
        '<link name="l"><inertial><origin xyz="0 0 .1"/><mass value="2"/>'
        '<inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".05"/></inertial></link>'
        '<joint name="j" type="continuous"><parent link="b"/><child link="l"/>'
        '<axis xyz="0 0 1"/></joint>'
        '<link name="tool"><inertial><origin xyz=".1 0 0"/><mass value="1"/>'
        '<inertia ixx=".01" ixy="0" ixz="0" iyy=".02" iyz="0" izz=".02"/></inertial></link>'
        '<joint name="w" type="fixed"><parent link="l"/><child link="tool"/>'
        '<origin xyz="0 .3 0" rpy="0 0 1.5707963267948966"/></joint></robot>'
    )
    mjcf.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="l"><joint name="j"/>'
        '<inertial mass="2" pos="0 0 .1" diaginertia=".1 .1 .05"/>'
        '<body name="tool" pos="0 .3 0" euler="0 0 1.5707963267948966">'
        '<inertial mass="1" pos=".1 0 0" diaginertia=".01 .02 .02"/></body>'
        "</body></worldbody></mujoco>"
    )
    a, b = tb.load_tree(urdf), tb.load_tree(mjcf)
    assert_same_inertia(a.inertias[0], b.inertias[0])
    np.testing.assert_allclose(a.inertias[0].com, [0, 0.4 / 3, 0.2 / 3], atol=SAME)


def test_several_joints_on_one_mjcf_body_become_several_bodies(tmp_path: Path) -> None:
    path = tmp_path / "r.xml"
    path.write_text(
        '<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>'
        '<joint name="swing" axis="0 1 0" pos="0 0 .5"/>'
        '<inertial mass="2" pos="0 0 -1" diaginertia=".1 .1 .05"/></body></worldbody></mujoco>'
    )
    tree = tb.load_tree(path)
    assert tree.names == ("x", "swing")
    assert [joint.kind for joint in tree.joints] == ["prismatic", "revolute"]
    assert tree.inertias[0].mass == 0
    np.testing.assert_allclose(tree.inertias[1].com, [0, 0, -1.5], atol=SAME)


def test_meshes_never_matter(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(
        '<robot name="r"><link name="b"/><link name="l"><visual><geometry>'
        '<mesh filename="package://nowhere/l.dae"/></geometry></visual>'
        '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        '</inertial></link><joint name="j" type="continuous"><parent link="b"/>'
        '<child link="l"/></joint></robot>'
    )
    (tmp_path / "r.xml").write_text(
        '<mujoco><asset><mesh name="m" file="nowhere.stl"/></asset><worldbody><body name="l">'
        '<joint name="j" axis="1 0 0"/><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    assert_same_inertia(
        tb.load_tree(tmp_path / "r.urdf").inertias[0], tb.load_tree(tmp_path / "r.xml").inertias[0]
    )


URDF = '<robot name="r"><link name="b"/><link name="l"/>{}</robot>'
JOINT = '<joint name="{}" type="{}"><parent link="b"/><child link="l"/>{}</joint>'
MJCF = "<mujoco><worldbody>{}</worldbody>{}</mujoco>"
BALL = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
REFUSED = {
    "ball.xml": (
        MJCF.format(f'<body name="b"><joint name="k" type="ball"/>{BALL}</body>', ""),
        "k",
    ),
    "free.xml": (
        MJCF.format(
            f'<body name="b"><joint name="j"/>{BALL}<body name="c"><joint name="k" type="ball"/>'
            f"{BALL}</body></body>",
            "",
        ),
        "k",
    ),
    "equality.xml": (
        MJCF.format(
            f'<body name="a"><joint name="i"/>{BALL}</body><body name="b"><joint name="j"/>'
            f"{BALL}</body>",
            '<equality><joint name="k" joint1="i" joint2="j"/></equality>',
        ),
        "k",
    ),
    "planar.urdf": (URDF.format(JOINT.format("k", "planar", "")), "k"),
    "mimic.urdf": (
        URDF.format(
            JOINT.format("k", "continuous", '<axis xyz="0 0 1"/><mimic joint="j" multiplier="2"/>')
        ),
        "k",
    ),
    "loop.urdf": (
        URDF.format(JOINT.format("j", "continuous", "") + JOINT.format("k", "continuous", "")),
        "k",
    ),
    "broken.xml": ("<mujoco><worldbody>", "not well-formed"),
    "broken.urdf": ("<robot><link>", "not well-formed"),
    "page.urdf": ("\n<!DOCTYPE html><html><br></html>", "web page"),
    "other.xml": ("<sdf/>", "<sdf>"),
    "still.urdf": ('<robot name="r"><link name="b"/></robot>', "no joint that moves"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_supported_is_named_with_its_file(name: str, tmp_path: Path) -> None:
    text, culprit = REFUSED[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(ModelError) as caught:
        tb.load_tree(tmp_path / name)
    assert culprit in str(caught.value)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_said_to_be_missing() -> None:
    with pytest.raises(ModelError, match="no model file 'nowhere.xml'"):
        tb.load_tree("nowhere.xml")


FREE = {
    "free.xml": MJCF.format(
        f'<body name="torso"><freejoint name="float"/>{BALL}<body name="leg"><joint name="hip"/>'
        f"{BALL}</body></body>",
        "",
    ),
    "free.urdf": (
        '<robot name="r"><link name="world"/><link name="torso"/><link name="leg"/>'
        '<joint name="float" type="floating"><parent link="world"/><child link="torso"/></joint>'
        '<joint name="hip" type="continuous"><parent link="torso"/><child link="leg"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    ),
}


@pytest.mark.parametrize("name", FREE)
def test_a_free_root_is_refused_with_an_offer_and_can_be_welded(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(FREE[name])
    with pytest.raises(FreeRootError, match="--weld-root") as caught:
        tb.load_tree(path)
    assert caught.value.joint == "float"
    assert tb.load_tree(path, weld_root=True).names == ("hip",)


@pytest.mark.parametrize(
    ("mass", "moments", "said"),
    [
        ("-1", (1, 1, 1), "negative mass"),
        ("nan", (1, 1, 1), "not a number"),
        ("1", (1, 1, float("nan")), "not a number"),
        ("1", (1, 1, 3), "exceeds the sum"),
        ("1", (0, 0, 0), "not all positive"),
        ("1", (1, 1, -1), "not all positive"),
        ("0", (1, 1, 1), "not all positive"),
    ],
)
@pytest.mark.parametrize("form", ["urdf", "xml"])
def test_bodies_that_cannot_be_are_refused_by_name_where_the_nearest_is_not_wanted(
    mass: str, moments: tuple[float, ...], said: str, form: str, tmp_path: Path
) -> None:
    x, y, z = moments
    path = tmp_path / f"r.{form}"
    path.write_text(
        URDF.replace(
            '<link name="l"/>',
            f'<link name="l"><inertial><mass value="{mass}"/><inertia ixx="{x}" ixy="0" ixz="0" '
            f'iyy="{y}" iyz="0" izz="{z}"/></inertial></link>',
        ).format(JOINT.format("j", "continuous", '<axis xyz="0 0 1"/>'))
        if form == "urdf"
        else MJCF.format(
            f'<body name="l"><joint name="j"/><inertial mass="{mass}" pos="0 0 0" '
            f'diaginertia="{x} {y} {z}"/></body>',
            "",
        )
    )
    with pytest.raises(ModelError, match=f"'l'.* {said}"):
        tb.load_tree(path, repair={})
    if said in ("negative mass", "not a number"):  # no body is near
        with pytest.raises(ModelError, match=f"'l'.* {said}"):
            tb.load_tree(path)
        return
    (note,) = tb.load_tree(path).warnings
    assert "'l'" in note


def test_a_joint_that_is_not_there_lists_those_that_are(puma: tb.Tree) -> None:
    with pytest.raises(UnknownName, match="did you mean 'elbow'"):
        puma.index("elbo")


finite = st.floats(-2, 2)
vectors = st.tuples(finite, finite, finite).map(np.array)


@given(com=vectors, at=vectors, angles=vectors, mass=st.floats(0.1, 10))
@settings(max_examples=50)
def test_moving_an_inertia_moves_its_centre_and_keeps_its_central_moments(
    com: np.ndarray, at: np.ndarray, angles: np.ndarray, mass: float
) -> None:
    central = np.diag([0.3, 0.4, 0.5])
    cx, cy, cz = np.cos(angles)
    sx, sy, sz = np.sin(angles)
    turn = (
        np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    )
    moved = tb.Inertia.about_centre(mass, com, central).moved(turn, at)
    np.testing.assert_allclose(moved.com, at + turn @ com, atol=1e-12)
    np.testing.assert_allclose(moved.central, turn @ central @ turn.T, atol=1e-11 * mass)
