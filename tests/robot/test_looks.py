"""What a robot looks like in both languages, and which meshes a copy of its model brings along."""

from __future__ import annotations

import math
import os
import re
import struct
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.bodies.shapes.appearance import load_appearance, load_shapes
from testbed.bodies.shapes.shapes import (
    Shape,
    ShapeKind,
    equivalent_ellipsoids,
    shape_bounds,
    stick_figure,
)
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import ModelError
from testbed.core.dynamics.newton_euler import poses
from testbed.core.robot.model_file import ModelFile, copy_model
from testbed.core.robot.rotations import rotvec_to_matrix
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.refusals import refuses
from tests.helpers.strategies import trees

SINGLE = 1e-6  # meshes are kept in single precision


WEDGE = np.array([[0.0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.5]])
"""A tetrahedron without symmetry, and its faces seen counter-clockwise from outside."""
WHOLE = 0.3 * 0.2 * 0.5 / 6
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def write_mesh(path: Path) -> Path:
    """The wedge: in binary as STL, in text as OBJ."""
    lines = [f"v {x} {y} {z}" for x, y, z in WEDGE]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    corners = [struct.pack("<12fH", 0, 0, 0, *WEDGE[face].ravel(), 0) for face in FACES]
    binary = bytes(80) + struct.pack("<I", len(FACES)) + b"".join(corners)
    path.write_bytes(binary if path.suffix == ".stl" else "\n".join(lines).encode())
    return path


def volume(shape: Shape) -> float:
    """Positive if the faces are counter-clockwise from outside."""
    corners = shape.vertices[shape.faces.astype(int)]
    return float(np.linalg.det(corners).sum()) / 6


MATTER = """<inertial><mass value="1"/>
 <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"""
SEEN = f"""<robot name="r"><mujoco><compiler discardvisual="false"/></mujoco><link name="base">
<visual><origin xyz="0 0 -.2"/><geometry><box size=".2 .4 .6"/></geometry></visual></link>
<joint name="a" type="continuous"><parent link="base"/><child link="one"/>
 <origin xyz=".1 0 .3" rpy=".1 .2 .3"/><axis xyz="0 .6 .8"/></joint>
<link name="one">{MATTER}
 <visual><origin xyz="0 .1 0" rpy="0 .7 0"/><geometry><sphere radius=".1"/></geometry>
  <material name="m"><color rgba="1 .5 0 .25"/></material></visual>
 <visual><origin xyz="0 .1 .1" rpy=".3 .7 0"/>
  <geometry><mesh filename="wedge.stl" scale="1 2 .5"/></geometry></visual></link>
<joint name="f" type="fixed"><parent link="one"/><child link="welded"/>
 <origin xyz="0 0 .4" rpy=".9 0 0"/></joint>
<link name="welded">{MATTER}<visual><origin xyz="0 .1 .2"/><geometry>
 <capsule radius=".1" length=".3"/></geometry></visual></link>
<joint name="b" type="prismatic"><parent link="welded"/><child link="two"/>
 <origin xyz="0 .2 0"/><axis xyz="1 0 0"/></joint>
<link name="two">{MATTER}<visual><origin xyz=".1 .2 .3" rpy="0 1 0"/><geometry>
 <cylinder radius=".1" length=".4"/></geometry></visual></link></robot>"""
HINGES = """<mujoco><compiler angle="degree"/><asset><mesh file="wedge.obj" scale="2 1 1"/></asset>
<worldbody><geom type="plane" size="1 1 1" group="3"/>
<geom type="box" size=".1 .2 .3" pos="0 0 -.2"/>
<body name="one" pos=".1 0 .3" euler="10 20 30">
 <joint name="a" axis="0 1 1" pos=".1 0 .2" ref="30"/>
 <joint name="b" type="slide" axis="1 0 1" ref=".2"/>
 <geom type="ellipsoid" size=".1 .2 .3" euler="0 40 0" pos="0 .1 0" rgba="1 .5 0 .25"/>
 <body name="welded" pos="0 0 .4" euler="50 0 0">
  <geom type="capsule" fromto="0 0 0 .1 .2 .3" size=".02"/><geom size=".1" group="3"/>
  <body name="two" pos="0 .2 0"><joint name="c" axis="1 0 0" pos="0 0 .1"/>
   <geom type="cylinder" size=".1 .2" pos=".1 .2 .3"/>
   <inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
   <geom type="mesh" mesh="wedge" euler="10 0 20"/></body></body></body></worldbody></mujoco>"""
