"""Weight of a tool from force-sensor readings in static poses, by nonlinear least squares.

The sensor reads F = F0 - R' G and M = M0 - c x R' G, with R the rotation from sensor axes to base
axes, G the weight along base axes, c the centre of mass, and zero offsets F0, M0. All twelve
unknowns are estimated together by Gauss-Newton: its first step yields the weight, its second the
centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from testbed.core.base.arrays import Array, freeze_arrays, skew
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.dynamics.newton_euler import sensor_poses
from testbed.core.robot.tree import Tree

UNKNOWNS = 12
"""Number of unknowns: zero of force and moment, weight, centre, three each."""

MOMENT_NOISE_RATIO, MIN_REDUNDANT_ROWS = 0.04, 12
"""Typical ratio of moment noise to force noise [m]; number of rows beyond the unknowns from which
the noise of forces and of moments is estimated separately."""

SINGULAR_VALUE_TOLERANCE = 1e-6
"""Singular values below this share of the largest count as zero."""

UNKNOWN_NAMES = ("force zero", "mass and gravity", "moment zero", "centre")
"""Names of the unknowns, three components each."""

MAX_UNIDENTIFIED_SHARE = 1e-6
"""Largest share of an identifiable unknown that lies in the null space of the readings."""

MAX_ITERATIONS = 20
"""Largest number of Gauss-Newton steps."""

MIN_LEVER = 0.1
"""Smallest lever by which residuals of moments are converted to forces [m]."""

BASE_AXIS_SIGNS = {"base-axes": (1, 1, 1), "turned-base": (-1, -1, 1)}
"""Signs of the base axes by diagnostic code; UR's `base` is turned by 180 degrees about z."""


@dataclass(frozen=True, eq=False)
class StaticPoses:
    """Static poses: joint positions and force-sensor readings.

    Attributes:
        position: Joint positions in P poses, (P, n) [rad or m].
        wrench: Readings of the force sensor, (P, 6) [N, N m].
        diagnostics: Diagnostics of repairs made while reading the file.
    """

    position: Array
    wrench: Array
    diagnostics: tuple[Diagnostic, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self, wrench=(None, 6), position=(len(self.wrench), None))


@dataclass(frozen=True, eq=False)
class StaticFit:
    """Least-squares fit of a tool's weight and centre of mass to static poses.

    Attributes:
        unknowns: Zero offset of force, weight along base axes, zero offset of moment, centre of
            mass along sensor axes, three components each, (12,) [N, N, N m, m].
        covariance: Covariance of the unknowns, (12, 12).
        null_space_share: Fraction of each unknown in the null space of the readings' Jacobian,
            (12,): 0 if identifiable, 1 if without influence on the readings.
        rms_residual: Rms residual of forces [N] and of moments [N m], (2,), corrected for the
            degrees of freedom of the unknowns; pooled for few poses.
    """

    unknowns: Array
    covariance: Array
    null_space_share: Array
    rms_residual: Array

    @property
    def unidentifiable(self) -> tuple[str, ...]:
        """Names of the unknowns that the poses do not identify (`UNKNOWN_NAMES`).

        These are unknowns with a component whose `null_space_share` exceeds
        `MAX_UNIDENTIFIED_SHARE`.
        """
        shares = zip(UNKNOWN_NAMES, self.null_space_share.reshape(4, 3), strict=True)
        return tuple(
            name for name, share in shares if share.max() > MAX_UNIDENTIFIED_SHARE
        )

    @property
    def weight(self) -> Array:
        """Weight of the tool along the base axes, (3,) [N]."""
        return self.unknowns[3:6]

    @property
    def centre(self) -> Array:
        """Centre of mass along the sensor axes, (3,) [m]."""
        return self.unknowns[9:]

    @property
    def arm(self) -> float:
        """Distance of the centre of mass from the sensor's origin [m]."""
        return float(np.linalg.norm(self.centre))

    def mass(self, gravity: Array) -> float:
        """Mass of the tool, its weight divided by the magnitude of gravity [kg].

        Args:
            gravity: Gravity, (3,) [m/s^2].
        """
        return float(np.linalg.norm(self.weight) / np.linalg.norm(gravity))

    @property
    def relative_residual(self) -> float:
        """Ratio of rms residual to the tool's weight, the larger of forces and moments.

        Moments are first divided by the distance of the centre of mass from the sensor, which is
        taken as at least `MIN_LEVER`.
        """
        lever = max(self.arm, MIN_LEVER)
        return float(
            max(self.rms_residual[0], self.rms_residual[1] / lever)
            / np.linalg.norm(self.weight)
        )

    def tilt(self, gravity: Array) -> tuple[float, float]:
        """Angle between estimated weight and the model's gravity, with standard deviation [rad].

        Args:
            gravity: Gravity of the model, (3,) [m/s^2].
        """
        length, covariance = np.linalg.norm(self.weight), self.covariance[3:6, 3:6]
        weight_direction, gravity_direction = (
            self.weight / length,
            gravity / np.linalg.norm(gravity),
        )
        angle = np.arctan2(
            np.linalg.norm(np.cross(weight_direction, gravity_direction)),
            weight_direction @ gravity_direction,
        )
        transverse_variance = (
            np.trace(covariance) - weight_direction @ covariance @ weight_direction
        )
        return float(angle), float(np.sqrt(max(transverse_variance, 0.0) / 2) / length)


