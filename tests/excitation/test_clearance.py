"""Distances are those of geometry, their derivatives those of differences: bodies that keep clear.

If one fails, a motion that was called clear may hit the robot's own arm, the cell or the floor.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.arrays import Array
from testbed.excitation.approach import levers
from testbed.excitation.clearance import FAR, ClearanceTerm, DistanceMeter, watched
from testbed.excitation.collision_model import CELL, FLOOR, STANDING, Obstacle, collision_model
from testbed.excitation.limits import limits_of
from testbed.excitation.samples import Samples
from testbed.robot.rotations import about
from testbed.robot.visuals.shapes import Kind, Shape
from tests.helpers.shapes import GREY, ball
from tests.helpers.strategies import few, rngs, trees

SIZES: dict[Kind, int] = {"box": 3, "ellipsoid": 3, "cylinder": 2, "capsule": 2, "mesh": 0}


def places(tree: tb.Tree, q: Array) -> list[tuple[Array, Array]]:
    """Rotation and origin of every body in the bedplate frame, by the tree's own definition."""
    found: list[tuple[Array, Array]] = []
    for j, joint in enumerate(tree.joints):
        turn, origin = (np.eye(3), np.zeros(3)) if joint.parent < 0 else found[joint.parent]
        own = about(joint.axis, q[j]) if joint.revolute else np.eye(3)
        slid = np.zeros(3) if joint.revolute else q[j] * joint.axis
        at = origin + turn @ (joint.offset + joint.rotation @ slid)
        found.append((turn @ joint.rotation @ own, at))
    return found


def balls_on(tree: tb.Tree, rng: np.random.Generator) -> list[Shape]:
    return [ball(j, rng.uniform(0.02, 0.05), 0.1 * rng.normal(size=3)) for j in range(-1, tree.n)]