KINDS = {2: "ellipsoid", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box", 7: "mesh"}
"""By MuJoCo's number."""
LOCKS: list[dict[str, float]] = [{}, {"a": 1.5}, {"b": -0.7}]


@pytest.mark.parametrize("lock", LOCKS)
@pytest.mark.parametrize(("file", "text", "scale"), [("r.urdf", SEEN, 1), ("r.xml", HINGES, 2)])
def test_shapes_are_where_mujoco_has_them(
    file: str, text: str, scale: float, lock: dict[str, float], tmp_path: Path
) -> None:
    """A person checks a robot by looking at it; a gripper that is held open is shown open."""
    path, q = tmp_path / file, {"a": 0.7, "b": -1.2, "c": 1.9} | lock
    path.write_text(text)
    for ending in ("stl", "obj"):
        write_mesh(tmp_path / f"wedge.{ending}")
    tree = tb.load_tree(path, lock=lock)
    seen = load_shapes(ModelFile(path, lock=lock), tree)
    assert seen.diagnostics == ()
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for j in range(model.njnt):
        data.qpos[j] = q[model.joint(j).name]
    mujoco.mj_kinematics(model, data)
    now = poses(tree, np.array([[q[name] for name in tree.names]]))
    carriers = [*((X.R_AB[0], X.p_AB_A[0]) for X in now), (np.eye(3), np.zeros(3))]
    shown = [k for k in range(model.ngeom) if model.geom_group[k] < 3]
    shown.sort(key=lambda k: scale == 2 and model.geom_type[k] == 7)  # meshes come last
    for k, shape in zip(shown, seen.shapes, strict=True):
        turn, origin = carriers[shape.body]
        turn, place = turn @ shape.rotation, origin + turn @ shape.position
        own, at, size = data.geom_xmat[k].reshape(3, 3), data.geom_xpos[k], model.geom_size[k]
        assert shape.kind == KINDS[int(model.geom_type[k])]
        if shape.kind == "mesh":
            corners, found = at + model.mesh_vert @ own.T, place + shape.vertices @ turn.T
            for end in (np.min, np.max):
                np.testing.assert_allclose(end(found, 0), end(corners, 0), atol=SINGLE)
            assert volume(shape) == pytest.approx(scale * WHOLE, rel=1e-4)
            continue
        np.testing.assert_allclose(place, at, atol=1e-12)
        np.testing.assert_allclose(turn, own, atol=1e-12)
        np.testing.assert_allclose(shape.size, size[: len(shape.size)] if size[1] else size[0])
        if shape.kind == "ellipsoid":
            np.testing.assert_allclose(shape.colour, [1, 0.5, 0, 0.25], atol=SINGLE)


ODD = '<visual><origin xyz="0 0,1 0"/><geometry><sphere radius="1"/></geometry></visual>'
LOST = '<visual><geometry><mesh filename="package://lost/{}.stl"/></geometry></visual>'


def test_what_cannot_be_shown_is_named_in_one_line_and_the_rest_is_shown(tmp_path: Path) -> None:
    """Fifty lost meshes of a package are one line, not fifty; inertias need their mesh."""

    def left_out(file: str, text: str, culprit: str) -> int:
        (tmp_path / file).write_text(text)
        seen = load_shapes(ModelFile(tmp_path / file), tb.load_tree(tmp_path / file))
        (line,) = sentences(seen.diagnostics)
        assert culprit in line
        assert line.isprintable()
        return len(seen.shapes)

    impossible = HINGES.replace("1 1 1", "1 .1 .1")
    for file, text, culprit in (("r.urdf", SEEN, "wedge.stl"), ("r.xml", impossible, "wedge.obj")):
        assert left_out(file, text, culprit) == 4
        (tmp_path / culprit).write_bytes(b"no mesh at all")
        assert left_out(file, text, culprit) == 4
    write_mesh(tmp_path / "wedge.stl")
    lost = "".join(map(LOST.format, range(5)))
    for more, culprit in ((lost, "package://lost/0.stl"), (ODD, "0 0,1 0")):
        assert left_out(
            "r.urdf", SEEN.replace("</link></robot>", more + "</link></robot>"), culprit
        )
    (tmp_path / "r.xml").write_text(re.sub("<inertial.*?/>", "", HINGES))
    with refuses(tb.TestbedError, "'two'", "wedge"):
        tb.load_tree(tmp_path / "r.xml")


@given(trees((1, 7)))
def test_a_robot_without_shapes_is_sticks_from_joint_to_joint(tree: tb.Tree) -> None:
    """Each offset longer than a stick is thick is one stick; each joint is a drum on its axis."""
    radius = max(np.linalg.norm(joint.offset) for joint in tree.joints) / 30
    ends = [(joint.parent, *joint.offset) for joint in tree.joints]
    ends += [(j, *tree.inertias[j].com) for j in range(tree.n) if not tree.children(j)]
    figure = list(stick_figure(tree))
    drums = [shape.rotation[:, 2] for shape in figure if shape.kind == "cylinder"]
    np.testing.assert_allclose(drums, [joint.axis for joint in tree.joints], atol=1e-12)
    bars = [shape for shape in figure if shape.kind == "capsule"]
    found = [(bar.body, *2 * bar.size[1] * bar.rotation[:, 2]) for bar in bars]
    np.testing.assert_allclose(
        sorted(found), sorted(e for e in ends if math.hypot(*e[1:]) > radius)
    )
    for bar, end in zip(bars, found, strict=True):  # they begin at the body's origin
        np.testing.assert_allclose(2 * bar.position, end[1:], atol=1e-12)


@given(trees((1, 4), bare=True))
def test_ellipsoids_have_the_second_moments_of_their_bodies(tree: tb.Tree) -> None:
    """What the viewer shows of an estimated body; one that cannot be has none."""
    tree = tree.with_inertia(0, tb.Inertia(0.0, np.zeros(3), np.diag([99.0, 1.0, 1.0])))
    shapes = {shape.body: shape for shape in equivalent_ellipsoids(tree, (1, 0, 0, 1))}
    for body, inertia in enumerate(tree.inertias):
        central = inertia.pseudo[:3, :3] - inertia.mass * np.outer(inertia.com, inertia.com)
        least = np.linalg.eigvalsh(central)[0]
        if abs(least) > 1e-9 or not inertia.mass:
            assert (body in shapes) == (inertia.mass > 0 and least > 0)
        if body in shapes:
            turn, half = shapes[body].rotation, shapes[body].size
            found = inertia.mass / 5 * turn @ np.diag(half**2) @ turn.T
            np.testing.assert_allclose(found, central, atol=1e-9)
            np.testing.assert_array_equal(shapes[body].position, inertia.com)
            assert np.linalg.det(turn) == pytest.approx(1)


@pytest.mark.parametrize("kind", ["box", "ellipsoid", "cylinder", "capsule", "mesh"])
def test_bounds_are_where_a_shape_ends(kind: ShapeKind) -> None:
    """In six directions, the farthest point of the shape by its support function."""
    rng = np.random.default_rng(3)
    size = rng.uniform(0.05, 0.5, 3 if kind in ("box", "ellipsoid") else 2)
    reach: dict[str, Callable[[Array], float]] = {
        "box": lambda u: float(size @ np.abs(u)),
        "ellipsoid": lambda u: float(np.linalg.norm(size * u)),
        "cylinder": lambda u: size[0] * np.hypot(u[0], u[1]) + size[1] * abs(u[2]),
        "capsule": lambda u: size[0] + size[1] * abs(u[2]),
        "mesh": lambda u: (WEDGE @ u).max(),
    }
    turn, place = rotvec_to_matrix(rng.normal(size=3)), rng.normal(size=3)
    mesh = (WEDGE, FACES) if kind == "mesh" else ()
    low, high = shape_bounds(Shape(-1, kind, size, place, turn, np.ones(4), *mesh))
    for axis, along in enumerate(turn):  # the body's axis in the shape's own frame
        ends = place[axis] - reach[kind](-along), place[axis] + reach[kind](along)
        np.testing.assert_allclose([low[axis], high[axis]], ends, atol=1e-12)


@pytest.mark.parametrize("name", ["ur5", "two_trunks"])
def test_a_robot_stands_on_a_plate_that_arrows_are_clear_of(name: str) -> None:
    """Force arrows would be hidden in the robot; a plate that a file draws is not doubled."""
    path = GOLDEN / f"robots/{name}.urdf"
    robot = load_appearance(tb.load_tree(path), ModelFile(path))
    lows, highs = np.array([shape_bounds(each) for each in robot.shapes if each.body < 0]).swapaxes(
        0, 1
    )
    assert ((lows[:, 2] < 0) & (highs[:, 2] >= -1e-9)).any()
    clear = [highs[:, 0].max() + 0.05 * robot.reach, lows[:, 1].min() - 0.05 * robot.reach]
    np.testing.assert_allclose(robot.clear_corner[:2], clear)
    puma = ModelFile(ROOT / "models/puma562.xml")
    drawn = load_shapes(puma, puma.tree()).shapes
    assert len(load_appearance(puma.tree(), puma).shapes) == len(drawn)


VISUAL = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
JOINT = (
    '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/>'
    '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="2"/></joint>'
)
SECRET = "SECRET"
MESHES = ("stl", "obj", "dae", "ply", "msh", "off", "glb", "gltf")
ITSELF = (
    '<COLLADA version="1.4.1"><library_nodes><node id="a"><instance_node url="#a"/></node>'
    '</library_nodes><library_visual_scenes><visual_scene id="s"><node><instance_node url="#a"/>'
    '</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>'
    "</COLLADA>"
)


def robot(path: Path, *meshes: str) -> Path:
    """A URDF of one arm that refers to meshes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    more = "".join(map(VISUAL.format, meshes))
    links = f'<link name="base"/><link name="arm">{MATTER}{more}</link>'
    path.write_text(f'<robot name="r">{links}{JOINT}</robot>')
    return path


@pytest.mark.parametrize("kind", MESHES)
def test_nothing_of_a_home_folder_goes_along(kind: str, tmp_path: Path) -> None:
    """Through a link, by a path upwards, by another ending: all are named, none is copied."""
    home, load = tmp_path / "home", tmp_path / "load"
    home.mkdir()
    (home / "key").write_text(SECRET)
    (home / f"scan.{kind}").write_text(f"solid {SECRET}\nfacet\n")
    names = [f"link.{kind}", "notes.txt", f"../home/scan.{kind}", f"scan.{kind}"]
    path = robot(load / "r.urdf", *names)
    (load / names[0]).symlink_to(home / "key")
    (load / names[1]).write_text(SECRET)
    (load / names[3]).symlink_to(home / names[3])
    copy = copy_model(path, tmp_path / "out/copy")
    assert [each for each in (tmp_path / "out/copy").rglob("*") if each.is_file()] == [copy]
    assert any(names[0] in line for line in sentences(tb.load_tree(path).diagnostics))
    assert not tb.load_tree(copy).diagnostics


@pytest.mark.parametrize("package", [True, False])
def test_meshes_in_their_usual_place_go_along(package: bool, tmp_path: Path) -> None:
    """Beside the model, in a folder beside its own, of a package."""
    top = tmp_path / "arm"
    names = ["own.stl", "../meshes/part.stl"]
    if package:
        names += ["../../deep/part.stl", "package://arm/any/part.stl"]
        top.mkdir()
        (top / "package.xml").write_text("<package/>")
    path = robot(top / "urdf/r.urdf" if not package else top / "a/b/r.urdf", *names)
    places = [path.parent / name for name in names[: 3 if package else 2]]
    places += [top / "any/part.stl"] * package
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
        write_mesh(place)
    copy_model(path, tmp_path / "out/copy")
    assert len(list((tmp_path / "out/copy").rglob("*.stl"))) == len(names)
    assert not tb.load_tree(path).diagnostics


def test_a_mesh_that_kills_or_blocks_its_reader_is_left_out(tmp_path: Path) -> None:
    """Named in the diagnostics; what can be read is drawn."""
    path = robot(tmp_path / "r.urdf", "good.stl", "self.dae", "pipe.obj")
    write_mesh(tmp_path / "good.stl")
    (tmp_path / "self.dae").write_text(ITSELF)
    (tmp_path / "pipe.obj").write_text("mtllib\tm.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    os.mkfifo(tmp_path / "m.mtl")
    seen = load_shapes(ModelFile(path), tb.load_tree(path))
    assert len(seen.shapes) == 1
    said = " ".join(sentences(seen.diagnostics))
    assert "self.dae" in said
    assert "pipe.obj" in said
    assert "good.stl" not in said


def test_a_pipe_as_a_mesh_of_mjcf_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "p.stl")
    (tmp_path / "r.xml").write_text(
        '<mujoco><asset><mesh name="m" file="p.stl"/></asset><worldbody><body><joint/>'
        '<geom type="mesh" mesh="m" mass="1"/></body></worldbody></mujoco>'
    )
    with refuses(ModelError, "p.stl"):
        tb.load_tree(tmp_path / "r.xml")
