"""Distances are those of geometry, their derivatives those of differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import testbed as tb
from testbed.excitation.approach import levers
from testbed.excitation.clearance import FAR, ClearanceTerm, DistanceMeter, watched
from testbed.excitation.collision_model import CELL, FLOOR, STANDING, Obstacle, collision_model
from testbed.excitation.limits import limits_of
from testbed.excitation.samples import Samples
from testbed.robot.rotations import about
from testbed.robot.visuals.shapes import Shape
from tests.helpers.robots import random_robot

NONE = np.zeros((0, 3))
GREY = np.array([0.5, 0.5, 0.5, 1.0])


def ball(body: int, radius: float, place: np.ndarray) -> Shape:
    return Shape(body, "ellipsoid", np.full(3, radius), place, np.eye(3), GREY)


def places(tree: tb.Tree, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation and origin of every body in the bedplate frame, by the tree's own definition."""
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for j, joint in enumerate(tree.joints):
        turn, origin = (np.eye(3), np.zeros(3)) if joint.parent < 0 else found[joint.parent]
        own, slid = np.eye(3), np.zeros(3)
        if joint.revolute:
            own = about(joint.axis, q[j])
        else:
            slid = q[j] * joint.axis
        found.append(
            (turn @ joint.rotation @ own, origin + turn @ (joint.offset + joint.rotation @ slid))
        )
    return found


def balls_on(tree: tb.Tree, seed: int) -> list[Shape]:
    rng = np.random.default_rng(seed)
    return [ball(j, rng.uniform(0.02, 0.05), 0.1 * rng.normal(size=3)) for j in range(-1, tree.n)]


@pytest.mark.parametrize("seed", range(8))
def test_distances_of_balls_are_those_of_their_centres(seed: int) -> None:
    """MuJoCo's kinematics and distances against the tree's definition."""
    tree = random_robot(np.random.default_rng(seed), 5).tree()
    shapes = balls_on(tree, seed)
    collision = collision_model(tree, shapes)
    joined = {(joint.parent, j) for j, joint in enumerate(tree.joints)}
    wanted = {(a, b) for b in range(tree.n) for a in range(-1, b)} - joined
    assert set(collision.pairs) == wanted
    meter = DistanceMeter(collision, far=50.0)
    for q in np.random.default_rng(seed).normal(size=(5, tree.n)):
        at = [(np.eye(3), np.zeros(3)), *places(tree, q)]
        centre = [turn @ s.position + origin for s, (turn, origin) in zip(shapes, at, strict=True)]
        for (a, b), found in zip(collision.pairs, meter.measure(q).values, strict=True):
            apart = np.linalg.norm(centre[a + 1] - centre[b + 1])
            assert found == pytest.approx(apart - shapes[a + 1].size[0] - shapes[b + 1].size[0])


