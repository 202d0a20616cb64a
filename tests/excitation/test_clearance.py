"""Distances are those of geometry, their derivatives those of differences: bodies that keep clear.

If one fails, a motion that was called clear may hit the robot's own arm, the cell or the floor.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.bodies.shapes.shapes import Kind, Shape
from testbed.core.base.diagnostics import sentences
from testbed.core.dynamics.newton_euler import poses
from testbed.core.robot.inertia import about
from testbed.motion.clearance import FAR, ClearanceTerm, DistanceMeter
from testbed.motion.collision_model import (
    CELL,
    FLOOR,
    STANDING,
    Obstacle,
    collision_model,
    levers,
)
from testbed.motion.limits import limits_of
from testbed.motion.samples import Samples
from testbed.motion.surroundings import watched
from tests.helpers.shapes import GREY, ball
from tests.helpers.strategies import few, rngs, trees

SIZES: dict[Kind, int] = {"box": 3, "ellipsoid": 3, "cylinder": 2, "capsule": 2, "mesh": 0}


def distances(tree: tb.Tree, *shapes: Shape, **around: object) -> dict[tuple[int, int], float]:
    """In the posture of zeros, by pair."""
    collision = collision_model(tree, shapes, **around)  # type: ignore[arg-type]
    found = DistanceMeter(collision, far=9.0).measure(np.zeros(tree.n)).values
    return dict(zip(collision.pairs, found.tolist(), strict=True))


@few(8)
@given(trees((2, 6)), rngs)
def test_distances_of_balls_are_those_of_their_centres_and_change_as_differences_do(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """No faster than levers; a limit is what a distance lacks."""
    shapes = [ball(j, rng.uniform(0.02, 0.05), 0.1 * rng.normal(size=3)) for j in range(-1, tree.n)]
    collision, limits = collision_model(tree, shapes), limits_of(tree)
    joined = {(joint.parent, j) for j, joint in enumerate(tree.joints)}
    assert set(collision.pairs) == {(a, b) for b in range(tree.n) for a in range(-1, b)} - joined
    meter, bound = DistanceMeter(collision, far=50.0), levers(collision, limits)
    for q in rng.uniform(limits.low, limits.high, (4, tree.n)):
        at = [(np.eye(3)[None], np.zeros((1, 3))), *poses(tree, q[None])]
        centre = [t[0] @ s.position + o[0] for s, (t, o) in zip(shapes, at, strict=True)]
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
    term = ClearanceTerm(collision, np.full(len(collision.pairs), 0.05))
    for q in rng.uniform(limits.low, limits.high, (2, 6, tree.n)):
        samples, found = Samples(q, q, q, {}, None), DistanceMeter(collision, 0.15).measure(q)
        np.testing.assert_allclose(term.values(samples), (0.05 - found.values.T) / 0.1)


@few(5)
@given(trees((2, 4)), rngs)
def test_shapes_that_are_passed_over_are_not_the_nearest(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """Several shapes a body, of every kind: the least distance of all pairs, each measured."""

    def some(body: int, kind: Kind, count: int) -> Shape:
        size, turn = rng.uniform(0.01, 0.1, count), about(np.array([0.6, 0.0, 0.8]), rng.normal())
        corners = rng.normal(size=(0 if count else 20, 3)) * rng.uniform(0.02, 0.1, 3)
        return Shape(body, kind, size, 0.2 * rng.normal(size=3), turn, GREY, vertices=corners)

    shapes = [some(body, *each) for body in range(-1, tree.n) for each in SIZES.items()]
    collision = collision_model(tree, shapes, floor=-0.3)
    model, data = collision.model, mujoco.MjData(collision.model)
    for q in rng.normal(size=(5, tree.n)):
        data.qpos[collision.order] = q
        mujoco.mj_kinematics(model, data)
        wanted = [
            min(mujoco.mj_geomDistance(model, data, a, b, FAR, None) for a, b in geoms.T.tolist())
            for geoms in collision.geoms
        ]
        np.testing.assert_allclose(DistanceMeter(collision).measure(q).values, wanted, atol=1e-6)


def test_what_stands_around_the_robot_is_watched_from_the_first_link_on(puma: tb.Tree) -> None:
    """The first link touches the pedestal, stands on the floor, and has to keep clear of a box."""
    shapes = [ball(j, 0.05, np.zeros(3)) for j in range(-1, 3)]
    box = Obstacle(np.array([1.0, 0, 0]), np.array([0.1, 0.2, 0.3]))
    found = distances(puma, *shapes, obstacles=[box], floor=-2.0)
    around = {(CELL, 0), (CELL, 1), (CELL, 2), (FLOOR, 1), (FLOOR, 2)}
    assert {(STANDING, 1), (STANDING, 2), (0, 2), *around} == set(found)
    height = puma.joints[0].offset[2]
    beside = np.array([0.9, 0.0, max(height - 0.3, 0.0)])
    assert found[CELL, 0] == pytest.approx(np.linalg.norm(beside) - 0.05)
    lowest = height + (puma.joints[0].rotation @ puma.joints[1].offset)[2]
    assert found[FLOOR, 1] == pytest.approx(lowest + 2 - 0.05)


def test_pairs_that_always_touch_are_left_out_and_near_ones_keep_half(puma: tb.Tree) -> None:
    second = puma.joints[1]  # on the axes of two parallel joints: as near in every posture
    near = ball(2, 0.1, np.zeros(3)), ball(0, 0.05, second.rotation.T @ second.offset)
    far = distances(puma, *near)[0, 2]
    touching = ball(0, 0.6, np.zeros(3)), ball(2, 0.9, np.zeros(3))
    for shapes, clearance, kept in ((near, 1.01 * far, [far / 2]), (touching, 0.02, [])):
        collision = collision_model(puma, list(shapes))
        found = watched(collision, limits_of(puma), clearance)
        np.testing.assert_allclose(found.clearance, kept, rtol=0.2)
        (note,) = sentences(found.diagnostics)
        assert [link for link in ("'link1'", "'link3'") if link not in note] == []
