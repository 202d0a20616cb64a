"""What a robot looks like: shapes of its file or sticks, on a plate, and sizes that fit it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.robot.model_file import ModelFile
from testbed.robot.visuals.appearance import Appearance, bounds, load_appearance
from testbed.robot.visuals.ellipsoids import equivalent_ellipsoids
from testbed.robot.visuals.load_shapes import load_shapes
from testbed.robot.visuals.shapes import Kind, Shape, upright
from testbed.robot.visuals.sticks import sticks
from testbed.robot.visuals.triangles import triangles
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot

KINDS: tuple[Kind, ...] = ("box", "ellipsoid", "cylinder", "capsule", "mesh")
ROBOTS = sorted((GOLDEN / "robots").glob("*.urdf"))


def shape(kind: Kind, seed: int = 0, body: int = -1) -> Shape:
    """A shape of some size, somewhere, somehow turned."""
    rng = np.random.default_rng(seed)
    turn = upright(rng.normal(size=3))
    size = rng.uniform(0.05, 0.5, 3 if kind in ("box", "ellipsoid") else 2)
    vertices = rng.normal(size=(8, 3)) if kind == "mesh" else np.zeros((0, 3))
    faces = [[0, 1, 2], [3, 4, 5], [5, 6, 7]] if kind == "mesh" else np.zeros((0, 3))
    grey = np.array([0.5, 0.5, 0.5, 1.0])
    return Shape(body, kind, size, rng.normal(size=3), turn, grey, vertices, np.array(faces))


INSIDE: dict[Kind, Callable[[Array, Array], Array]] = {
    "box": lambda p, s: np.abs(p / s).max(axis=-1),
    "ellipsoid": lambda p, s: np.linalg.norm(p / s, axis=-1),
    "cylinder": lambda p, s: np.maximum(
        np.hypot(p[..., 0], p[..., 1]) / s[0], abs(p[..., 2]) / s[1]
    ),
    "capsule": lambda p, s: np.linalg.norm(
        p - np.clip(p, [0, 0, -s[1]], [0, 0, s[1]]), axis=-1
    ) / s[0],
}  # fmt: skip
"""One on the surface of a shape about the origin, less inside."""


@pytest.mark.parametrize("kind", INSIDE)
@pytest.mark.parametrize("seed", range(3))
def test_triangles_cover_the_surface(kind: Kind, seed: int) -> None:
    """Corners on it, centres a little inside where it is round; all of the area, more than less."""
    made = shape(kind, seed)
    found = triangles(made)
    own = (found - made.position) @ made.rotation
    np.testing.assert_allclose(INSIDE[kind](own, made.size), 1.0, atol=1e-9)
    centres = INSIDE[kind](own.mean(axis=1), made.size)
    assert centres.max() <= 1 + 1e-9
    assert centres.min() > 0.97
    edges = found[:, 1:] - found[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
    s = made.size
    if kind == "box":
        true = 8 * (s[0] * s[1] + s[1] * s[2] + s[2] * s[0])
    elif kind == "cylinder":
        true = 2 * np.pi * s[0] * (s[0] + 2 * s[1])
    elif kind == "capsule":
        true = 4 * np.pi * s[0] * (s[0] + s[1])
    else:  # Thomsen's approximation, to 1.1 %
        p = 1.6075
        pairs = ((s[0] * s[1]) ** p + (s[0] * s[2]) ** p + (s[1] * s[2]) ** p) / 3
        true = 4 * np.pi * pairs ** (1 / p)
    assert area == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_bounds_are_those_of_the_surface(kind: Kind, seed: int) -> None:
    made = shape(kind, seed)
    low, high = bounds(made)
    corners = triangles(made).reshape(-1, 3)
    used = corners if kind != "mesh" else made.vertices @ made.rotation.T + made.position
    width = (high - low).max()
    np.testing.assert_allclose(used.min(axis=0), low, atol=0.01 * width)
    np.testing.assert_allclose(used.max(axis=0), high, atol=0.01 * width)
    assert (used >= low - 1e-9).all()
    assert (used <= high + 1e-9).all()


@pytest.mark.parametrize("kind", KINDS)
def test_arrows_stand_clear_of_all_that_is_on_the_plate(kind: Kind, puma: tb.Tree) -> None:
    standing = tuple(shape(kind, seed) for seed in range(4))
    robot = Appearance(puma, standing)
    for each in standing:
        low, high = bounds(each)
        assert ((robot.corner[:2] < low[:2]) | (robot.corner[:2] > high[:2])).any()
        assert robot.corner[0] > high[0]
        assert robot.corner[1] < low[1]
    assert robot.corner[2] == 0.0


@pytest.mark.parametrize("path", ROBOTS, ids=lambda p: p.stem)
def test_every_robot_stands_on_a_plate_that_arrows_are_clear_of(path: Path) -> None:
    tree = tb.load_tree(path)
    robot = load_appearance(tree, ModelFile(path))
    plates = [bounds(each) for each in robot.shapes if each.body < 0]
    assert any(low[2] < 0 <= high[2] + 1e-9 for low, high in plates)
    right = max(high[0] for _, high in plates)
    front = min(low[1] for low, _ in plates)
    assert robot.corner[0] == pytest.approx(right + 0.05 * robot.reach)
    assert robot.corner[1] == pytest.approx(front - 0.05 * robot.reach)
    widest = max(plates, key=lambda box: np.prod((box[1] - box[0])[:2]))
    assert robot.deck == widest[1][2]


def test_a_plate_that_the_file_draws_is_not_doubled(puma: tb.Tree) -> None:
    drawn = load_shapes(ROOT / "models/puma562.xml", puma).shapes
    assert len(load_appearance(puma, ModelFile(ROOT / "models/puma562.xml")).shapes) == len(drawn)
    assert len(load_appearance(puma).shapes) == len(list(sticks(puma))) + 1


@pytest.mark.parametrize("seed", range(5))
def test_lengths_grow_with_the_robot(seed: int) -> None:
    """Ten times as large, ten times the reach."""
    tree = random_robot(np.random.default_rng(seed), 5).tree()
    joints = tuple(replace(joint, offset=10 * joint.offset) for joint in tree.joints)
    inertias = tuple(
        replace(each, first_moment=10 * each.first_moment, tensor=100 * each.tensor)
        for each in tree.inertias
    )
    small = load_appearance(tree)
    large = load_appearance(replace(tree, joints=joints, inertias=inertias))
    if small.reach > 0.1:
        assert large.reach == pytest.approx(10 * small.reach)
    assert set(small.tips) == {j for j in range(tree.n) if not tree.children(j)}
    for j, tip in small.tips.items():
        far = max([*(np.linalg.norm(s.position) for s in small.shapes if s.body == j),
                   np.linalg.norm(tree.inertias[j].com)])  # fmt: skip
        assert np.linalg.norm(tip) == far


def test_both_languages_give_shapes_to_the_right_bodies() -> None:
    seen = {}
    for name in ("puma562.xml", "puma562.urdf"):
        tree = tb.load_tree(ROOT / "models" / name)
        shapes = load_shapes(ROOT / "models" / name, tree).shapes
        seen[name] = {shape.body for shape in shapes}
        assert all(np.isfinite(shape.position).all() for shape in shapes)
        for each in shapes:  # the upper arm is beside the shoulder, the column below it
            if each.body == 1:
                assert abs(each.position[2]) < 0.6
    assert seen == {"puma562.xml": {-1, 0, 1, 2}, "puma562.urdf": {-1, 0, 1, 2}}


def test_a_robot_without_shapes_is_drawn_as_sticks(puma: tb.Tree) -> None:
    assert {shape.body for shape in sticks(puma)} >= {0, 1, 2}


def test_a_broken_mesh_is_left_out_and_said(tmp_path: Path) -> None:
    text = (GOLDEN / "robots/pendulum.urdf").read_text()
    (tmp_path / "bad.stl").write_bytes(b"no mesh at all")
    visual = '<visual><geometry><mesh filename="bad.stl"/></geometry></visual>'
    box = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
    name = re.findall(r'<link name="(\w+)"', text)[-1]
    text = text.replace(f'<link name="{name}">', f'<link name="{name}">{visual}{box}')
    (tmp_path / "r.urdf").write_text(text)
    tree = tb.load_tree(tmp_path / "r.urdf")
    robot = load_appearance(tree, ModelFile(tmp_path / "r.urdf"))
    assert [shape.kind for shape in robot.shapes if shape.body >= 0] == ["box"]
    assert len(robot.warnings) == 1
    assert "bad.stl" in robot.warnings[0]


@pytest.mark.parametrize("seed", range(4))
def test_ellipsoids_have_the_second_moments_of_their_bodies(seed: int) -> None:
    tree = random_robot(np.random.default_rng(seed), 4).tree()
    shapes = {shape.body: shape for shape in equivalent_ellipsoids(tree, (1, 0, 0, 1))}
    for body, inertia in enumerate(tree.inertias):
        central = inertia.pseudo[:3, :3] - inertia.mass * np.outer(inertia.com, inertia.com)
        possible = inertia.mass > 0 and np.linalg.eigvalsh(central)[0] >= 0
        assert (body in shapes) == possible
        if possible:
            turn, half = shapes[body].rotation, shapes[body].size
            np.testing.assert_allclose(
                inertia.mass / 5 * turn @ np.diag(half**2) @ turn.T, central, atol=1e-12
            )
            np.testing.assert_array_equal(shapes[body].position, inertia.com)
            assert np.linalg.det(turn) == pytest.approx(1)


def test_bodies_that_cannot_be_have_no_ellipsoid() -> None:
    tree = random_robot(np.random.default_rng(0), 3).tree()
    none = tb.Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
    long = tb.Inertia(1.0, np.zeros(3), np.diag([3.0, 1.0, 1.0]))  # no triangle
    tree = replace(tree, inertias=(none, long, tree.inertias[2]))
    assert [shape.body for shape in equivalent_ellipsoids(tree, (1, 0, 0, 1))] == [2]


@pytest.mark.parametrize("count", [1, 5])
def test_meshes_that_are_not_found_are_one_line(count: int, tmp_path: Path) -> None:
    text = (GOLDEN / "robots/pendulum.urdf").read_text()
    mesh = '<visual><geometry><mesh filename="package://lost/{}.stl"/></geometry></visual>'
    meshes = "".join(map(mesh.format, range(count)))
    (tmp_path / "lost.urdf").write_text(re.sub("</link>", f"{meshes}</link>", text, count=1))
    tree = tb.load_tree(tmp_path / "lost.urdf")
    (line,) = load_appearance(tree, ModelFile(tmp_path / "lost.urdf")).warnings
    assert "package://lost/0.stl" in line
    assert (f"and {count - 1} more" in line) == (count > 1)
