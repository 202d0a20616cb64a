"""What a robot looks like: the same in both languages, and where its bodies are."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.arrays import Array
from testbed.robot.model_file import ModelFile
from testbed.robot.rotations import about, to_rpy
from testbed.robot.visuals.appearance import bounds, load_appearance
from testbed.robot.visuals.ellipsoids import equivalent_ellipsoids
from testbed.robot.visuals.load_shapes import load_shapes
from testbed.robot.visuals.shapes import Kind, Shape, upright
from testbed.robot.visuals.sticks import sticks
from testbed.robot.visuals.triangles import triangles
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.strategies import few, seeds, trees

SINGLE = 1e-6  # meshes are kept in single precision


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


SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "mesh": 3}


def clothe(seed: int, folder: Path) -> tuple[dict[str, list[Shape]], Path, Path]:
    """A random robot with random shapes by the name of their body, in both languages."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(2, 7)))
    urdf, mjcf, assets = robot.urdf(), robot.mjcf(), ""
    clothes: dict[str, list[Shape]] = {}
    for name in ("pedestal_body", *(f"{link.name}_body" for link in robot.links)):
        visuals = geoms = ""
        clothes[name] = []
        for k in range(int(rng.integers(0, 4))):
            kind = str(rng.choice(list(SIZES)))
            size, place = rng.uniform(0.05, 0.4, SIZES[kind]), rng.uniform(-0.5, 0.5, 3)
            turn = about(upright(rng.normal(size=3))[:, 2], rng.uniform(-3, 3))
            colour, rpy = np.round(rng.uniform(0, 1, 4), 3), text(to_rpy(turn))
            round_form = f'radius="{text(size[:1])}" length="{text(2 * size[1:])}"'
            form = {
                "box": f'size="{text(2 * size)}"',
                "sphere": f'radius="{text(size)}"',
                "mesh": f'filename="wedge.stl" scale="{text(size)}"',
            }.get(kind, round_form)
            visuals += (
                f'<visual><origin xyz="{text(place)}" rpy="{rpy}"/><geometry><{kind} {form}/>'
            )
            visuals += f'</geometry><material name="{name}{k}"><color rgba="{text(colour)}"/>'
            visuals += "</material></visual>"
            form = f'mesh="{name}{k}"' if kind == "mesh" else f'size="{text(size)}"'
            geoms += f'<geom type="{kind}" {form} pos="{text(place)}" euler="{rpy}" '
            geoms += f'rgba="{text(colour)}"/>'
            if kind == "mesh":
                assets += f'<mesh name="{name}{k}" file="wedge.stl" scale="{text(size)}"/>'
                mesh = (np.zeros(0), place, turn, colour, WEDGE * size, FACES)
                clothes[name].append(Shape(0, "mesh", *mesh))
            else:
                full: Kind = "ellipsoid" if kind == "sphere" else kind  # type: ignore[assignment]
                size = np.repeat(size, 3) if kind == "sphere" else size
                clothes[name].append(Shape(0, full, size, place, turn, colour))
        urdf = urdf.replace(f'<link name="{name}">', f'<link name="{name}">{visuals}')
        mjcf = re.sub(f'(<body name="{name}"[^>]*>)', rf"\1{geoms}", mjcf)
    head = f'<compiler angle="radian" eulerseq="XYZ"/><asset>{assets}</asset>'  # fixed axes
    write_stl(folder / "wedge.stl")
    (folder / "r.urdf").write_text(urdf)
    (folder / "r.xml").write_text(mjcf.replace('<compiler angle="radian"/>', head))
    return clothes, folder / "r.urdf", folder / "r.xml"


def corners_of(shape: Shape) -> Array:
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


@given(seeds)
@few(5)
def test_both_languages_show_what_was_written(seed: int) -> None:
    """A person checks a robot by looking at it: what is shown must be what the file says."""
    with TemporaryDirectory() as folder:
        clothes, urdf, mjcf = clothe(seed, Path(folder))
        for path in (urdf, mjcf):
            tree = tb.load_tree(path)
            seen = load_shapes(path, tree)
            assert seen.warnings == ()
            names = [*(joint.body for joint in tree.joints), "pedestal_body"]
            for name, written in clothes.items():
                shapes = [shape for shape in seen.shapes if names[shape.body] == name]
                wanted = sorted(written, key=lambda one: one.kind == "mesh")  # meshes come last
                shapes.sort(key=lambda one: one.kind == "mesh")
                for one, two in zip(shapes, wanted, strict=True):
                    assert one.kind == two.kind
                    if one.kind == "mesh":
                        np.testing.assert_allclose(corners_of(one), corners_of(two), atol=SINGLE)
                        assert volume(one) == pytest.approx(volume(two), rel=1e-4)
                        continue
                    for what in ("size", "position", "rotation"):
                        a, b = getattr(one, what), getattr(two, what)
                        np.testing.assert_allclose(a, b, atol=1e-12)
                    np.testing.assert_allclose(one.colour, two.colour, atol=SINGLE)


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


