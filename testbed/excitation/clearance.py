"""Distances between bodies that no joint joins, with derivatives by the joints' positions."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.excitation.approach import levers
from testbed.excitation.collision_model import CELL, CollisionModel
from testbed.excitation.limits import Limits
from testbed.excitation.samples import Instants, Samples

FAR = 0.3
"""Distances beyond this are not told apart [m]."""

NEAR = 0.1
"""In a search, distances count only so far beyond the one to be kept [m]."""

POSTURES = 200
"""Random postures in which pairs of bodies are tried."""

ALWAYS = 0.9
"""A pair that touches in this share of them always does: its shapes say nothing."""

_UNIT = 0.1  # distance that counts as a share of one [m]


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of all watched pairs in one posture.

    Attributes:
        values: (k,) [m]; FAR for FAR and more, negative for shapes that overlap.
        slopes: Derivatives by the joints' positions, (k, n); zero beyond FAR.
        least: What they are at least, (k,) [m]; more than FAR where that is known.
    """

    values: Array
    slopes: Array
    least: Array


class DistanceMeter:
    """Measures distances in one posture after another."""

    def __init__(self, collision: CollisionModel, far: float = FAR) -> None:
        """Ready for any posture.

        Args:
            collision: Shapes, and pairs to be watched.
            far: Distances beyond are not told apart [m].
        """
        self.collision, self._far = collision, far
        self._data = mujoco.MjData(collision.model)
        self._points = np.zeros(6)
        self._jacobian = np.zeros((2, 3, collision.model.nv))
        nothing = np.zeros((2, 0), dtype=np.int64)
        self._first, self._second = np.concatenate([nothing, *collision.geoms], axis=1)
        counts = [geoms.shape[1] for geoms in collision.geoms]
        self._start = np.cumsum([0, *counts])
        radius, kind = collision.model.geom_rbound, collision.model.geom_type
        self._radii = radius[self._first] + radius[self._second]
        flat = kind[self._first] == int(mujoco.mjtGeom.mjGEOM_PLANE)
        self._planes, self._solid = np.flatnonzero(flat), ~flat
        self._pair_of = np.repeat(np.arange(len(counts)), counts)
        self._middle, self._half = np.hsplit(collision.model.geom_aabb, 2)

    def measure(
        self, q: Array, pairs: NDArray[np.bool_] | None = None, *, slopes: bool = False
    ) -> Distances:
        """Distances at positions q, (n,) [rad or m].

        Args:
            q: The posture.
            pairs: Which pairs are asked for, (k,); default all. Others count as far.
            slopes: Whether derivatives are wanted; else they are zero.
        """
        model, data, collision = self.collision.model, self._data, self.collision
        data.qpos[collision.order] = q
        mujoco.mj_kinematics(model, data)
        if slopes:
            mujoco.mj_comPos(model, data)  # which Jacobians need
        every = self._least()
        doubtful = self._solid & (every < self._far)
        if pairs is not None:
            doubtful &= pairs[self._pair_of]
        doubtful = np.flatnonzero(doubtful)
        apart = self._boxes_apart(doubtful)  # zero says nothing of how deep shapes overlap
        every[doubtful] = np.where(apart > 0, np.maximum(every[doubtful], apart), every[doubtful])
        least = np.full(0, self._far)
        if len(every):
            least = np.minimum.reduceat(every, self._start[:-1])
        values, found = np.full(len(least), self._far), np.zeros((len(least), len(q)))
        near = least < self._far
        for k in np.flatnonzero(near if pairs is None else pairs & near).tolist():
            values[k], nearest = self._pair(k, every[self._start[k] : self._start[k + 1]])
            least[k] = values[k]
            if slopes and nearest is not None:
                found[k] = self._slope(values[k], nearest)
        return Distances(values, found, least)

    def _pair(self, pair: int, least: Array) -> tuple[float, tuple[int, int] | None]:
        """Distance of two bodies, and the shapes that are nearest; their points are kept.

        Args:
            pair: Its number.
            least: Bounds from below for its pairs of shapes.
        """
        best, nearest, kept = self._far, None, self._points
        geoms, points = self.collision.geoms[pair], np.zeros(6)
        for k in np.argsort(least).tolist():
            if least[k] >= best:
                break
            a, b = geoms[:, k].tolist()
            found = mujoco.mj_geomDistance(self.collision.model, self._data, a, b, best, points)
            if found < best:
                best, nearest, kept = found, (a, b), points.copy()
        self._points = kept
        return best, nearest

    def _slope(self, distance: float, geoms: tuple[int, int]) -> Array:
        """Derivative of a distance: how its two points move along the line between them."""
        here, there = self._points[:3], self._points[3:]
        length = float(np.linalg.norm(there - here))
        if length < 1e-9:  # shapes just touch: the line has no direction
            return np.zeros(len(self.collision.order))
        model, along = self.collision.model, np.sign(distance) * (there - here) / length
        for jacobian, point, geom in zip(self._jacobian, (here, there), geoms, strict=True):
            mujoco.mj_jac(model, self._data, jacobian, None, point, int(model.geom_bodyid[geom]))
        found = along @ (self._jacobian[1] - self._jacobian[0])
        return np.asarray(found[self.collision.order])

    def _least(self) -> Array:
        """Bounds of all distances from below: by spheres around the shapes."""
        x, first, second = self._data.geom_xpos, self._first, self._second
        away = x[second] - x[first]
        found = np.sqrt(np.einsum("ka,ka->k", away, away)) - self._radii
        found[self._planes] = away[self._planes, 2] - self._radii[self._planes]
        return np.asarray(found)

    def _boxes_apart(self, chosen: NDArray[np.int64]) -> Array:
        """Better bounds for some pairs of shapes: by boxes around each, along its own axes."""
        first, second = self._first[chosen], self._second[chosen]
        turns = self._data.geom_xmat.reshape(-1, 3, 3)
        centres = self._data.geom_xpos + np.einsum("kij,kj->ki", turns, self._middle)
        away = (centres[second] - centres[first])[:, None]
        one, two = turns[first], turns[second]
        between = np.abs(one.transpose(0, 2, 1) @ two)
        reach = self._half[first] + (between @ self._half[second][:, :, None])[:, :, 0]
        back = self._half[second] + (self._half[first][:, None] @ between)[:, 0]
        gaps = np.stack([np.abs(away @ one)[:, 0] - reach, np.abs(away @ two)[:, 0] - back])
        return np.asarray(np.linalg.norm(np.maximum(gaps, 0), axis=2).max(axis=0))


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
        for g in np.flatnonzero((least < self._far).any(axis=1)):
            found = self._meter.measure(postures[g], least[g] < self._far, slopes=True)
            least[g] = np.maximum(least[g], found.least)
            values[:, g] = (self._least - found.values) / _UNIT
            by_motion[:, :n, g] = -found.slopes / _UNIT
        self._seen, self._found = (postures, least), (values, by_motion)
        return self._found

    def _least_here(self, postures: Array) -> Array:
        """What distances are at least, from where they were last, (G, pairs) [m]."""
        if self._seen is None or len(self._seen[0]) != len(postures):
            return np.full((len(postures), len(self._collision.pairs)), -np.inf)
        before, least = self._seen
        return np.asarray(least - np.abs(postures - before) @ self._levers.T)