@few(8)
@given(trees((2, 6)), rngs)
def test_distances_of_balls_are_those_of_their_centres_and_change_as_differences_do(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """MuJoCo's kinematics and distances against the tree's definition; no faster than levers."""
    shapes = balls_on(tree, rng)
    collision, limits = collision_model(tree, shapes), limits_of(tree)
    joined = {(joint.parent, j) for j, joint in enumerate(tree.joints)}
    assert set(collision.pairs) == {(a, b) for b in range(tree.n) for a in range(-1, b)} - joined
    meter, bound = DistanceMeter(collision, far=50.0), levers(collision, limits)
    for q in rng.uniform(limits.low, limits.high, (4, tree.n)):
        at = [(np.eye(3), np.zeros(3)), *places(tree, q)]
        centre = [turn @ s.position + origin for s, (turn, origin) in zip(shapes, at, strict=True)]
        here = meter.measure(q, slopes=True)
        for (a, b), found in zip(collision.pairs, here.values, strict=True):
            apart = np.linalg.norm(centre[a + 1] - centre[b + 1])
            assert found == pytest.approx(apart - shapes[a + 1].size[0] - shapes[b + 1].size[0])
        for j, step in enumerate(1e-6 * np.eye(tree.n)):
            near = meter.measure(q + step).values - meter.measure(q - step).values
            np.testing.assert_allclose(here.slopes[:, j], near / 2e-6, atol=1e-6)
        assert (np.abs(here.slopes) <= bound + 1e-9).all()
    for (a, b), row in zip(collision.pairs, bound, strict=True):
        between = set(tree.chain(a)) ^ set(tree.chain(b))
        assert {j for j in range(tree.n) if row[j] > 0} == between  # others move neither or both


@few(5)
@given(trees((2, 4)), rngs)
def test_shapes_that_are_passed_over_are_not_the_nearest(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """Several shapes a body, of every kind: the least distance of all pairs, each measured."""
    shapes = [
        Shape(
            body,
            kind,
            rng.uniform(0.01, 0.1, count),
            0.2 * rng.normal(size=3),
            about(np.array([0.6, 0.0, 0.8]), rng.uniform(-3, 3)),
            GREY,
            vertices=rng.normal(size=(0 if count else 20, 3)) * rng.uniform(0.02, 0.1, 3),
        )
        for body in range(-1, tree.n)
        for kind, count in SIZES.items()
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


@few(4)
@given(trees((3, 5)), rngs)
def test_what_is_not_measured_again_would_not_have_mattered(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """A term that has seen other postures says the same as a fresh one."""
    collision, limits = collision_model(tree, balls_on(tree, rng)), limits_of(tree)
    old = ClearanceTerm(collision, limits, np.full(len(collision.pairs), 0.05))
    q = rng.normal(size=(6, tree.n))
    for step in (0.0, 1e-3, 1e-2, 0.1, 1.0, 0.01):
        q = q + step * rng.normal(size=q.shape)
        here = Samples(q, q, q, {}, None)
        fresh = ClearanceTerm(collision, limits, np.full(len(collision.pairs), 0.05))
        np.testing.assert_array_equal(old.values(here), fresh.values(here))
        np.testing.assert_array_equal(old.slopes(here), fresh.slopes(here))


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
    lowest = height + (puma.joints[0].rotation @ puma.joints[1].offset)[2]
    assert at[FLOOR, 1] == pytest.approx(lowest + 2 - 0.05)


def test_pairs_that_always_touch_are_left_out_and_near_ones_keep_half(puma: tb.Tree) -> None:
    shapes = [ball(0, 0.6, np.zeros(3)), ball(2, 0.9, np.zeros(3)), ball(1, 0.01, np.zeros(3))]
    collision = collision_model(puma, shapes)
    found = watched(collision, limits_of(puma), 0.02, np.random.default_rng(0))
    assert (0, 2) in collision.pairs
    assert (0, 2) not in found.collision.pairs
    (note,) = found.notes
    assert "'link3'" in note
    assert "'link1'" in note
    second = puma.joints[1]  # on the axes of two parallel joints: as near in every posture
    shapes = [ball(2, 0.1, np.zeros(3)), ball(0, 0.05, puma.joints[1].rotation.T @ second.offset)]
    collision = collision_model(puma, shapes)
    far = DistanceMeter(collision, far=9.0).measure(np.zeros(3)).values[0]
    found = watched(collision, limits_of(puma), 1.01 * far, np.random.default_rng(0))
    usual = DistanceMeter(found.collision, far=9.0).measure(np.zeros(3)).values
    np.testing.assert_allclose(found.clearance, usual / 2, rtol=0.2)
    assert len(found.notes) == 1


def test_degenerate_shapes_touch_flatly_and_push_nowhere(puma: tb.Tree) -> None:
    """Balls of radius zero that meet have no direction; a mesh without a volume cannot be hit."""
    turn, place = places(puma, np.zeros(3))[2]
    for apart, still in ((0.0, True), (0.1, False)):
        there = place + turn @ np.array([apart, 0.0, 0.0])
        shapes = [ball(-1, 1e-12, there), ball(2, 1e-12, np.zeros(3))]
        found = DistanceMeter(collision_model(puma, shapes), 10.0).measure(np.zeros(3), slopes=True)
        assert found.values[0] == pytest.approx(apart, abs=1e-9)
        assert found.slopes.any() != still
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    inside = np.vstack([corners, [[0.5, 0.5, 0.5]]])
    for vertices, pairs in (
        (corners * [1, 1, 0], []),
        (corners[:3], []),
        (inside, [(STANDING, 2)]),
    ):
        placed = np.zeros(3), np.eye(3), GREY
        none = np.zeros((0, 3))
        mesh = Shape(-1, "mesh", np.zeros(0), *placed, vertices=vertices, faces=none)
        solid = collision_model(puma, [ball(2, 0.1, np.zeros(3)), mesh])
        assert list(solid.pairs) == pairs
    (distance,) = DistanceMeter(solid, 9.0).measure(np.zeros(3)).values
    outside = np.maximum(0.0, np.maximum(-place, place - 1))
    assert outside.any()
    assert distance == pytest.approx(np.linalg.norm(outside) - 0.1)
