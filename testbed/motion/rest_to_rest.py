"""Periodic motion between two states of rest, from time scaling along the path.

The rate of the path parameter rises smoothly from zero to one, and falls again at the end.
Positions and distances are those of the periodic path, which is proven, and velocities do not
exceed those of the periodic path. Accelerations and forces differ, and are proven here.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import NoFeasibleMotion
from testbed.core.base.summary_table import Value
from testbed.core.dynamics.newton_euler import Motion
from testbed.motion.fourier import Fourier
from testbed.motion.proof import (
    Margin,
    MotionConstraints,
    force_margins,
    force_sample_count,
    smallest_margins,
)

# from 0 to 1 with zero first and second derivative at both ends
_RATE_POLYNOMIAL = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
# upper bounds of the polynomial and its derivatives in the unit interval
_RATE_BOUNDS = (
    1.0,
    1.875,
    5.7736,
    60.0,
    360.0,
)

MIN_START_SECONDS, MAX_START_SECONDS = 0.5, 64.0
"""Smallest and largest duration of a start [s]."""


@dataclass(frozen=True, eq=False)
class Start:
    """Start from rest into a periodic motion, which begins at the motion's t = 0.

    Attributes:
        motion: The periodic motion.
        duration: Duration of the start [s].
    """

    motion: Fourier
    duration: float

    def at(self, t: Array) -> Motion:
        """Positions, velocities and accelerations at times t since rest, (M,) [s]."""
        return Motion(t, *(self.derivative(t, order) for order in range(3)))

    def derivative(self, t: Array, order: int) -> Array:
        """Derivatives of order 0 to 4 of the positions at times t since rest, (M, n)."""
        rates = [self._rate(t, k)[:, None] for k in range(order)]
        path_time = self.path_time(t)
        path_derivatives = [
            self.motion.derivative(path_time, k) for k in range(order + 1)
        ]
        return _chain_rule(path_derivatives, rates, order)

    @property
    def fifth_derivative(self) -> Array:
        """Upper bounds of the absolute fifth time derivatives of the positions, (n,)."""
        rates = [
            np.array(bound / self.duration**k) for k, bound in enumerate(_RATE_BOUNDS)
        ]
        return _chain_rule([self.motion.bound(order) for order in range(6)], rates, 5)

    @property
    def backwards(self) -> Start:
        """Start into the time-reversed motion, which is the end of the motion in reversed time."""
        motion = self.motion
        reversed_motion = Fourier(
            motion.fundamental, motion.offset, -motion.sine, motion.cosine
        )
        return Start(reversed_motion, self.duration)

    def path_time(self, t: Array) -> Array:
        """Path parameter at times t since rest, (M,) [s].

        The path parameter is the time at which the periodic motion has the same posture; it is at
        most 0.
        """
        return self.duration * (_RATE_POLYNOMIAL.integ()(t / self.duration) - 0.5)

    def _rate(self, t: Array, order: int) -> Array:
        """Rate of the path parameter at times t, or a derivative of the rate [1/s^order]."""
        return _RATE_POLYNOMIAL.deriv(order)(t / self.duration) / self.duration**order


@dataclass(frozen=True, eq=False)
class RestToRest(Value):
    """Whole periods of a motion between two states of rest.

    The periodic part begins at t = 0.

    Attributes:
        start: Start into the motion; its mirror image in time is the end.
        periods: Number of periods between start and end.
    """

    start: Start
    periods: int

    @property
    def period(self) -> float:
        """Period of the motion [s]."""
        return self.start.motion.period

    @property
    def lead(self) -> float:
        """Duration of the start, and of the end [s]."""
        return self.start.duration

    @property
    def end(self) -> float:
        """Time at which the periodic part ends [s]."""
        return self.periods * self.period

    def at(self, t: Array) -> Motion:
        """Motion at times t, (M,) [s]; at rest before the start and after the end."""
        start_times, end_times = self._start_and_end_times(t)
        is_start, is_end = t < 0, t > self.end
        derivatives = [self.start.motion.derivative(t, order) for order in range(3)]
        reversed_start = self.start.backwards
        for order, values in enumerate(derivatives):
            values[is_start] = self.start.derivative(start_times[is_start], order)
            values[is_end] = (-1) ** order * reversed_start.derivative(
                end_times[is_end], order
            )
        return Motion(t, *derivatives)

    def path_time(self, t: Array) -> Array:
        """Path parameter at times t, as a time of the motion, (M,) [s]."""
        start_times, end_times = self._start_and_end_times(t)
        path_times = np.where(
            t > self.end, self.end - self.start.path_time(end_times), t
        )
        return np.where(t < 0, self.start.path_time(start_times), path_times)

    def _start_and_end_times(self, t: Array) -> tuple[Array, Array]:
        """Times since rest in the start, and until rest in the end, (M,) each [s].

        Both times are clipped to the range 0 ... `lead`.
        """
        lead = self.lead
        return np.clip(t + lead, 0, lead), np.clip(self.end + lead - t, 0, lead)


def rest_to_rest(
    motion: Fourier, rules: MotionConstraints, duration: float
) -> RestToRest:
    """Extend whole periods of a proven motion by a proven start and a proven end.

    Args:
        motion: Proven periodic motion.
        rules: Limits of the motion.
        duration: Requested duration of the periodic part, rounded to one whole period or more [s].

    Raises:
        NoFeasibleMotion: The robot cannot rest where the motion begins.
    """
    start, _ = shortest_start(motion, rules)
    return RestToRest(start, max(1, round(duration / motion.period)))


def shortest_start(
    motion: Fourier, rules: MotionConstraints
) -> tuple[Start, list[Margin]]:
    """Shortest proven start into a motion, with all margins.

    The duration is doubled from MIN_START_SECONDS until the start is proven.

    The mirror image of the start in time leads to rest: it has the same accelerations and, except
    for friction and the sign of velocities, the same forces. Both the start and its mirror image
    are proven.

    Args:
        motion: Proven periodic motion.
        rules: Limits of the motion.

    Raises:
        NoFeasibleMotion: No start up to MAX_START_SECONDS is proven: the robot cannot rest where
            the motion begins.
    """
    duration = MIN_START_SECONDS
    while True:
        start = Start(motion, duration)
        margins = [
            margin
            for direction in (start, start.backwards)
            for margin in (
                *_acceleration_margins(direction, rules),
                *force_margins(direction, rules)[0],
            )
        ]
        if all(margin.is_respected for margin in margins):
            return start, margins
        duration *= 2
        if duration > MAX_START_SECONDS:
            worst = min(margins, key=lambda margin: margin.left)
            raise NoFeasibleMotion(
                f"the motion cannot begin from rest: {worst.words} of the start"
            )


def _acceleration_margins(start: Start, rules: MotionConstraints) -> list[Margin]:
    """Margins of the joint accelerations of a start, also valid between samples."""
    count = force_sample_count(start.duration)
    times = np.arange(count + 1) * start.duration / count
    step = start.duration / count
    fourth = (
        np.abs(start.derivative(times, 4)).max(axis=0)
        + step / 2 * start.fifth_derivative
    )
    interpolation_error = step**2 / 8 * fourth  # excess between samples
    share = (
        np.abs(start.derivative(times, 2)) + interpolation_error
    ) / rules.limits.acceleration
    labels = [f"acceleration of '{name}'" for name in rules.tree.names]
    return smallest_margins(labels, rules.margin - share.T, times)


def _chain_rule(parts: list[Array], rates: list[Array], order: int) -> Array:
    """Time derivative of F(s(t)) by the chain rule of higher order (Faa di Bruno).

    Args:
        parts: Derivatives of F with respect to s, of order 0 to `order`, (M, n) each.
        rates: Time derivatives of s, of order 1 to `order`, (M, 1) each.
        order: Order of the derivative.
    """
    summands = [
        part * _bell_polynomial(rates, order, k) for k, part in enumerate(parts)
    ]
    return np.asarray(np.sum(summands, axis=0))


def _bell_polynomial(rates: list[Array], order: int, parts: int) -> Array | float:
    """Partial Bell polynomial of the derivatives of an inner function.

    Args:
        rates: Derivatives of the inner function, of order 1 and above.
        order: Order of the derivative.
        parts: Number of factors in each product.
    """
    if not parts:
        return float(not order)
    return sum(
        comb(order - 1, k)
        * rates[k]
        * _bell_polynomial(rates, order - 1 - k, parts - 1)
        for k in range(order - parts + 1)
    )