NARROW = 1.5
"""Pairs that have so much of the clearance, or less, keep half of what they have."""


@dataclass(frozen=True, eq=False)
class Watched:
    """Pairs of bodies whose shapes say something.

    Attributes:
        collision: The pairs.
        clearance: Distance that each has to keep, (k,) [m].
        notes: What is not watched, or kept less, a line each.
    """

    collision: CollisionModel
    clearance: Array
    notes: tuple[str, ...]


def watched(
    collision: CollisionModel, limits: Limits, clearance: float, rng: np.random.Generator
) -> Watched:
    """What a motion can be asked to keep clear.

    Pairs that touch in nearly every posture are left out: their shapes are too coarse. Pairs that
    are about as near to each other as the clearance in the posture of zeros, or in nearly all,
    keep half of what they have there. Obstacles are watched in any case.

    Args:
        collision: All pairs.
        limits: Of the joints' positions.
        clearance: Distance to be kept [m].
        rng: Source of random postures.
    """
    meter, wanted = DistanceMeter(collision, clearance + FAR), len(collision.pairs)
    postures = rng.uniform(limits.low, limits.high, (POSTURES, len(limits.low)))
    found = np.array([meter.measure(q).values for q in postures]).reshape(POSTURES, wanted)
    home = meter.measure(limits.home).values
    around = np.array([a == CELL for a, _ in collision.pairs], dtype=bool)
    free = around | ((found <= 0).mean(axis=0) < ALWAYS)
    always = (found < NARROW * clearance).mean(axis=0) >= ALWAYS
    built = np.where(always, np.median(found, axis=0), np.inf)
    usual = np.minimum(built, np.where(home > 0, home, np.inf))
    kept = np.where(~around & (usual < NARROW * clearance), usual / 2, clearance)
    notes = [
        f"{name}: their shapes touch in nearly every posture; not watched"
        for name, watch in zip(collision.names, free, strict=True)
        if not watch
    ]
    nearer = [k for k in np.flatnonzero(free) if kept[k] < clearance]
    if nearer:
        first = collision.names[nearer[0]]
        more = f" and {len(nearer) - 1} more pairs" if len(nearer) > 1 else ""
        notes.append(f"{first}{more}: built about as near as the clearance; half of that is kept")
    return Watched(collision.only(free.tolist()), kept[free], tuple(notes))
