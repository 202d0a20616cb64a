"""What a robot looks like: the same in both languages, and where its bodies are."""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.robot.rotations import about, from_rpy, to_rpy
from testbed.robot.visuals.load_shapes import load_shapes
from testbed.robot.visuals.shapes import Shape, upright
from testbed.robot.visuals.sticks import sticks
from tests.helpers.paths import REAL
from tests.helpers.robots import random_robot

SINGLE = 1e-6  # meshes are kept in single precision


@dataclass(frozen=True)
class Dressed:
    """One shape of one body, as both files are to state it."""

    body: str
    kind: str
    size: Array
    position: Array
    rpy: tuple[float, float, float]
    colour: Array

    def as_shape(self, body: int) -> Shape:
        """What is to be found."""
        size = np.repeat(self.size, 3) if self.kind == "sphere" else self.size
        kind = "ellipsoid" if self.kind == "sphere" else self.kind
        rotation = from_rpy(self.rpy)
        return Shape(body, kind, size, self.position, rotation, self.colour)  # type: ignore[arg-type]


WEDGE = np.array([[0.0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.5]])
"""A tetrahedron without symmetry, and its faces seen counter-clockwise from outside."""
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def write_stl(path: Path) -> None:
    """The wedge, in binary."""
    triangles = b"".join(
        struct.pack("<12fH", 0, 0, 0, *WEDGE[list(face)].ravel(), 0) for face in FACES
    )
    path.write_bytes(bytes(80) + struct.pack("<I", len(FACES)) + triangles)


def write_obj(path: Path) -> None:
    """The wedge, in text."""
    lines = [f"v {x} {y} {z}" for x, y, z in WEDGE]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    path.write_text("\n".join(lines) + "\n")


def text(values: Array | tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)


def clothe(seed: int, folder: Path, meshes: bool = False) -> tuple[list[Dressed], Path, Path]:
    """A random robot with random shapes, in both languages."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(2, 7)))
    names = ["pedestal_body", *(f"{link.name}_body" for link in robot.links)]
    kinds = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2} | ({"mesh": 3} if meshes else {})
    clothes = [
        Dressed(
            name,
            kind := str(rng.choice(list(kinds))),
            rng.uniform(0.05, 0.4, kinds[kind]),
            rng.uniform(-0.5, 0.5, 3),
            to_rpy(about(upright(rng.normal(size=3))[:, 2], rng.uniform(-3, 3))),
            np.round(rng.uniform(0, 1, 4), 3),
        )
        for name in names
        for _ in range(int(rng.integers(0, 4)))
    ]
    write_stl(folder / "wedge.stl")
    urdf, mjcf = ET.fromstring(robot.urdf()), ET.fromstring(robot.mjcf())
    compiler = mjcf.find("compiler")
    assert compiler is not None
    compiler.set("eulerseq", "XYZ")  # about fixed axes, as in URDF
    assets = ET.SubElement(mjcf, "asset")
    for k, each in enumerate(clothes):
        link = next(link for link in urdf.iter("link") if link.get("name") == each.body)
        body = next(body for body in mjcf.iter("body") if body.get("name") == each.body)
        link.append(_visual(each))
        body.append(_geom(each, f"m{k}"))
        if each.kind == "mesh":
            scaled = {"name": f"m{k}", "file": "wedge.stl", "scale": text(each.size)}
            ET.SubElement(assets, "mesh", scaled)
    (folder / "r.urdf").write_bytes(ET.tostring(urdf))
    (folder / "r.xml").write_bytes(ET.tostring(mjcf))
    return clothes, folder / "r.urdf", folder / "r.xml"


def _visual(each: Dressed) -> ET.Element:
    size = each.size
    forms = {
        "box": {"size": text(2 * size)},
        "sphere": {"radius": text(size)},
        "cylinder": {"radius": text(size[:1]), "length": text(2 * size[1:])},
        "capsule": {"radius": text(size[:1]), "length": text(2 * size[1:])},
        "mesh": {"filename": "wedge.stl", "scale": text(size)},
    }
    visual = ET.Element("visual")
    ET.SubElement(visual, "origin", xyz=text(each.position), rpy=text(each.rpy))
    ET.SubElement(ET.SubElement(visual, "geometry"), each.kind, forms[each.kind])
    material = ET.SubElement(visual, "material", name=text(each.colour))
    ET.SubElement(material, "color", rgba=text(each.colour))
    return visual


def _geom(each: Dressed, mesh: str) -> ET.Element:
    form = {"mesh": mesh} if each.kind == "mesh" else {"size": text(each.size)}
    place = {"pos": text(each.position), "euler": text(each.rpy), "rgba": text(each.colour)}
    return ET.Element("geom", {"type": each.kind} | form | place)


def found_in(path: Path, tree: tb.Tree) -> dict[str, list[Shape]]:
    """Shapes by the name of their body, in the file's order."""
    seen = load_shapes(path, tree)
    assert seen.warnings == ()
    names = [*(joint.body for joint in tree.joints), "pedestal_body"]
    found: dict[str, list[Shape]] = {name: [] for name in names}
    for shape in seen.shapes:
        found[names[shape.body]].append(shape)
    return found