def fit_tool(tree: Tree, poses: StaticPoses, error_code: str = "") -> StaticFit:
    """Fit a tool's weight to static poses, after correction of an assumed data error.

    Args:
        tree: The robot from its base to the sensor.
        poses: Joint positions and readings.
        error_code: Assumed error: "degrees" for joint angles in degrees instead of radians, a key
            of `BASE_AXIS_SIGNS` for wrenches along base axes instead of sensor axes, or "" for
            none.
    """
    position = np.deg2rad(poses.position) if error_code == "degrees" else poses.position
    rotations = sensor_poses(tree, position).inverse.R_AB
    wrench = poses.wrench.reshape(-1, 2, 3)
    if error_code in BASE_AXIS_SIGNS:
        wrench = np.einsum(
            "pij,pkj->pki", rotations, wrench * BASE_AXIS_SIGNS[error_code]
        )
    return fit_static_poses(rotations, wrench.reshape(-1, 6))


def fit_static_poses(rotations: Array, wrench: Array) -> StaticFit:
    """Fit zero offsets, weight and centre of mass by iteratively reweighted Gauss-Newton.

    Forces and moments are weighted by their residuals in the previous iteration. Steps have minimum
    norm where the poses do not identify the unknowns. For few readings, the covariance is inflated
    according to Student's t distribution.

    Args:
        rotations: Rotations from base axes to sensor axes in P poses, (P, 3, 3).
        wrench: Readings of the force sensor, (P, 6) [N, N m].
    """
    unknowns, scale = np.zeros(UNKNOWNS), np.ones(2)
    for iteration in range(MAX_ITERATIONS):
        rows, residuals = _linearised(rotations, wrench, unknowns)
        scale = _noise_scales(residuals) if iteration > 1 else scale
        weights = np.tile(np.repeat(scale, 3), len(rotations))
        left_vectors, singular_values, right_vectors = np.linalg.svd(
            rows / weights[:, None], full_matrices=False
        )
        rank = int(
            (singular_values > SINGULAR_VALUE_TOLERANCE * singular_values[0]).sum()
        )
        root = right_vectors[:rank].T / singular_values[:rank]
        step = root @ (left_vectors[:, :rank].T @ (residuals / weights))
        unknowns = unknowns + step
        if iteration > 1 and np.abs(step).max() < 1e-12 * np.abs(unknowns).max():
            break
    degrees_of_freedom = max(
        (len(residuals) - rank) / 2, 1
    )  # half of them for forces, half for moments
    inflation = stats.t.ppf(0.975, degrees_of_freedom) / stats.norm.ppf(0.975)
    open_part = 1 - np.sum(right_vectors[:rank] ** 2, axis=0)
    return StaticFit(unknowns, inflation**2 * root @ root.T, open_part, scale)


def _linearised(
    rotations: Array, wrench: Array, unknowns: Array
) -> tuple[Array, Array]:
    """Jacobian of the readings with respect to the unknowns, (6 P, 12), and residuals, (6 P,).

    Args:
        rotations: Rotations from base axes to sensor axes in P poses, (P, 3, 3).
        wrench: Readings, (P, 6) [N, N m].
        unknowns: Point of linearisation, (12,).
    """
    zero, weight, zero_moment, centre = unknowns.reshape(4, 3)
    sensor_weight = rotations @ weight
    identity, zeros = (
        np.broadcast_to(np.eye(3), rotations.shape),
        np.zeros_like(rotations),
    )
    force_rows = [identity, -rotations, zeros, zeros]
    moment_rows = [zeros, -skew(centre) @ rotations, identity, skew(sensor_weight)]
    rows = np.block([force_rows, moment_rows]).reshape(6 * len(rotations), UNKNOWNS)
    prediction = np.hstack(
        [zero - sensor_weight, zero_moment - np.cross(centre, sensor_weight)]
    )
    return rows, (wrench - prediction).ravel()


def _noise_scales(residuals: Array) -> Array:
    """Noise standard deviations of forces and moments, from the residuals, (2,).

    Half of the unknowns are attributed to forces, half to moments. With fewer than
    `MIN_REDUNDANT_ROWS` rows beyond these, both variances are shrunk towards their mean, after
    division of the moments by `MOMENT_NOISE_RATIO`. Otherwise the signal that happens to fit better
    would receive more weight in every iteration.

    Args:
        residuals: Residuals of all readings in P poses, (6 P,).
    """
    scaled = residuals.reshape(-1, 2, 3) / [[1.0], [MOMENT_NOISE_RATIO]]
    count = max(3 * len(scaled) - UNKNOWNS // 2, 1)
    missing_rows, squares = (
        max(MIN_REDUNDANT_ROWS - count, 0),
        (scaled**2).sum(axis=(0, 2)),
    )
    squares = (squares + missing_rows * squares.mean() / count) / (count + missing_rows)
    noise = np.sqrt(squares) * [1.0, MOMENT_NOISE_RATIO]
    return np.asarray(np.maximum(noise, 1e-9 * max(noise.max(), 1e-9)))
