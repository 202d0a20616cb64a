"""Limits as functions that must stay below zero, with their derivatives.

Each is a share of its limit: -0.3 leaves 30 % of the limit. Positions, velocities and
accelerations are linear in the coefficients and stand apart (`series.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from testbed.arrays import Array, readonly
from testbed.errors import InfeasibleMotion
from testbed.excitation.jets import ForceBounds
from testbed.excitation.limits import Limits
from testbed.excitation.samples import Instants, Samples
from testbed.robot.friction import COULOMB, ROTOR, VISCOUS
from testbed.robot.tree import Tree


class LimitTerm(Protocol):
    """Some limits at every instant."""

    @property
    def labels(self) -> tuple[str, ...]:
        """What each is a limit of, (k,)."""

    def values(self, samples: Instants) -> Array:
        """Shares less what is allowed, (k, G); below zero inside."""

    def slopes(self, samples: Samples) -> Array:
        """Their derivatives by q, then qd, then qdd, (k, 3 n, G)."""


class SmoothTerm(LimitTerm, Protocol):
    """Limits whose second derivative by time has a bound: they can be proven between samples."""

    def curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of the second derivatives of `values` by time, (k, W) [1/s^2]."""


@dataclass(frozen=True, eq=False)
class PlateRange:
    """What the plate can measure, and on what it stands.

    Attributes:
        wrench: Largest magnitude of each channel, pedestal included, (6,) [N, N m]; infinite
            for no limit.
        half: Half lengths along x and y of the area in which the centre of pressure stays, (2,)
            [m]; None for a plate that is bolted down.
    """

    wrench: Array
    half: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "wrench", readonly(self.wrench, (6,), "wrench"))
        if self.half is not None:
            object.__setattr__(self, "half", readonly(self.half, (2,), "half"))
        if not (self.wrench > 0).all() or (self.half is not None and not (self.half > 0).all()):
            raise InfeasibleMotion("the plate's ranges and half lengths must be positive")

    def rows(self, margin: float) -> tuple[tuple[str, ...], Array, Array]:
        """Labels, combinations of the wrench as shares of limits, (k, 6), and their bounds, (k,).

        Args:
            margin: Share of each range that may be used.
        """
        labels, rows, most = [], [], []
        for c in np.flatnonzero(np.isfinite(self.wrench)):
            labels += 2 * [f"plate {CHANNELS[c]}"]
            rows += [sign * np.eye(6)[c] / self.wrench[c] for sign in (1.0, -1.0)]
            most += [margin, margin]
        for axis, half in enumerate(() if self.half is None else self.half):
            labels += 2 * [f"centre of pressure along {'xy'[axis]}"]
            for sign in (1.0, -1.0):  # |My| <= x Fz, |Mx| <= y Fz
                row = sign * np.eye(6)[4 - axis]
                row[2] = -margin * half
                rows.append(row / (PRESSURE * half))
                most.append(0.0)
        return tuple(labels), np.array(rows).reshape(-1, 6), np.array(most)


CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
PRESSURE = 100.0
"""Force at which a centre of pressure at the edge counts as a share of one [N]."""


class PlateTerm:
    """The plate's ranges, and the centre of pressure on it."""

    def __init__(self, plate: PlateRange, pedestal: Array, margin: float) -> None:
        """Ready to be asked.

        Args:
            plate: The ranges.
            pedestal: Wrench on what stands on the plate without moving, (6,) [N, N m].
            margin: Share of each range that may be used.
        """
        self._labels, self._rows, most = plate.rows(margin)
        self._most = most - self._rows @ pedestal

    @property
    def labels(self) -> tuple[str, ...]:
        """What each is a limit of."""
        return self._labels

    def values(self, samples: Instants) -> Array:
        """Shares less what is allowed, (k, G)."""
        return np.asarray(self._rows @ samples.forces("reaction") - self._most[:, None])

    def slopes(self, samples: Samples) -> Array:
        """Derivatives, (k, 3 n, G)."""
        return np.tensordot(self._rows, samples.force_slopes("reaction"), 1)

    def curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of second derivatives by time, (k, W)."""
        force, moment = (np.linalg.norm(part, axis=1) for part in np.hsplit(self._rows, 2))
        return np.outer(force, bounds.force) + np.outer(moment, bounds.moment)


class EffortTerm:
    """Motor efforts, with friction of either sign: a joint that rests may stick either way."""

    def __init__(self, tree: Tree, limits: Limits, margin: float) -> None:
        """Ready to be asked.

        Args:
            tree: The robot, its inertias and friction an a-priori model.
            limits: Of the motors.
            margin: Share of each that may be used.

        Raises:
            InfeasibleMotion: A motor cannot overcome its joint's dry friction.
        """
        self._joints = np.flatnonzero(np.isfinite(limits.effort))
        self._names = tuple(tree.names[j] for j in self._joints)
        self._effort = limits.effort[self._joints]
        self._viscous, self._rotor = VISCOUS.coefficients(tree), ROTOR.coefficients(tree)
        self._most = margin - COULOMB.coefficients(tree)[self._joints] / self._effort
        for name, left in zip(self._names, self._most, strict=True):
            if left <= 0:
                raise InfeasibleMotion(
                    f"the motor of joint '{name}' is too weak for its dry friction: nothing of its "
                    "effort limit is left for a motion; correct max_effort or coulomb"
                )

    @property
    def labels(self) -> tuple[str, ...]:
        """What each is a limit of."""
        return tuple(f"effort of '{name}'" for name in self._names for _ in range(2))

    def values(self, samples: Instants) -> Array:
        """Shares less what is allowed, (2 k, G)."""
        torque = samples.forces("dynamic") + _along(self._viscous, samples.qd)
        torque += _along(self._rotor, samples.qdd)
        share = torque[self._joints] / self._effort[:, None]
        both = np.stack([share, -share], axis=1) - self._most[:, None, None]
        return np.asarray(both.reshape(-1, share.shape[1]))

    def slopes(self, samples: Samples) -> Array:
        """Derivatives, (2 k, 3 n, G)."""
        n = samples.q.shape[1]
        slopes = samples.force_slopes("dynamic").copy()
        own = np.arange(n)
        slopes[own, n + own] += self._viscous[:, None]
        slopes[own, 2 * n + own] += self._rotor[:, None]
        share = slopes[self._joints] / self._effort[:, None, None]
        return np.asarray(np.stack([share, -share], axis=1).reshape(-1, *share.shape[1:]))

    def curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of second derivatives by time, (2 k, W)."""
        lost = self._viscous[:, None] * bounds.motion[3] + self._rotor[:, None] * bounds.motion[4]
        share = (bounds.joints + lost)[self._joints] / self._effort[:, None]
        return np.repeat(share, 2, axis=0)


def _along(coefficients: Array, motion: Array) -> Array:
    """Coefficients times what joints do, (n, G)."""
    return np.asarray(coefficients[:, None] * motion.T)