@pytest.mark.parametrize("seed", range(12))
def test_both_languages_show_what_was_written(seed: int, tmp_path: Path) -> None:
    clothes, urdf, mjcf = clothe(seed, tmp_path)
    for path in (urdf, mjcf):
        found = found_in(path, tb.load_tree(path))
        for name, shapes in found.items():
            written = [each.as_shape(0) for each in clothes if each.body == name]
            assert len(shapes) == len(written)
            for one, two in zip(shapes, written, strict=True):
                assert one.kind == two.kind
                for what in ("size", "position", "rotation"):
                    np.testing.assert_allclose(getattr(one, what), getattr(two, what), atol=1e-12)
                np.testing.assert_allclose(one.colour, two.colour, atol=SINGLE)


def triangles(shape: Shape) -> Array:
    """A mesh's triangles in its body's frame, in a fixed order, (F, 9)."""
    points = shape.position + shape.vertices @ shape.rotation.T
    corners = points[shape.faces.astype(int)]
    first = np.argmin(np.round(corners, 4) @ [1.0, 1e2, 1e4], axis=1)
    turned = [np.roll(face, -k, axis=0).ravel() for face, k in zip(corners, first, strict=True)]
    rows = np.array(turned)
    return rows[np.lexsort(np.round(rows, 4).T)]


def volume(shape: Shape) -> float:
    """Positive if the faces are counter-clockwise from outside."""
    corners = shape.vertices[shape.faces.astype(int)]
    return float(np.linalg.det(corners).sum()) / 6


@pytest.mark.parametrize("seed", range(6))
def test_meshes_lie_where_both_languages_put_them(seed: int, tmp_path: Path) -> None:
    clothes, urdf, mjcf = clothe(seed, tmp_path, meshes=True)
    meshes = [each for each in clothes if each.kind == "mesh"]
    for path in (urdf, mjcf):
        found = found_in(path, tb.load_tree(path))
        shapes = [s for each in found for s in found[each] if s.kind == "mesh"]
        wanted = [
            Shape(
                0, "mesh", np.zeros(0), each.position, from_rpy(each.rpy), each.colour,
                WEDGE * each.size, FACES,
            )
            for name in found
            for each in meshes
            if each.body == name
        ]  # fmt: skip
        assert len(shapes) == len(wanted)
        for one, two in zip(shapes, wanted, strict=True):
            np.testing.assert_allclose(triangles(one), triangles(two), atol=SINGLE)
            assert volume(one) == pytest.approx(volume(two), rel=1e-4)
            assert one.size.shape == (0,)
    assert meshes or seed  # most robots have some


