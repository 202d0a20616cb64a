"""A tool's weight by readings of a force sensor at rest.

The sensor shows F = F0 - R' G and M = M0 - c x R' G, with R from the sensor's axes to the base's,
G the tool's weight along the base's axes, c its centre, and a zero F0, M0. All twelve unknowns are
found together by Gauss-Newton, whose first step finds the weight and whose second the centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from testbed.core.base.arrays import Array, freeze, skew
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.dynamics.newton_euler import sensor_pose
from testbed.core.robot.tree import Tree

UNKNOWNS = 12
"""Zero of force and moment, weight, centre: three each."""

ARM, ENOUGH = 0.04, 12
"""Noise of moments over that of forces, as of usual sensors [m]; rows beyond the unknowns with
which each is known by itself."""

SMALLEST = 1e-6
"""Singular values below this share of the largest are rounding, or poses that are all alike."""

NAMES = ("force zero", "mass and gravity", "moment zero", "centre")
"""Of the unknowns, three by three."""

OPEN = 1e-6
"""Part of an unknown that no combination of the readings holds, above which it is open."""

STEPS = 20
"""Of Gauss-Newton at most."""

LEVER = 0.1
"""Least lever by which residuals of moments count as forces [m]."""

BASES = {"base-axes": (1, 1, 1), "turned-base": (-1, -1, 1)}
"""By code: signs of a base's axes; UR's `base` is turned against the model's about the vertical."""


@dataclass(frozen=True, eq=False)
class StaticPoses:
    """Poses at rest: joint positions, and the wrench in each.

    Attributes:
        position: Of the joints, (P, n) [rad or m].
        wrench: (P, 6) [N, N m].
        diagnostics: What was repaired in reading.
    """

    position: Array
    wrench: Array
    diagnostics: tuple[Diagnostic, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, wrench=(None, 6), position=(len(self.wrench), None))


@dataclass(frozen=True, eq=False)
class RestFit:
    """Least-squares fit of a tool's weight and moments to poses at rest.

    Attributes:
        found: Zero of force, weight, zero of moment, centre, (12,).
        covariance: (12, 12).
        open_part: Part of each unknown that no combination of the readings holds, (12,).
        scale: Rms residual of forces [N] and of moments [N m], (2,).
    """

    found: Array
    covariance: Array
    open_part: Array
    scale: Array

    @property
    def open(self) -> tuple[str, ...]:
        """Unknowns that the poses do not identify, by name."""
        parts = zip(NAMES, self.open_part.reshape(4, 3), strict=True)
        return tuple(name for name, part in parts if part.max() > OPEN)

    @property
    def weight(self) -> Array:
        """Weight of the tool along the base's axes, (3,) [N]."""
        return self.found[3:6]

    @property
    def centre(self) -> Array:
        """Centre of mass along the sensor's axes, (3,) [m]."""
        return self.found[9:]

    @property
    def arm(self) -> float:
        """Distance of the centre of mass from the sensor's origin [m]."""
        return float(np.linalg.norm(self.centre))

    def mass(self, gravity: Array) -> float:
        """Mass of the tool under a gravity, (3,) [kg]."""
        return float(np.linalg.norm(self.weight) / np.linalg.norm(gravity))

    @property
    def share(self) -> float:
        """Rms residual, moments by the centre's lever, over the tool's weight."""
        lever = max(self.arm, LEVER)
        return float(
            max(self.scale[0], self.scale[1] / lever) / np.linalg.norm(self.weight)
        )

    def tilt(self, gravity: Array) -> tuple[float, float]:
        """Angle between weight and gravity, and its standard deviation [rad].

        Args:
            gravity: Of the model, (3,) [m/s^2].
        """
        length, doubt = np.linalg.norm(self.weight), self.covariance[3:6, 3:6]
        along, level = self.weight / length, gravity / np.linalg.norm(gravity)
        angle = np.arctan2(np.linalg.norm(np.cross(along, level)), along @ level)
        across = np.trace(doubt) - along @ doubt @ along
        return float(angle), float(np.sqrt(max(across, 0.0) / 2) / length)


def fit_tool(tree: Tree, poses: StaticPoses, code: str = "") -> RestFit:
    """Fit a tool's weight to a table of poses, as it is stated or with one of its usual faults.

    Args:
        tree: The robot from its base to the sensor.
        poses: The table.
        code: "degrees" for angles in degrees, a key of `BASES` for wrenches along those axes.
    """
    position = np.deg2rad(poses.position) if code == "degrees" else poses.position
    back = sensor_pose(tree, position).inverse.R_AB
    wrench = poses.wrench.reshape(-1, 2, 3)
    if code in BASES:
        wrench = np.einsum("pij,pkj->pki", back, wrench * BASES[code])
    return rest_fit(back, wrench.reshape(-1, 6))


def rest_fit(back: Array, wrench: Array) -> RestFit:
    """Gauss-Newton on all unknowns together.

    Args:
        back: From the base's axes to the sensor's, (P, 3, 3).
        wrench: The readings, (P, 6) [N, N m].
    """
    found, scale = np.zeros(UNKNOWNS), np.ones(2)
    for number in range(STEPS):
        rows, rest = _linearised(back, wrench, found)
        scale = _scale(rest) if number > 1 else scale
        weights = np.tile(np.repeat(scale, 3), len(back))
        left, sizes, right = np.linalg.svd(rows / weights[:, None], full_matrices=False)
        rank = int((sizes > SMALLEST * sizes[0]).sum())
        root = right[:rank].T / sizes[:rank]
        step = root @ (left[:, :rank].T @ (rest / weights))
        found = found + step
        if number > 1 and np.abs(step).max() < 1e-12 * np.abs(found).max():
            break
    freedom = max((len(rest) - rank) / 2, 1)  # of each scale: forces', moments'
    inflation = stats.t.ppf(0.975, freedom) / stats.norm.ppf(0.975)
    open_part = 1 - np.sum(right[:rank] ** 2, axis=0)
    return RestFit(found, inflation**2 * root @ root.T, open_part, scale)


def _linearised(back: Array, wrench: Array, found: Array) -> tuple[Array, Array]:
    """Derivatives of all readings by the unknowns, (6 P, 12), and their residuals, (6 P,)."""
    zero, weight, zero_moment, centre = found.reshape(4, 3)
    pull = back @ weight
    eye, none = np.broadcast_to(np.eye(3), back.shape), np.zeros_like(back)
    by_force = [eye, -back, none, none]
    by_moment = [none, -skew(centre) @ back, eye, skew(pull)]
    rows = np.block([by_force, by_moment]).reshape(6 * len(back), UNKNOWNS)
    shown = np.hstack([zero - pull, zero_moment - np.cross(centre, pull)])
    return rows, (wrench - shown).ravel()


def _scale(rest: Array) -> Array:
    """Noise of forces and of moments by their residuals, each with half the unknowns, (2,).

    Rows that lack to `ENOUGH` are those of both together, by `ARM`: else that of the two which
    happens to fit better takes all weight, and fits better still.
    """
    parts = rest.reshape(-1, 2, 3) / [[1.0], [ARM]]
    count = max(3 * len(parts) - UNKNOWNS // 2, 1)
    lacking, squares = max(ENOUGH - count, 0), (parts**2).sum(axis=(0, 2))
    squares = (squares + lacking * squares.mean() / count) / (count + lacking)
    sizes = np.sqrt(squares) * [1.0, ARM]
    return np.asarray(np.maximum(sizes, 1e-9 * max(sizes.max(), 1e-9)))
