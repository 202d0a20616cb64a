"""Distances between bodies that no joint joins, with derivatives by the joints' positions."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.motion.collision_model import CollisionModel, levers
from testbed.motion.limits import Limits
from testbed.motion.samples import Instants, Samples

FAR = 0.3
"""Distances beyond this are not distinguished [m]."""

NEAR = 0.1
"""In a search, distances count only so far beyond the one to be kept [m]."""

_UNIT = 0.1  # distance that counts as a share of one [m]


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of all watched pairs, posture by posture.

    Attributes:
        values: (..., k) [m]; FAR for FAR and more, negative for shapes that overlap.
        slopes: Derivatives by the joints' positions, (..., k, n); zero beyond FAR.
        least: What they are at least, (..., k) [m]; more than FAR where that is known.
    """

    values: Array
    slopes: Array
    least: Array


class DistanceMeter:
    """Measures distances in any postures: bounds for all at once, what is near one by one."""

    def __init__(self, collision: CollisionModel, far: float = FAR) -> None:
        """Ready for any posture.

        Args:
            collision: Shapes, and pairs to be watched.
            far: Distances beyond are not distinguished [m].
        """
        self.collision, self._far = collision, far
        model = collision.model
        self._data = mujoco.MjData(model)
        nothing = np.zeros((2, 0), dtype=np.int64)
        self._first, self._second = np.concatenate([nothing, *collision.geoms], axis=1)
        counts = [geoms.shape[1] for geoms in collision.geoms]
        self._start = np.cumsum([0, *counts])
        self._radii = model.geom_rbound[self._first] + model.geom_rbound[self._second]
        flat = model.geom_type[self._first] == int(mujoco.mjtGeom.mjGEOM_PLANE)
        self._planes, self._solid = np.flatnonzero(flat), ~flat
        self._pair_of = np.repeat(np.arange(len(counts)), counts)
        self._middle, self._half = np.hsplit(model.geom_aabb, 2)
        self._moved = _moved(model)[:, collision.order]

    def measure(
        self, q: Array, pairs: NDArray[np.bool_] | None = None, *, slopes: bool = False
    ) -> Distances:
        """Distances at positions q, (..., n) [rad or m].

        Args:
            q: The postures.
            pairs: Which pairs are asked for, (..., k); default all. Others count as far.
            slopes: Whether derivatives are wanted; else they are zero.
        """
        shape, n = q.shape[:-1], q.shape[-1]
        count, wanted = int(np.prod(shape)), len(self.collision.pairs)
        asked = np.ones((count, wanted), dtype=bool)
        if pairs is not None:
            asked = pairs.reshape(count, wanted)
        there = self._placed(q.reshape(count, n))
        every = self._bounds(there, asked)
        least = np.full((count, 0), self._far)
        if every.shape[1]:
            least = np.minimum.reduceat(every, self._start[:-1], axis=1)
        near, found = self._near(there, asked & (least < self._far), every)
        values, by_q = np.full((count, wanted), self._far), np.zeros((count, wanted, n))
        values[near] = least[near] = found.distance
        if slopes:
            by_q[near] = self._slopes(there, near[0], found)
        return Distances(
            values.reshape(*shape, wanted),
            by_q.reshape(*shape, wanted, n),
            least.reshape(*shape, wanted),
        )

    def _placed(self, postures: Array) -> _Places:
        """Where shapes and joints are, posture by posture."""
        model, data, order = self.collision.model, self._data, self.collision.order
        count = len(postures)
        there = _Places(
            np.empty((count, *data.geom_xpos.shape)),
            np.empty((count, *data.geom_xmat.shape)),
            np.empty((count, *data.xanchor.shape)),
            np.empty((count, *data.xaxis.shape)),
        )
        for g, q in enumerate(postures):
            data.qpos[order] = q
            mujoco.mj_kinematics(model, data)
            there.place[g], there.turn[g] = data.geom_xpos, data.geom_xmat
            there.anchor[g], there.axis[g] = data.xanchor, data.xaxis
        return there

    def _bounds(self, there: _Places, asked: NDArray[np.bool_]) -> Array:
        """Bounds from below of distances of pairs of shapes, (G, pairs of shapes) [m].

        By spheres around the shapes; where that leaves a doubt, by boxes.
        """
        x = np.ascontiguousarray(there.place.transpose(2, 0, 1))
        away = x[:, :, self._second] - x[:, :, self._first]
        found = np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2) - self._radii
        found[:, self._planes] = away[2][:, self._planes] - self._radii[self._planes]
        doubtful = self._solid & (found < self._far) & asked[:, self._pair_of]
        at = np.nonzero(doubtful)
        apart = self._boxes_apart(there, *at)  # zero says nothing of how deep shapes overlap
        found[at] = np.where(apart > 0, np.maximum(found[at], apart), found[at])
        return np.asarray(found)

    def _boxes_apart(
        self, there: _Places, g: NDArray[np.int64], chosen: NDArray[np.int64]
    ) -> Array:
        """Better bounds for some pairs of shapes: by boxes around each, along its own axes."""
        first, second = self._first[chosen], self._second[chosen]
        turns = there.turn.reshape(*there.place.shape, 3)
        centres = there.place + np.einsum("gkij,kj->gki", turns, self._middle)
        away = (centres[g, second] - centres[g, first])[:, None]
        one, two = turns[g, first], turns[g, second]
        between = np.abs(one.transpose(0, 2, 1) @ two)
        reach = self._half[first] + (between @ self._half[second][:, :, None])[:, :, 0]
        back = self._half[second] + (self._half[first][:, None] @ between)[:, 0]
        gaps = np.stack([np.abs(away @ one)[:, 0] - reach, np.abs(away @ two)[:, 0] - back])
        return np.asarray(np.linalg.norm(np.maximum(gaps, 0), axis=2).max(axis=0))

    def _near(
        self, there: _Places, wanted: NDArray[np.bool_], least: Array
    ) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], _Nearest]:
        """Pairs of bodies that are measured, by posture and number, and what was found.

        Args:
            there: Where shapes are.
            wanted: Which are to be measured, (G, k).
            least: Bounds from below for pairs of shapes.
        """
        data, at = self._data, np.nonzero(wanted)
        found = _Nearest.of(len(at[0]), self._far)
        before = -1
        for row, (g, k) in enumerate(zip(*(part.tolist() for part in at), strict=True)):
            if g != before:
                data.geom_xpos[:], data.geom_xmat[:], before = there.place[g], there.turn[g], g
            self._pair(k, least[g, self._start[k] : self._start[k + 1]], found, row)
        return (at[0], at[1]), found

    def _pair(self, pair: int, least: Array, found: _Nearest, row: int) -> None:
        """Distance of two bodies, and the shapes that are nearest with their points.

        Args:
            pair: Its number.
            least: Bounds from below for its pairs of shapes.
            found: Set.
            row: Where.
        """
        model, best, points = self.collision.model, self._far, np.empty(6)
        geoms = self.collision.geoms[pair]
        for k in np.argsort(least).tolist() if len(least) > 1 else [0]:
            if least[k] >= best:
                break
            a, b = geoms[:, k].tolist()
            distance = mujoco.mj_geomDistance(model, self._data, a, b, best, points)
            if distance < best:
                best, found.points[row], found.geoms[row] = distance, points, (a, b)
        found.distance[row] = best

    def _slopes(self, there: _Places, g: NDArray[np.int64], found: _Nearest) -> Array:
        """Derivatives of distances: how their two points move along the lines between them."""
        model, order = self.collision.model, self.collision.order
        here, beyond = np.hsplit(found.points, 2)
        line = beyond - here
        length = np.linalg.norm(line, axis=1)
        apart = (length >= 1e-9) & (found.geoms[:, 0] >= 0)  # else the line has no direction
        along = np.sign(found.distance) * apart / np.where(apart, length, 1.0)
        line = (along[:, None] * line)[:, None]
        axis, anchor = there.axis[g][:, order], there.anchor[g][:, order]
        slides = model.jnt_type[order] == int(mujoco.mjtJoint.mjJNT_SLIDE)
        total = np.zeros(axis.shape[:2])
        for sign, point, geom in zip((-1, 1), (here, beyond), found.geoms.T, strict=True):
            moves = np.where(slides[:, None], axis, np.cross(axis, point[:, None] - anchor))
            moved = self._moved[model.geom_bodyid[geom]]
            total += (
                sign * moved * np.einsum("ija,ija->ij", moves, np.broadcast_to(line, moves.shape))
            )
        return total