@pytest.mark.parametrize("write", [write_stl, write_obj])
def test_mesh_files_of_two_kinds_hold_the_same(write: object, tmp_path: Path) -> None:
    assert callable(write)
    ending = "stl" if write is write_stl else "obj"
    write(tmp_path / f"wedge.{ending}")
    (tmp_path / "r.xml").write_text(
        f'<mujoco><asset><mesh name="m" file="wedge.{ending}"/></asset><worldbody>'
        '<body name="b" pos="0 0 1"><joint name="j"/>'
        '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
        '<geom type="mesh" mesh="m" pos="1 0 0"/></body></worldbody></mujoco>'
    )
    (shape,) = load_shapes(tmp_path / "r.xml", tb.load_tree(tmp_path / "r.xml")).shapes
    wedge = Shape(
        0, "mesh", np.zeros(0), np.array([1.0, 0, 0]), np.eye(3), np.ones(4), WEDGE, FACES
    )
    np.testing.assert_allclose(triangles(shape), triangles(wedge), atol=SINGLE)


# where they are, in any posture, of any body

HINGES = """<mujoco><compiler angle="degree"/><worldbody>
<geom type="plane" size="1 1 1"/><geom type="box" size=".1 .2 .3" pos="0 0 -.2"/>
<body name="one" pos=".1 0 .3" euler="10 20 30">
 <joint name="a" axis="0 1 1" pos=".1 0 .2" ref="30"/>
 <joint name="b" type="slide" axis="1 0 1" ref=".2"/>
 <geom type="ellipsoid" size=".1 .2 .3" mass="1" euler="0 40 0" pos="0 .1 0"/>
 <body name="welded" pos="0 0 .4" euler="50 0 0">
  <geom type="capsule" fromto="0 0 0 .1 .2 .3" size=".02"/>
  <geom type="sphere" size=".1" group="3"/>
  <body name="two" pos="0 .2 0"><joint name="c" axis="1 0 0" pos="0 0 .1"/>
   <geom type="cylinder" size=".1 .2" pos=".1 .2 .3"/></body></body></body></worldbody></mujoco>"""


def in_the_world(tree: tb.Tree, q: Array, shape: Shape) -> tuple[Array, Array]:
    """A shape's rotation and place in the bedplate's frame."""
    turn, place = np.eye(3), np.zeros(3)
    for j in tree.chain(shape.body):
        joint = tree.joints[j]
        place = place + turn @ joint.offset
        turn = turn @ joint.rotation
        if joint.revolute:
            turn = turn @ about(joint.axis, q[j])
        else:
            place = place + turn @ joint.axis * q[j]
    return turn @ shape.rotation, place + turn @ shape.position


