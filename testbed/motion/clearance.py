"""Distances between pairs of bodies that no joint connects, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.motion.collision_model import CollisionModel
from testbed.motion.samples import KernelForces, MotionSamples

MAX_DISTANCE = 0.3
"""Largest distance that is computed [m]."""

SEARCH_DISTANCE = 0.1
"""Distance beyond the required clearance up to which a search computes distances [m]."""

CLEARANCE_UNIT = 0.1
"""Shortfall of a distance that corresponds to a normalised excess of one [m]."""


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of all watched pairs of bodies in one or more postures.

    Attributes:
        values: Distances of the k pairs, (..., k) [m]; at most the largest computed distance,
            negative for overlap.
        slopes: Derivatives with respect to the n joint positions, (..., k, n); zero beyond the
            largest computed distance.
    """

    values: Array
    slopes: Array


class DistanceMeter:
    """Computation of distances in given postures by MuJoCo, after a bounding-sphere test.

    Attributes:
        collision: Shapes and watched pairs.
        max_distance: Largest distance that is computed [m].
    """

    def __init__(
        self, collision: CollisionModel, max_distance: ArrayLike = MAX_DISTANCE
    ) -> None:
        """Prepare the bounding spheres of all pairs of shapes.

        Args:
            collision: Shapes and watched pairs.
            max_distance: Largest distance that is computed [m]; the largest of several values is
                used.
        """
        self.collision, self.max_distance = (
            collision,
            float(np.max(max_distance, initial=0.0)),
        )
        model = collision.model
        self._data = mujoco.MjData(model)
        counts = [geoms.shape[1] for geoms in collision.geoms]
        self._pair = np.repeat(np.arange(len(counts)), counts)
        none = np.zeros((2, 0), dtype=np.int64)
        self._geoms = np.concatenate([none, *collision.geoms], axis=1)
        self._radii = model.geom_rbound[self._geoms].sum(axis=0)
        self._flat = model.geom_type[self._geoms[0]] == int(mujoco.mjtGeom.mjGEOM_PLANE)

    def measure(self, q: Array, *, slopes: bool = False) -> Distances:
        """Compute distances of all watched pairs in postures.

        A pair's distance is the smallest of its shapes' distances, at most `max_distance`.

        Args:
            q: Joint positions, (..., n) [rad or m].
            slopes: True to compute derivatives; otherwise they are zero.
        """
        shape = *q.shape[:-1], len(self.collision.pairs)
        distances = Distances(
            np.full(shape, self.max_distance), np.zeros((*shape, q.shape[-1]))
        )
        for index in np.ndindex(*shape[:-1]):
            self._place(q[index])
            lower_bounds = self._bounds()
            for k in np.argsort(lower_bounds):
                if lower_bounds[k] >= self.max_distance:
                    break
                pair = int(self._pair[k])
                if lower_bounds[k] < distances.values[index][pair]:
                    distance, points = self._distance(k, distances.values[index][pair])
                    if distance < distances.values[index][pair]:
                        distances.values[index][pair] = distance
                        if slopes:
                            distances.slopes[index][pair] = self._slopes(
                                k, distance, points
                            )
        return distances

    def _place(self, q: Array) -> None:
        """Set the robot's joint positions, (n,), and update MuJoCo's kinematics."""
        self._data.qpos[self.collision.order] = q
        mujoco.mj_kinematics(self.collision.model, self._data)
        mujoco.mj_comPos(self.collision.model, self._data)

    def _bounds(self) -> Array:
        """Lower bounds of the distances of s pairs of shapes from bounding spheres, (s,) [m].

        The bound for the floor plane is the height of the bounding sphere above the plane.
        """
        first, second = self._data.geom_xpos[self._geoms]
        displacement = second - first
        centre_distance = np.where(
            self._flat, displacement[:, 2], np.linalg.norm(displacement, axis=1)
        )
        return np.asarray(centre_distance - self._radii)

    def _distance(self, k: int, max_distance: float) -> tuple[float, Array]:
        """Distance of a pair of shapes, and the nearest points, (2, 3) [m].

        Args:
            k: Index of the pair of shapes.
            max_distance: Value for larger distances [m].
        """
        first, second = self._geoms[:, k].tolist()
        points = np.empty(6)
        data, model = self._data, self.collision.model
        distance = mujoco.mj_geomDistance(
            model, data, first, second, max_distance, points
        )
        return distance, points.reshape(2, 3)

    def _slopes(self, k: int, distance: float, points: Array) -> Array:
        """Derivatives of a pair's distance with respect to the joint positions, (n,).

        The derivatives are the difference between the Jacobians of the two nearest points,
        projected onto the line between the points. They are zero for points closer than 1 nm, where
        the direction is undefined.

        Args:
            k: Index of the pair of shapes.
            distance: Distance, negative for overlap [m].
            points: Nearest points, (2, 3) [m].
        """
        difference = points[1] - points[0]
        length = float(np.linalg.norm(difference))
        if length < 1e-9:  # the direction is undefined
            return np.zeros(len(self.collision.order))
        model = self.collision.model
        jacobians = np.zeros((2, 3, model.nv))
        for point, geom, jacobian in zip(
            points, self._geoms[:, k], jacobians, strict=True
        ):
            mujoco.mj_jac(
                model, self._data, jacobian, None, point, model.geom_bodyid[geom]
            )
        slopes = np.sign(distance) / length * difference @ (jacobians[1] - jacobians[0])
        return np.asarray(slopes[self.collision.order])


class ClearanceTerm:
    """Minimum distances between pairs of bodies as limits of a search."""

    def __init__(self, collision: CollisionModel, clearance: Array) -> None:
        """Prepare the limits.

        Args:
            collision: Shapes and watched pairs.
            clearance: Required distance of each pair, (k,) [m].
        """
        self.labels = tuple(f"clearance of {name}" for name in collision.names)
        self._clearance = clearance
        self._meter = DistanceMeter(collision, clearance + SEARCH_DISTANCE)
        self._last_postures = np.zeros((0, 0))
        self._last_distances = self._meter.measure(np.zeros((0, 0)))

    def values(self, samples: MotionSamples) -> Array:
        """Normalised shortfalls of the distances, (k, G); negative where limits are respected.

        The values are (clearance - distance) / CLEARANCE_UNIT for k pairs at G instants.
        """
        return (
            self._clearance[:, None] - self._distances(samples.motion.q).values.T
        ) / CLEARANCE_UNIT

    def slopes(self, samples: KernelForces) -> Array:
        """Derivatives of the values with respect to q, then qd, then qdd, (k, 3 n, G)."""
        by_q = (
            -self._distances(samples.motion.q).slopes.transpose(1, 2, 0)
            / CLEARANCE_UNIT
        )
        return np.concatenate([by_q, np.zeros_like(by_q), np.zeros_like(by_q)], axis=1)

    def _distances(self, postures: Array) -> Distances:
        """Distances in G postures, (G, n), with derivatives; the last result is cached."""
        if not np.array_equal(self._last_postures, postures):
            self._last_postures = postures
            self._last_distances = self._meter.measure(postures, slopes=True)
        return self._last_distances