@dataclass(frozen=True, eq=False)
class _Places:
    """Of shapes and joints in G postures, in the world's frame, as MuJoCo has them."""

    place: Array  # of shapes, (G, shapes, 3)
    turn: Array  # (G, shapes, 9)
    anchor: Array  # of joints, (G, n, 3)
    axis: Array  # (G, n, 3)


@dataclass(frozen=True, eq=False)
class _Nearest:
    """Distances that were measured, the nearest shapes (-1 for none) and their points."""

    distance: Array
    geoms: NDArray[np.int64]  # (r, 2)
    points: Array  # (r, 6)

    @staticmethod
    def of(count: int, far: float) -> _Nearest:
        return _Nearest(
            np.full(count, far), np.full((count, 2), -1, dtype=np.int64), np.zeros((count, 6))
        )


def _moved(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Whether a joint moves a body, (bodies, joints)."""
    found = np.zeros((model.nbody, model.nv), dtype=bool)
    for body in range(1, model.nbody):
        found[body] = found[model.body_parentid[body]]
        first = model.body_dofadr[body]
        found[body, first : first + model.body_dofnum[body]] = True
    return found


class ClearanceTerm:
    """Distances that pairs of bodies must keep.

    A search comes by nearly the same postures again and again: pairs that were so far apart that
    they cannot have come near since are not measured.
    """

    def __init__(self, collision: CollisionModel, limits: Limits, least: Array) -> None:
        """Ready to be asked.

        Args:
            collision: Shapes, and pairs to be watched.
            limits: Of the joints' positions.
            least: Distance that each keeps, (k,) [m].
        """
        self._collision, self._least = collision, least
        self._far = float(least.max(initial=0.0)) + NEAR
        self._meter = DistanceMeter(collision, self._far)
        self._levers = levers(collision, limits)
        self._seen: tuple[Array, Array] | None = None  # postures, and least distances there
        self._found = np.zeros(0), np.zeros(0)  # values and derivatives there

    @property
    def labels(self) -> tuple[str, ...]:
        """What each is a limit of."""
        return tuple(f"clearance of {name}" for name in self._collision.names)

    def values(self, samples: Instants) -> Array:
        """Missing distances as shares, (k, G)."""
        return self._both(samples.q)[0]

    def slopes(self, samples: Samples) -> Array:
        """Derivatives, (k, 3 n, G)."""
        return self._both(samples.q)[1]

    def _both(self, postures: Array) -> tuple[Array, Array]:
        """Values and derivatives; kept, as a search asks for the same postures several times."""
        if self._seen is not None and np.array_equal(self._seen[0], postures):
            return self._found
        instants, n = postures.shape
        least = self._least_here(postures)
        far = (self._least - self._far) / _UNIT
        values = np.tile(far[:, None], instants)
        by_motion = np.zeros((least.shape[1], 3 * n, instants))
        near = np.flatnonzero((least < self._far).any(axis=1))
        found = self._meter.measure(postures[near], least[near] < self._far, slopes=True)
        least[near] = np.maximum(least[near], found.least)
        values[:, near] = (self._least - found.values).T / _UNIT
        by_motion[:, :n, near] = -found.slopes.transpose(1, 2, 0) / _UNIT
        self._seen, self._found = (postures, least), (values, by_motion)
        return self._found

    def _least_here(self, postures: Array) -> Array:
        """What distances are at least, from where they were last, (G, pairs) [m]."""
        if self._seen is None or len(self._seen[0]) != len(postures):
            return np.full((len(postures), len(self._collision.pairs)), -np.inf)
        before, least = self._seen
        return least - np.abs(postures - before) @ self._levers.T
