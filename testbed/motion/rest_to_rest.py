"""A periodic motion from rest to rest: it sets out slowly along its own path.

Time runs along the path at a rate that rises smoothly from zero to one, and falls again at the
end. The path is the proven one, so that positions and distances need no further proof, and
velocities are no larger; accelerations and forces are others, and are proven here.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import InfeasibleMotion
from testbed.core.base.summary_table import Value
from testbed.core.dynamics.newton_euler import Motion
from testbed.motion.fourier import Fourier
from testbed.motion.proof import Margin, Rules, force_margins, margins_of, spans_of

# from 0 to 1, flat at both ends
_RATE = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
# of it and its derivatives, in the unit interval
_STEEPEST = (
    1.0,
    1.875,
    5.7736,
    60.0,
    360.0,
)

SHORTEST, LONGEST = 0.5, 64.0
"""Times that a start may take [s]."""


@dataclass(frozen=True, eq=False)
class Start:
    """The way from rest into a periodic motion, which it joins at the motion's t = 0.

    Attributes:
        motion: The periodic motion.
        duration: Of the start [s].
    """

    motion: Fourier
    duration: float

    def at(self, t: Array) -> Motion:
        """The motion at times t, (M,) [s], counted from rest."""
        return Motion(t, *(self.derivative(t, order) for order in range(3)))

    def derivative(self, t: Array, order: int) -> Array:
        """A derivative of the positions, of order 0 to 4, at times t, (M, n)."""
        rates = [self._rate(t, k)[:, None] for k in range(order)]
        place = self.place(t)
        parts = [self.motion.derivative(place, k) for k in range(order + 1)]
        return _chain(parts, rates, order)

    @property
    def fifth_derivative(self) -> Array:
        """A bound of the magnitude of the fifth derivative, (n,)."""
        rates = [
            np.array(steep / self.duration**k) for k, steep in enumerate(_STEEPEST)
        ]
        return _chain([self.motion.bound(order) for order in range(6)], rates, 5)

    @property
    def backwards(self) -> Start:
        """Into the motion run backwards: run backwards itself, it leads out of the motion."""
        motion = self.motion
        back = Fourier(motion.fundamental, motion.offset, -motion.sine, motion.cosine)
        return Start(back, self.duration)

    def place(self, t: Array) -> Array:
        """Where on the path at times t, as a time of the motion, not after 0 [s]."""
        return self.duration * (_RATE.integ()(t / self.duration) - 0.5)

    def _rate(self, t: Array, order: int) -> Array:
        """The rate at which the path is run, or a derivative of it [1/s^order]."""
        return _RATE.deriv(order)(t / self.duration) / self.duration**order


@dataclass(frozen=True, eq=False)
class RestToRest(Value):
    """Whole periods of a motion between two rests; t = 0 is where the periodic part begins.

    Attributes:
        start: The way into the motion; the way out is its mirror image.
        periods: Of the motion between.
    """

    start: Start
    periods: int

    @property
    def period(self) -> float:
        """Of the motion [s]."""
        return self.start.motion.period

    @property
    def lead(self) -> float:
        """Duration of the start, and of the end [s]."""
        return self.start.duration

    @property
    def end(self) -> float:
        """Of the periodic part [s]."""
        return self.periods * self.period

    def at(self, t: Array) -> Motion:
        """The motion at times t, (M,) [s]; at rest before and after all of it."""
        into, out = self._sides(t)
        before, after = t < 0, t > self.end
        parts = [self.start.motion.derivative(t, order) for order in range(3)]
        back = self.start.backwards
        for order, part in enumerate(parts):
            part[before] = self.start.derivative(into[before], order)
            part[after] = (-1) ** order * back.derivative(out[after], order)
        return Motion(t, *parts)

    def place(self, t: Array) -> Array:
        """Where on the motion's path, (M,), as a time of the motion [s]."""
        into, out = self._sides(t)
        beyond = np.where(t > self.end, self.end - self.start.place(out), t)
        return np.where(t < 0, self.start.place(into), beyond)

    def _sides(self, t: Array) -> tuple[Array, Array]:
        """Times of the start and of its mirror image, (M,) each [s]."""
        lead = self.lead
        return np.clip(t + lead, 0, lead), np.clip(self.end + lead - t, 0, lead)


def rest_to_rest(motion: Fourier, rules: Rules, duration: float) -> RestToRest:
    """A proven motion with a proven start and end, as many periods as come nearest to a time.

    Args:
        motion: A proven periodic motion.
        rules: What it respects.
        duration: Wished for the periodic part [s].

    Raises:
        InfeasibleMotion: The robot cannot rest where the motion begins.
    """
    start, _ = start_of(motion, rules)
    return RestToRest(start, max(1, round(duration / motion.period)))


def start_of(motion: Fourier, rules: Rules) -> tuple[Start, list[Margin]]:
    """The shortest start, by doubling, that is proven, and what it leaves of the limits.

    Its mirror image in time leads to rest: it needs the same accelerations and, but for viscous
    friction and the sign of velocities, the same forces; it is proven beside it.

    Args:
        motion: A proven periodic motion.
        rules: What it respects.

    Raises:
        InfeasibleMotion: None is proven: the robot cannot rest where the motion begins.
    """
    duration = SHORTEST
    while True:
        start = Start(motion, duration)
        margins = [
            margin
            for way in (start, start.backwards)
            for margin in (*_accelerations(way, rules), *force_margins(way, rules)[0])
        ]
        if all(margin.holds for margin in margins):
            return start, margins
        duration *= 2
        if duration > LONGEST:
            worst = min(margins, key=lambda margin: margin.left)
            raise InfeasibleMotion(
                f"the motion cannot begin from rest: {worst.words} of the start"
            )


def _accelerations(start: Start, rules: Rules) -> list[Margin]:
    count = spans_of(start.duration)
    times = np.arange(count + 1) * start.duration / count
    step = start.duration / count
    fourth = (
        np.abs(start.derivative(times, 4)).max(axis=0)
        + step / 2 * start.fifth_derivative
    )
    between = step**2 / 8 * fourth  # more than at the samples
    share = (np.abs(start.derivative(times, 2)) + between) / rules.limits.acceleration
    labels = [f"acceleration of '{name}'" for name in rules.tree.names]
    return margins_of(labels, rules.margin - share.T, times)


def _chain(parts: list[Array], rates: list[Array], order: int) -> Array:
    """Derivative of F(place) in time, by the chain rule.

    Args:
        parts: Derivatives of F at the place, of order 0 to `order`, (M, n) each.
        rates: Derivatives of place, of order 1 to `order`, (M, 1) each.
        order: Of the derivative.
    """
    each = [part * _bell(rates, order, k) for k, part in enumerate(parts)]
    return np.asarray(np.sum(each, axis=0))


def _bell(rates: list[Array], order: int, parts: int) -> Array | float:
    """Partial Bell polynomial of derivatives of an inner function."""
    if not parts:
        return float(not order)
    return sum(
        comb(order - 1, k) * rates[k] * _bell(rates, order - 1 - k, parts - 1)
        for k in range(order - parts + 1)
    )
