"""Coefficients of a Fourier series as the unknowns of a search, in units of the limits.

Positions about the middle of their range, velocities and accelerations are trigonometric
polynomials: what they reach between G samples of a period is at most what they reach there over
cos(pi harmonics / G). Limits on them are proven by tightening them by that much.

Source    that bound: [EZ64]
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.excitation.fourier import Fourier, terms
from testbed.excitation.limits import Limits


@dataclass(frozen=True, eq=False)
class Series:
    """How unknowns make a motion: one block of 2 harmonics + 1 unknowns a joint.

    Attributes:
        limits: Of the robot.
        fundamental: Frequency at which the motion repeats [Hz].
        harmonics: Number of harmonics.
        instants: Samples G of a period, more than twice the harmonics.
        margin: Share of the limits that may be used.
    """

    limits: Limits
    fundamental: float
    harmonics: int
    instants: int
    margin: float

    @cached_property
    def times(self) -> Array:
        """The instants, (G,) [s]."""
        return np.arange(self.instants) / (self.instants * self.fundamental)

    @property
    def joints(self) -> int:
        """Number n of joints."""
        return len(self.limits.low)

    @property
    def width(self) -> int:
        """Unknowns p of a joint."""
        return 2 * self.harmonics + 1

    @cached_property
    def units(self) -> Array:
        """What an unknown of one is as a coefficient, (n, p) [rad or m]."""
        pulses = 2 * np.pi * self.fundamental * np.arange(1, self.harmonics + 1)
        swing = np.tile(self.limits.velocity[:, None] / pulses, 2)
        return np.hstack([self.limits.half[:, None], np.minimum(swing, self.limits.half[:, None])])

    @cached_property
    def motion_of(self) -> Array:
        """What q, qd and qdd have of each unknown, (n, 3, G, p)."""
        basis = [terms(self.fundamental, self.harmonics, self.times, order) for order in range(3)]
        return np.stack(basis)[None] * self.units[:, None, None, :]

    @cached_property
    def linear(self) -> Array:
        """Shares of position, velocity and acceleration limits, (n, 3 G, p), the middle aside."""
        limit = np.stack([self.limits.half, self.limits.velocity, self.limits.acceleration], axis=1)
        return (self.motion_of / limit[:, :, None, None]).reshape(self.joints, -1, self.width)

    @cached_property
    def linear_offset(self) -> Array:
        """What the middle of the ranges takes off them, (n, 3 G)."""
        found = np.zeros((self.joints, 3, self.instants))
        found[:, 0] = (self.limits.middle / self.limits.half)[:, None]
        return found.reshape(self.joints, -1)

    @property
    def linear_most(self) -> float:
        """Largest share at the instants for which `margin` holds between them, too."""
        return float(self.margin * np.cos(np.pi * self.harmonics / self.instants))

    def motion(self, x: Array) -> Fourier:
        """The motion of unknowns, (n p,)."""
        coefficients = self.units * x.reshape(self.joints, self.width)
        return Fourier.of(self.fundamental, coefficients)

    def unknowns(self, motion: Fourier) -> Array:
        """The unknowns of a motion of these frequencies, (n p,)."""
        return np.asarray((motion.coefficients / self.units).ravel())

    def at(self, x: Array) -> Array:
        """q, qd and qdd at the instants, (3, G, n)."""
        each = x.reshape(self.joints, self.width)
        return np.asarray(np.einsum("jdgp,jp->dgj", self.motion_of, each))

    def linear_values(self, x: Array) -> Array:
        """Shares of the linear limits less what is allowed, (n, 2, 3 G): above, below."""
        each = x.reshape(self.joints, self.width)
        share = np.einsum("jrp,jp->jr", self.linear, each) - self.linear_offset
        return np.stack([share, -share], axis=1) - self.linear_most

    def pulled(self, slopes: Array) -> Array:
        """Derivatives by the unknowns, (..., n p), of derivatives by motion, (..., 3 n, G).

        Summed over the instants.
        """
        lead = slopes.shape[:-2]
        by_joint = slopes.reshape(*lead, 3, self.joints, self.instants)
        found = np.einsum("...djg,jdgp->...jp", by_joint, self.motion_of)
        return np.asarray(found.reshape(*lead, -1))

    def each(self, slopes: Array, instants: NDArray[np.int64]) -> Array:
        """The same instant by instant: of (r, 3 n) at the instants (r,), (r, n p).

        Args:
            slopes: Derivatives by motion, (r, 3 n).
            instants: Number of the instant of each, (r,).
        """
        by_joint = slopes.reshape(len(slopes), 3, self.joints)
        found = np.zeros((len(slopes), self.joints, self.width))
        for order in range(3):
            there = self.motion_of[:, order, instants].transpose(1, 0, 2)  # (r, n, p)
            found += by_joint[:, order, :, None] * there
        return found.reshape(len(slopes), -1)