@pytest.mark.parametrize("seed", range(5))
def test_shapes_move_as_mujoco_moves_them(seed: int, tmp_path: Path) -> None:
    path = tmp_path / "r.xml"
    path.write_text(HINGES)
    tree = tb.load_tree(path)
    shapes = load_shapes(path, tree).shapes
    assert [shape.kind for shape in shapes] == ["box", "ellipsoid", "capsule", "cylinder"]
    assert [shape.body for shape in shapes] == [-1, 1, 1, 2]
    np.testing.assert_allclose(shapes[1].size, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(shapes[2].size, [0.02, np.sqrt(0.14) / 2])
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    q = np.random.default_rng(seed).uniform(-2, 2, 3)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    for geom, shape in zip((1, 2, 3, 5), shapes, strict=True):
        turn, place = in_the_world(tree, q, shape)
        np.testing.assert_allclose(place, data.geom_xpos[geom], atol=1e-12)
        np.testing.assert_allclose(turn, data.geom_xmat[geom].reshape(3, 3), atol=1e-12)


@pytest.mark.parametrize("form", ["urdf", "xml"])
@pytest.mark.parametrize("seed", range(6))
def test_shapes_of_locked_bodies_stay_where_they_are_held(
    seed: int, form: str, tmp_path: Path
) -> None:
    _, urdf, mjcf = clothe(seed + 20, tmp_path)
    path = urdf if form == "urdf" else mjcf
    full, rng = tb.load_tree(path), np.random.default_rng(seed)
    q = rng.uniform(-2, 2, full.n)
    held = {
        str(name): float(q[full.index(name)])
        for name in rng.choice(full.names, size=full.n // 2, replace=False)
    }
    locked = tb.load_tree(path, lock=held)
    left = q[[full.index(name) for name in locked.names]]
    before = load_shapes(path, full).shapes
    after = load_shapes(path, locked, lock=held).shapes
    assert len(before) == len(after)
    for one, two in zip(before, after, strict=True):
        for a, b in zip(in_the_world(full, q, one), in_the_world(locked, left, two), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-12)


@pytest.mark.slow
def test_a_panda_with_held_fingers_shows_them() -> None:
    path = REAL / "panda_description/urdf/panda.urdf"
    lock = {"panda_finger_joint1": 0.02}
    tree = tb.load_tree(path, lock=lock)
    seen = load_shapes(path, tree, lock=lock)
    assert {shape.body for shape in seen.shapes} == {-1, *range(7)}
    assert seen.warnings == ()


# what cannot be shown


@pytest.mark.parametrize("form", ["urdf", "xml"])
@pytest.mark.parametrize("broken", ["missing", "damaged"])
def test_a_mesh_that_cannot_be_read_is_named_and_the_others_are_shown(
    broken: str, form: str, tmp_path: Path
) -> None:
    for name in ("good.stl", "fine.stl"):
        write_stl(tmp_path / name)
    if broken == "damaged":
        (tmp_path / "bad.stl").write_bytes(b"no mesh at all")
    files = ("good.stl", "bad.stl", "fine.stl")
    path = tmp_path / f"r.{form}"
    if form == "urdf":
        visuals = "".join(
            f'<visual><geometry><mesh filename="{name}"/></geometry></visual>' for name in files
        )
        path.write_text(
            f'<robot name="r"><link name="b"/><link name="l">{visuals}<visual><geometry>'
            '<box size="1 1 1"/></geometry></visual></link><joint name="j" type="continuous">'
            '<parent link="b"/><child link="l"/></joint></robot>'
        )
    else:
        meshes = "".join(f'<mesh name="{name}" file="{name}"/>' for name in files)
        geoms = "".join(f'<geom type="mesh" mesh="{name}"/>' for name in files)
        path.write_text(
            f'<mujoco><asset>{meshes}</asset><worldbody><body name="l"><joint name="j"/>'
            f'<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>{geoms}'
            '<geom type="box" size=".5 .5 .5"/></body></worldbody></mujoco>'
        )
    seen = load_shapes(path, tb.load_tree(path))
    assert [shape.kind for shape in seen.shapes] == ["mesh", "mesh", "box"]
    (line,) = seen.warnings
    assert "bad.stl" in line
    assert line.isprintable()


def test_a_visual_with_odd_numbers_is_named_and_the_others_are_shown(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(
        '<robot name="r"><link name="b"/><link name="l"><visual><origin xyz="0 0,1 0"/><geometry>'
        '<sphere radius="1"/></geometry></visual><visual><geometry><sphere radius="0.5"/>'
        '</geometry></visual></link><joint name="j" type="continuous"><parent link="b"/>'
        '<child link="l"/></joint></robot>'
    )
    seen = load_shapes(tmp_path / "r.urdf", tb.load_tree(tmp_path / "r.urdf"))
    (shape,) = seen.shapes
    np.testing.assert_array_equal(shape.size, [0.5, 0.5, 0.5])
    assert "link 'l'" in seen.warnings[0]
    assert "xyz='0 0,1 0'" in seen.warnings[0]


def test_an_inertia_that_comes_from_a_missing_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "r.xml").write_text(
        '<mujoco><asset><mesh name="m" file="nowhere.stl"/></asset><worldbody><body name="l">'
        '<joint name="j"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    with pytest.raises(tb.TestbedError, match="inertia of body 'l' comes from its mesh.*nowhere"):
        tb.load_tree(tmp_path / "r.xml")


# sticks


@pytest.mark.parametrize("seed", range(8))
def test_sticks_go_from_joint_to_joint(seed: int) -> None:
    """Each offset longer than a stick is thick is one stick; each joint is a drum on its axis."""
    tree = random_robot(np.random.default_rng(seed), 7).tree()
    radius = max(np.linalg.norm(joint.offset) for joint in tree.joints) / 30
    figure = list(sticks(tree))
    drums = [shape for shape in figure if shape.kind == "cylinder"]
    assert [drum.body for drum in drums] == list(range(tree.n))
    for drum, joint in zip(drums, tree.joints, strict=True):
        np.testing.assert_allclose(drum.rotation[:, 2], joint.axis, atol=1e-12)
        np.testing.assert_allclose(drum.position, 0.0)
        assert drum.size[0] > radius
    spans = [
        (joint.parent, joint.offset)
        for joint in tree.joints
        if np.linalg.norm(joint.offset) > radius
    ]
    spans += [
        (j, tree.inertias[j].com)
        for j in range(tree.n)
        if j not in tree.parents and np.linalg.norm(tree.inertias[j].com) > radius
    ]
    bars = [shape for shape in figure if shape.kind == "capsule"]
    ends = sorted((bar.body, *_end(bar, 1), *_end(bar, -1)) for bar in bars)
    wanted = sorted((body, *end, 0.0, 0.0, 0.0) for body, end in spans)
    np.testing.assert_allclose(ends, wanted, atol=1e-12)
    assert all(bar.size[0] == pytest.approx(radius) for bar in bars)


def _end(bar: Shape, side: int) -> Array:
    end: Array = np.round(bar.position + side * bar.size[1] * bar.rotation[:, 2], 13) + 0.0
    return end


def test_thickness_is_what_is_asked_for(puma: tb.Tree) -> None:
    bars = [shape for shape in sticks(puma, 0.01) if shape.kind == "capsule"]
    assert bars
    assert all(bar.size[0] == 0.01 for bar in bars)


def test_a_robot_without_lengths_is_drawn_too() -> None:
    tree = random_robot(np.random.default_rng(0), 1).tree()
    assert list(sticks(tree))


@pytest.mark.parametrize(
    "direction",
    [*np.eye(3), *-np.eye(3), *np.array([[1, 1, 0], [1, 1, 1], [1e-9, 0, 1], [-3, 4, 1e-7]])],
)
def test_upright_turns_z_into_the_direction(direction: Array) -> None:
    turn = upright(direction)
    np.testing.assert_allclose(turn[:, 2], direction / np.linalg.norm(direction), atol=1e-15)
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-14)
    assert np.linalg.det(turn) == pytest.approx(1.0)


BESIDE = """<mujoco><asset><mesh name="bad" file="bad.stl"/>
<mesh name="good" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset><worldbody><body name="b">
<inertial pos="0 0 0" mass="1" diaginertia="1 0.1 0.1"/><joint name="j" axis="0 0 1"/>
<geom type="mesh" mesh="bad"/><geom type="mesh" mesh="good"/></body></worldbody></mujoco>"""


def test_a_mesh_that_can_be_read_is_drawn_whatever_else_is_wrong(tmp_path: Path) -> None:
    """Beside one that cannot, on a body whose stated inertia no body has."""
    (tmp_path / "bad.stl").write_bytes(b"no mesh")
    (tmp_path / "robot.xml").write_text(BESIDE)
    tree = tb.load_tree(tmp_path / "robot.xml")
    seen = load_shapes(tmp_path / "robot.xml", tree)
    assert [shape.kind for shape in seen.shapes if shape.body == 0] == ["mesh"]
    (warning,) = seen.warnings
    assert warning.startswith("mesh 'bad.stl' is left out")
