"""A tool's weight by readings of a force sensor at rest.

The sensor shows F = F0 - R' G and M = M0 - c x R' G, with R from the sensor's axes to the ground's,
G the tool's weight on the ground, c its centre, and a zero F0, M0. All twelve unknowns are found
together by Gauss-Newton, whose first step finds the weight and whose second the centre; with them,
if that is asked for, a turn T of the sensor's axes: R T stands for R then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from testbed.core.base.arrays import Array, skew
from testbed.core.robot.inertia import from_vector

UNKNOWNS = 12
"""Zero of force and moment, weight, centre: three each."""

SMALLEST = 1e-6
"""Singular values below this share of the largest are rounding, or poses that are all alike."""

NAMES = ("force zero", "mass and gravity", "moment zero", "centre", "axes")
"""Of the unknowns, three by three."""

OPEN = 1e-6
"""Part of an unknown that no combination of the readings holds, above which it is open."""

STEPS = 20
"""Of Gauss-Newton at most."""

LEVER = 0.1
"""Least lever by which residuals of moments count as forces [m]."""


@dataclass(frozen=True, eq=False)
class RestFit:
    """What explains the readings at rest best.

    Attributes:
        found: Zero of force, weight, zero of moment, centre, (12,).
        turn: From the sensor's axes to those that were said, (3, 3).
        covariance: Of `found` and, where it is free, of the turn [rad], (12 or 15, 12 or 15).
        open_part: Part of each of them that no combination of the readings holds.
        scale: Rms of what is left of forces [N] and of moments [N m], (2,).
    """

    found: Array
    turn: Array
    covariance: Array
    open_part: Array
    scale: Array

    @property
    def open(self) -> tuple[str, ...]:
        """Unknowns that the poses do not identify, by name."""
        parts = zip(NAMES, self.open_part.reshape(-1, 3), strict=False)
        return tuple(name for name, part in parts if part.max() > OPEN)

    @property
    def weight(self) -> Array:
        """Weight of the tool along the base's axes, (3,) [N]."""
        return self.found[3:6]

    @property
    def share(self) -> float:
        """Rms residual, moments by the centre's lever, over the tool's weight."""
        lever = max(float(np.linalg.norm(self.found[9:])), LEVER)
        return float(max(self.scale[0], self.scale[1] / lever) / np.linalg.norm(self.weight))

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

    def errors(self, back: Array, wrench: Array) -> Array:
        """What it leaves of readings, (P, 6) [N, N m].

        Args:
            back: From the base's axes to those that were said, (P, 3, 3).
            wrench: The readings, (P, 6) [N, N m].
        """
        rest = _linearised(self.turn.T @ back, wrench, self.found, turns=False)[1]
        return rest.reshape(-1, 6)


def rest_fit(back: Array, wrench: Array, turn: Array | None = None) -> RestFit:
    """Gauss-Newton on all unknowns together.

    Args:
        back: From the base's axes to the sensor's as they were said, (P, 3, 3).
        wrench: The readings, (P, 6) [N, N m].
        turn: Where a search for the sensor's axes begins, (3, 3); None takes them as said.
    """
    turns = turn is not None
    turn = np.eye(3) if turn is None else turn
    found, scale = np.zeros(UNKNOWNS), np.ones(2)
    for number in range(STEPS):
        rows, rest = _linearised(turn.T @ back, wrench, found, turns=turns)
        scale = _scale(rest, rows.shape[1]) if number > 1 else scale
        weights = np.tile(np.repeat(scale, 3), len(back))
        left, sizes, right = _svd(rows / weights[:, None])
        step = right.T @ (left.T @ (rest / weights) / sizes)
        found = found + step[:UNKNOWNS]
        turn = turn @ from_vector(step[UNKNOWNS:]) if turns else turn
        if number > 1 and np.abs(step).max() < 1e-12 * np.abs(found).max():
            break
    freedom = len(rest) - len(sizes)
    widened = float(stats.t.ppf(0.975, max(freedom, 1)) / stats.norm.ppf(0.975))
    covariance = widened**2 * (right.T / sizes**2) @ right
    return RestFit(found, turn, covariance, 1 - np.sum(right**2, axis=0), scale)


def _linearised(back: Array, wrench: Array, found: Array, *, turns: bool) -> tuple[Array, Array]:
    """Derivatives of all that is shown by the unknowns, (6 P, 12 or 15), and what is left, (6 P,).

    The last three are by a turn of the sensor's axes.
    """
    zero, weight, zero_moment, centre = found.reshape(4, 3)
    pull = back @ weight
    eye, none = np.broadcast_to(np.eye(3), back.shape), np.zeros_like(back)
    arm, lever = skew(centre), skew(pull)
    by_force, by_moment = [eye, -back, none, none, -lever], [none, -arm @ back, eye, lever]
    rows = np.block([by_force, [*by_moment, -arm @ lever]]).reshape(6 * len(back), -1)
    shown = np.hstack([zero - pull, zero_moment - np.cross(centre, pull)])
    return rows[:, : UNKNOWNS + 3 * turns], (wrench - shown).ravel()


def _scale(rest: Array, unknowns: int) -> Array:
    """Noise of forces and of moments by what is left, each with half the unknowns, (2,)."""
    parts = rest.reshape(-1, 2, 3)
    count = max(3 * len(parts) - unknowns // 2, 1)
    sizes = np.sqrt((parts**2).sum(axis=(0, 2)) / count)
    return np.asarray(np.maximum(sizes, 1e-9 * max(sizes.max(), 1e-9)))


def _svd(rows: Array) -> tuple[Array, Array, Array]:
    """Of what is seen only: singular values, and vectors to either side."""
    left, sizes, right = np.linalg.svd(rows, full_matrices=False)
    rank = int((sizes > SMALLEST * sizes[0]).sum())
    return left[:, :rank], sizes[:rank], right[:rank]
