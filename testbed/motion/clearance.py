"""Distances between bodies that no joint joins, with derivatives by the joints' positions."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.motion.collision_model import CollisionModel
from testbed.motion.samples import MotionSamples, Samples

FAR = 0.3
"""Distances beyond this are not distinguished [m]."""

NEAR = 0.1
"""In a search, distances count only so far beyond the one to be kept [m]."""

CLEARANCE_UNIT = 0.1
"""Missing distance that counts as a share of one [m]."""


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of all watched pairs, posture by posture.

    Attributes:
        values: (..., k) [m]; FAR for FAR and more, negative for shapes that overlap.
        slopes: Derivatives by the joints' positions, (..., k, n); zero beyond FAR.
    """

    values: Array
    slopes: Array


class DistanceMeter:
    """Distances in any postures: what bounding spheres show to be near, by MuJoCo.

    Attributes:
        collision: Shapes, and pairs to be watched.
        far: Distances beyond are not distinguished [m].
    """

    def __init__(self, collision: CollisionModel, far: ArrayLike = FAR) -> None:
        """Set up bounds.

        Args:
            collision: Shapes, and pairs to be watched.
            far: Distances beyond are not distinguished, of each pair or of all [m].
        """
        self.collision, self.far = collision, float(np.max(far, initial=0.0))
        model = collision.model
        self._data = mujoco.MjData(model)
        counts = [geoms.shape[1] for geoms in collision.geoms]
        self._pair = np.repeat(np.arange(len(counts)), counts)
        none = np.zeros((2, 0), dtype=np.int64)
        self._geoms = np.concatenate([none, *collision.geoms], axis=1)
        self._radii = model.geom_rbound[self._geoms].sum(axis=0)
        self._flat = model.geom_type[self._geoms[0]] == int(mujoco.mjtGeom.mjGEOM_PLANE)

    def measure(self, q: Array, *, slopes: bool = False) -> Distances:
        """Distances at positions q, (..., n) [rad or m].

        Args:
            q: The postures.
            slopes: Whether derivatives are wanted; else they are zero.
        """
        shape = *q.shape[:-1], len(self.collision.pairs)
        found = Distances(np.full(shape, self.far), np.zeros((*shape, q.shape[-1])))
        for at in np.ndindex(*shape[:-1]):
            self._place(q[at])
            bounds = self._bounds()
            for k in np.argsort(bounds):
                if bounds[k] >= self.far:
                    break
                pair = int(self._pair[k])
                if bounds[k] < found.values[at][pair]:
                    distance, points = self._distance(k, found.values[at][pair])
                    if distance < found.values[at][pair]:
                        found.values[at][pair] = distance
                        if slopes:
                            found.slopes[at][pair] = self._slopes(k, distance, points)
        return found

    def _place(self, q: Array) -> None:
        """Put the robot into a posture, (n,)."""
        self._data.qpos[self.collision.order] = q
        mujoco.mj_kinematics(self.collision.model, self._data)
        mujoco.mj_comPos(self.collision.model, self._data)

    def _bounds(self) -> Array:
        """Bounds from below of distances of pairs of shapes, by spheres around them [m]."""
        first, second = self._data.geom_xpos[self._geoms]
        away = second - first
        size = np.where(self._flat, away[:, 2], np.linalg.norm(away, axis=1))
        return np.asarray(size - self._radii)

    def _distance(self, k: int, far: float) -> tuple[float, Array]:
        """Distance of two shapes, `far` for more, and the points that are nearest, (2, 3) [m]."""
        first, second = self._geoms[:, k].tolist()
        points = np.empty(6)
        data, model = self._data, self.collision.model
        found = mujoco.mj_geomDistance(model, data, first, second, far, points)
        return found, points.reshape(2, 3)

    def _slopes(self, k: int, distance: float, points: Array) -> Array:
        """Derivatives of a distance: how its two points move along the line between them, (n,)."""
        line = points[1] - points[0]
        length = float(np.linalg.norm(line))
        if length < 1e-9:  # the line has no direction
            return np.zeros(len(self.collision.order))
        model = self.collision.model
        moves = np.zeros((2, 3, model.nv))
        for point, geom, move in zip(points, self._geoms[:, k], moves, strict=True):
            mujoco.mj_jac(model, self._data, move, None, point, model.geom_bodyid[geom])
        slopes = np.sign(distance) / length * line @ (moves[1] - moves[0])
        return np.asarray(slopes[self.collision.order])


class ClearanceTerm:
    """Distances that pairs of bodies must keep."""

    def __init__(self, collision: CollisionModel, least: Array) -> None:
        """Set up the limits.

        Args:
            collision: Shapes, and pairs to be watched.
            least: Distance that each keeps, (k,) [m].
        """
        self.labels = tuple(f"clearance of {name}" for name in collision.names)
        self._least = least
        self._meter = DistanceMeter(collision, least + NEAR)
        self._postures = np.zeros((0, 0))
        self._found = self._meter.measure(np.zeros((0, 0)))

    def values(self, samples: MotionSamples) -> Array:
        """Missing distances as shares, (k, G)."""
        return (
            self._least[:, None] - self._measured(samples.motion.q).values.T
        ) / CLEARANCE_UNIT

    def slopes(self, samples: Samples) -> Array:
        """Derivatives, (k, 3 n, G)."""
        by_q = (
            -self._measured(samples.motion.q).slopes.transpose(1, 2, 0) / CLEARANCE_UNIT
        )
        return np.concatenate([by_q, np.zeros_like(by_q), np.zeros_like(by_q)], axis=1)

    def _measured(self, postures: Array) -> Distances:
        """Distances in postures, (G, n); kept, as a search asks several times for the same."""
        if not np.array_equal(self._postures, postures):
            self._postures = postures
            self._found = self._meter.measure(postures, slopes=True)
        return self._found