@pytest.mark.parametrize("seed", range(8))
def test_shapes_that_are_passed_over_are_not_the_nearest(seed: int) -> None:
    """Several shapes a body, of every kind: the least distance of all pairs, each measured."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 4).tree()
    sizes = {"box": 3, "ellipsoid": 3, "cylinder": 2, "capsule": 2, "mesh": 0}
    shapes = [
        Shape(
            body,
            kind,  # type: ignore[arg-type]
            rng.uniform(0.01, 0.1, count),
            0.2 * rng.normal(size=3),
            about(np.array([0.6, 0.0, 0.8]), rng.uniform(-3, 3)),
            GREY,
            vertices=rng.normal(size=(20, 3)) * rng.uniform(0.02, 0.1, 3) if not count else NONE,
        )
        for body in range(-1, tree.n)
        for kind, count in sizes.items()
    ]
    collision = collision_model(tree, shapes, floor=-0.3)
    data = mujoco.MjData(collision.model)
    for q in rng.normal(size=(5, tree.n)):
        data.qpos[collision.order] = q
        mujoco.mj_kinematics(collision.model, data)
        wanted = [
            min(
                mujoco.mj_geomDistance(collision.model, data, int(a), int(b), FAR, np.zeros(6))
                for a, b in geoms.T
            )
            for geoms in collision.geoms
        ]
        np.testing.assert_allclose(DistanceMeter(collision).measure(q).values, wanted, atol=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_slopes_are_those_of_differences(seed: int) -> None:
    tree = random_robot(np.random.default_rng(seed), 5).tree()
    meter = DistanceMeter(collision_model(tree, balls_on(tree, seed)), far=50.0)
    for q in np.random.default_rng(seed).normal(size=(3, tree.n)):
        found = meter.measure(q, slopes=True).slopes
        for j, step in enumerate(1e-6 * np.eye(tree.n)):
            near = meter.measure(q + step).values - meter.measure(q - step).values
            np.testing.assert_allclose(found[:, j], near / 2e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_no_distance_changes_faster_than_its_lever(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 6).tree()
    collision = collision_model(tree, balls_on(tree, seed))
    limits, meter = limits_of(tree), DistanceMeter(collision, far=50.0)
    bound = levers(collision, limits)
    used = 0.0
    for _ in range(40):
        q = rng.uniform(limits.low, limits.high)
        slopes = np.abs(meter.measure(q, slopes=True).slopes)
        assert (slopes <= bound + 1e-9).all()
        used = max(used, float((slopes / np.maximum(bound, 1e-12)).max()))
    assert used > 0.3  # a bound, and no idle one
    for (a, b), row in zip(collision.pairs, bound, strict=True):
        between = set(tree.chain(a)) ^ set(tree.chain(b))
        assert {j for j in range(tree.n) if row[j] > 0} == between  # others move neither or both


def test_what_stands_around_the_robot_is_watched_from_the_first_link_on(puma: tb.Tree) -> None:
    """The first link touches the pedestal, stands on the floor, and has to keep clear of a box."""
    shapes = [ball(j, 0.05, np.zeros(3)) for j in range(-1, 3)]
    box = Obstacle(np.array([1.0, 0, 0]), np.array([0.1, 0.2, 0.3]))
    collision = collision_model(puma, shapes, [box], floor=-2.0)
    around = {(CELL, 0), (CELL, 1), (CELL, 2), (FLOOR, 1), (FLOOR, 2)}
    assert {(STANDING, 1), (STANDING, 2), (0, 2), *around} == set(collision.pairs)
    found = DistanceMeter(collision, far=9.0).measure(np.zeros(3)).values
    at = dict(zip(collision.pairs, found, strict=True))
    height = puma.joints[0].offset[2]
    beside = np.array([0.9, 0.0, max(height - 0.3, 0.0)])
    assert at[CELL, 0] == pytest.approx(np.linalg.norm(beside) - 0.05)
    lowest = puma.joints[0].offset[2] + (puma.joints[0].rotation @ puma.joints[1].offset)[2]
    assert at[FLOOR, 1] == pytest.approx(lowest + 2 - 0.05)


def test_pairs_that_always_touch_are_left_out_and_named(puma: tb.Tree) -> None:
    shapes = [ball(0, 0.6, np.zeros(3)), ball(2, 0.9, np.zeros(3)), ball(1, 0.01, np.zeros(3))]
    collision = collision_model(puma, shapes)
    found = watched(collision, limits_of(puma), 0.02, np.random.default_rng(0))
    assert (0, 2) in collision.pairs
    assert (0, 2) not in found.collision.pairs
    assert found.notes == (
        "'link3' to 'link1': their shapes touch in nearly every posture; not watched",
    )


def test_pairs_built_near_to_each_other_keep_half_of_what_they_have(puma: tb.Tree) -> None:
    """Balls on the axes of two parallel joints: 12 mm apart in every posture."""
    length = float(np.linalg.norm(puma.joints[2].offset))
    shapes = [ball(2, 0.1, np.zeros(3)), ball(0, 0.0, np.zeros(3))]
    apart = float(np.linalg.norm(puma.joints[1].offset + puma.joints[2].offset))
    assert length > 0
    shapes[1] = ball(0, 0.05, puma.joints[1].rotation.T @ puma.joints[1].offset)
    collision = collision_model(puma, shapes)
    far = DistanceMeter(collision, far=9.0).measure(np.zeros(3)).values[0]
    clearance = 1.01 * far
    found = watched(collision, limits_of(puma), clearance, np.random.default_rng(0))
    usual = DistanceMeter(found.collision, far=9.0).measure(np.zeros(3)).values
    np.testing.assert_allclose(found.clearance, usual / 2, rtol=0.2)
    assert "half of that is kept" in found.notes[0]
    assert apart > 0


@pytest.mark.parametrize("seed", range(4))
def test_what_is_not_measured_again_would_not_have_mattered(seed: int) -> None:
    """A term that has seen other postures says the same as a fresh one."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 5).tree()
    collision, limits = collision_model(tree, balls_on(tree, seed)), limits_of(tree)
    old = ClearanceTerm(collision, limits, np.full(len(collision.pairs), 0.05))
    q = rng.normal(size=(6, tree.n))
    for step in (0.0, 1e-3, 1e-2, 0.1, 1.0, 0.01):
        q = q + step * rng.normal(size=q.shape)
        here = Samples(q, q, q, {}, None)
        fresh = ClearanceTerm(collision, limits, np.full(len(collision.pairs), 0.05))
        np.testing.assert_array_equal(old.values(here), fresh.values(here))
        np.testing.assert_array_equal(old.slopes(here), fresh.slopes(here))


def test_shapes_that_just_touch_push_in_no_direction(puma: tb.Tree) -> None:
    """Balls of radius zero meet in a point, and the line between two equal points has none."""
    turn, place = places(puma, np.zeros(3))[2]
    for apart, still in ((0.0, True), (0.1, False)):
        there = place + turn @ np.array([apart, 0.0, 0.0])
        shapes = [ball(-1, 1e-12, there), ball(2, 1e-12, np.zeros(3))]
        meter = DistanceMeter(collision_model(puma, shapes), 10.0)
        found = meter.measure(np.zeros(3), slopes=True)
        assert found.values[0] == pytest.approx(apart, abs=1e-9)
        assert found.slopes.any() != still


def test_what_is_flat_cannot_be_hit(puma: tb.Tree) -> None:
    """A mesh without a volume has no hull; one with a volume stands for all it encloses."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    triangles = np.zeros((0, 3))

    def mesh(vertices: np.ndarray) -> Shape:
        placed = np.zeros(3), np.eye(3), GREY
        return Shape(-1, "mesh", np.zeros(0), *placed, vertices=vertices, faces=triangles)

    robot = [ball(2, 0.1, np.zeros(3))]
    assert collision_model(puma, [*robot, mesh(corners * [1, 1, 0])]).pairs == ()
    assert collision_model(puma, [*robot, mesh(corners[:3])]).pairs == ()
    solid = collision_model(puma, [*robot, mesh(np.vstack([corners, [[0.5, 0.5, 0.5]]]))])
    assert list(solid.pairs) == [(STANDING, 2)]
    (found,) = DistanceMeter(solid, 9.0).measure(np.zeros(3)).values
    centre = places(puma, np.zeros(3))[2][1]
    outside = np.maximum(0.0, np.maximum(-centre, centre - 1))
    if outside.any():
        assert found == pytest.approx(np.linalg.norm(outside) - 0.1)