def test_shapes_move_as_mujoco_moves_them(tmp_path: Path) -> None:
    """What is drawn of a posture is where MuJoCo has it."""
    path = tmp_path / "r.xml"
    path.write_text(HINGES)
    tree = tb.load_tree(path)
    shapes = load_shapes(path, tree).shapes
    assert [shape.kind for shape in shapes] == ["box", "ellipsoid", "capsule", "cylinder"]
    assert [shape.body for shape in shapes] == [-1, 1, 1, 2]
    np.testing.assert_allclose(shapes[2].size, [0.02, np.sqrt(0.14) / 2])
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    q = np.array([0.7, -1.2, 1.9])
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    for geom, shape in zip((1, 2, 3, 5), shapes, strict=True):
        turn, place = in_the_world(tree, q, shape)
        np.testing.assert_allclose(place, data.geom_xpos[geom], atol=1e-12)
        np.testing.assert_allclose(turn, data.geom_xmat[geom].reshape(3, 3), atol=1e-12)


@given(seeds)
@few(3)
def test_shapes_of_held_bodies_stay_where_they_are_held(seed: int) -> None:
    """A gripper that is held open is shown open, on the link that carries it."""
    with TemporaryDirectory() as folder:
        _, urdf, mjcf = clothe(seed, Path(folder))
        for path in (urdf, mjcf):
            full, rng = tb.load_tree(path), np.random.default_rng(seed)
            q = rng.uniform(-2, 2, full.n)
            names = rng.choice(full.names, size=full.n // 2, replace=False)
            held = {str(name): float(q[full.index(name)]) for name in names}
            locked = tb.load_tree(path, lock=held)
            left = q[[full.index(name) for name in locked.names]]
            before = load_shapes(path, full).shapes
            after = load_shapes(path, locked, lock=held).shapes
            for one, two in zip(before, after, strict=True):
                places = (in_the_world(full, q, one), in_the_world(locked, left, two))
                for a, b in zip(*places, strict=True):
                    np.testing.assert_allclose(a, b, atol=1e-12)


# what cannot be shown

LOOKS = {
    "urdf": '<robot name="r"><link name="b"/><link name="l">{}<visual><geometry>'
    '<box size="1 1 1"/></geometry></visual></link><joint name="j" type="continuous">'
    '<parent link="b"/><child link="l"/></joint></robot>',
    "xml": '<mujoco><asset>{}</asset><worldbody><body name="l"><joint name="j"/>'
    '<inertial mass="1" pos="0 0 0" diaginertia="1 0.1 0.1"/>{}'
    '<geom type="box" size=".5 .5 .5"/></body></worldbody></mujoco>',
}
VISUAL = '<visual><geometry><mesh filename="{}"/></geometry></visual>'


@pytest.mark.parametrize(("form", "damaged"), [("urdf", False), ("xml", True)])
def test_a_mesh_that_cannot_be_read_is_named_and_the_others_are_shown(
    form: str, damaged: bool, tmp_path: Path
) -> None:
    """On a body, too, whose stated inertia no body has."""
    files = ("good.stl", "bad.stl", "fine.obj")
    write_stl(tmp_path / files[0])
    write_obj(tmp_path / files[2])
    if damaged:
        (tmp_path / files[1]).write_bytes(b"no mesh at all")
    parts = ["".join(map(VISUAL.format, files)), ""]
    if form == "xml":
        texts = ('<mesh name="{0}" file="{0}"/>', '<geom type="mesh" mesh="{0}"/>')
        parts = ["".join(map(text.format, files)) for text in texts]
    path = tmp_path / f"r.{form}"
    path.write_text(LOOKS[form].format(*parts))
    seen = load_shapes(path, tb.load_tree(path))
    assert [shape.kind for shape in seen.shapes] == ["mesh", "mesh", "box"]
    for shape in seen.shapes[:2]:  # STL and OBJ hold the same
        assert volume(shape) == pytest.approx(0.3 * 0.2 * 0.5 / 6, rel=1e-4)
    (line,) = seen.warnings
    assert "bad.stl" in line
    assert line.isprintable()


def test_what_is_lost_or_odd_is_said_in_one_line_and_inertias_need_their_mesh(
    tmp_path: Path,
) -> None:
    """Fifty lost meshes of a package are one line, not fifty."""
    path = tmp_path / "r.urdf"
    lost = "".join(VISUAL.format(f"package://lost/{k}.stl") for k in range(5))
    odd = '<visual><origin xyz="0 0,1 0"/><geometry><sphere radius="1"/></geometry></visual>'
    for more, culprit in ((lost, "package://lost/0.stl"), (odd, "0 0,1 0")):
        path.write_text(LOOKS["urdf"].format(more))
        (line,) = load_appearance(tb.load_tree(path), ModelFile(path)).warnings
        assert culprit in line
    mesh = LOOKS["xml"].partition("<inertial")[0].format('<mesh name="m" file="nowhere.stl"/>')
    end = '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    (tmp_path / "r.xml").write_text(mesh + end)
    with refuses(tb.TestbedError, "'l'", "nowhere"):
        tb.load_tree(tmp_path / "r.xml")


# sticks, ellipsoids, plates


@given(trees((1, 7)))
def test_a_robot_without_shapes_is_sticks_from_joint_to_joint(tree: tb.Tree) -> None:
    """Each offset longer than a stick is thick is one stick; each joint is a drum on its axis."""
    radius = max(np.linalg.norm(joint.offset) for joint in tree.joints) / 30
    figure = list(sticks(tree))
    drums = [shape for shape in figure if shape.kind == "cylinder"]
    assert [drum.body for drum in drums] == list(range(tree.n))
    for drum, joint in zip(drums, tree.joints, strict=True):
        np.testing.assert_allclose(drum.rotation[:, 2], joint.axis, atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(drum.rotation), 1.0)
        np.testing.assert_allclose(drum.position, 0.0)
        assert drum.size[0] > radius
    if radius == 0:
        return
    spans = [(joint.parent, joint.offset) for joint in tree.joints]
    spans += [(j, tree.inertias[j].com) for j in range(tree.n) if not tree.children(j)]
    bars = [shape for shape in figure if shape.kind == "capsule"]
    ends = sorted((bar.body, *_end(bar, 1), *_end(bar, -1)) for bar in bars)
    long = [(body, end) for body, end in spans if np.linalg.norm(end) > radius]
    np.testing.assert_allclose(ends, sorted((b, *e, 0.0, 0.0, 0.0) for b, e in long), atol=1e-12)
    assert all(bar.size[0] == pytest.approx(radius) for bar in bars)


def _end(bar: Shape, side: int) -> Array:
    end: Array = np.round(bar.position + side * bar.size[1] * bar.rotation[:, 2], 13) + 0.0
    return end


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


def shape(kind: Kind, rng: np.random.Generator) -> Shape:
    """A shape of some size, somewhere, somehow turned."""
    size = rng.uniform(0.05, 0.5, 3 if kind in ("box", "ellipsoid") else 2)
    mesh = (rng.normal(size=(8, 3)), np.array([[0, 1, 2], [3, 4, 5], [5, 6, 7]]))
    own = mesh if kind == "mesh" else (np.zeros((0, 3)),) * 2
    turn, place = upright(rng.normal(size=3)), rng.normal(size=3)
    return Shape(-1, kind, size, place, turn, np.array([0.5, 0.5, 0.5, 1.0]), *own)


@pytest.mark.parametrize("kind", ["box", "ellipsoid", "cylinder", "capsule", "mesh"])
def test_triangles_cover_a_shape_and_bounds_hold_it(kind: Kind) -> None:
    """Clearances are measured on these triangles: a hole would hide a collision."""
    made = shape(kind, np.random.default_rng(3))
    (low, high), found, s = bounds(made), triangles(made), made.size
    used = found.reshape(-1, 3)
    if kind == "mesh":
        used = made.vertices @ made.rotation.T + made.position
    width = (high - low).max()
    np.testing.assert_allclose(used.min(axis=0), low, atol=0.01 * width)
    np.testing.assert_allclose(used.max(axis=0), high, atol=0.01 * width)
    assert (used >= low - 1e-9).all()
    assert (used <= high + 1e-9).all()
    edges = found[:, 1:] - found[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
    true = {
        "box": 8 * (s[0] * s[1] + s[1] * s[-1] + s[-1] * s[0]),
        "cylinder": 2 * np.pi * s[0] * (s[0] + 2 * s[1]),
        "capsule": 4 * np.pi * s[0] * (s[0] + s[1]),
    }
    assert area == pytest.approx(true.get(kind, area), rel=0.03)
    if kind == "ellipsoid":
        own = (used - made.position) @ made.rotation
        np.testing.assert_allclose(np.linalg.norm(own / s, axis=-1), 1.0, atol=1e-9)


@pytest.mark.parametrize("name", ["ur5", "two_trunks"])
def test_a_robot_stands_on_a_plate_that_arrows_are_clear_of(name: str) -> None:
    """Force arrows would be hidden in the robot; a plate that a file draws is not doubled."""
    path = GOLDEN / f"robots/{name}.urdf"
    robot = load_appearance(tb.load_tree(path), ModelFile(path))
    plates = [bounds(each) for each in robot.shapes if each.body < 0]
    assert any(low[2] < 0 <= high[2] + 1e-9 for low, high in plates)
    assert robot.corner[0] == pytest.approx(max(b[1][0] for b in plates) + 0.05 * robot.reach)
    assert robot.corner[1] == pytest.approx(min(b[0][1] for b in plates) - 0.05 * robot.reach)
    widest = max(plates, key=lambda box: np.prod((box[1] - box[0])[:2]))
    assert robot.deck == widest[1][2]
    puma = ModelFile(ROOT / "models/puma562.xml")
    drawn = load_shapes(puma.path, puma.tree()).shapes
    assert len(load_appearance(puma.tree(), puma).shapes) == len(drawn)
    assert len(load_appearance(puma.tree()).shapes) == len(list(sticks(puma.tree()))) + 1
