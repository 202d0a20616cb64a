"""Proof that a periodic motion respects its limits at every instant; margins over time.

Between samples, values are bounded by means of their derivatives, and distances by conservative
advancement.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Protocol

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.robot.tree import Tree
from testbed.motion.clearance import MAX_DISTANCE, DistanceMeter
from testbed.motion.collision_model import CollisionModel, distance_rate_bounds
from testbed.motion.fourier import Fourier
from testbed.motion.limits import Limits
from testbed.motion.samples import NewtonEulerForces
from testbed.motion.terms import ForceTerm, force_curvature_bounds

FORCE_SAMPLE_RATE = 1000.0
"""Initial sampling rate of forces [Hz]."""
MAX_INTERPOLATION_ERROR = 2e-3
"""Largest interpolation error of a force, relative to its limit; the sampling rate is doubled for
larger errors."""
MAX_SAMPLES = 100_000
"""Largest number of force samples."""
SAMPLES_PER_HARMONIC = 200
"""Samples per harmonic of positions, velocities and accelerations; the supremum is then at most
1.0001 times the largest sample."""
INTERVALS = 50
"""Number of intervals of a period with separate bounds of the derivatives."""
QUICK_SAMPLES = 60
"""Number of samples of a period in the check before a proof."""
MIN_ADVANCE = 1e-5
"""Smallest time step of conservative advancement, relative to the period; the proof fails for
smaller steps."""
MIN_APPROACH_SPEED = 1e-9
"""Smallest assumed approach speed of two bodies [m/s]."""
UNPROVEN_DEFICIT = 1e-9
"""Shortfall of the distance that is reported for an unproven clearance [m]."""

MAX_BINDING_SHARE = 0.01
"""Largest remaining fraction of a limit that is reported as binding."""

MAX_BINDING_DISTANCE = 0.01
"""Largest distance beyond a clearance that is reported as binding [m]."""


class Path(Protocol):
    """Motion over a finite time with bounded derivatives."""

    @property
    def duration(self) -> float:
        """Duration of the motion, which starts at t = 0 [s]."""

    @property
    def fifth_derivative(self) -> Array:
        """Upper bounds of the absolute fifth time derivatives of the positions, (n,)."""

    def derivative(self, t: Array, order: int) -> Array:
        """Time derivatives of order 0 to 4 of the positions at M times t, (M, n)."""

    def at(self, t: Array) -> Motion:
        """Positions, velocities and accelerations at times t, (M,) [s]."""


@dataclass(frozen=True)
class Margin:
    """Proven margin of a motion to one limit.

    Attributes:
        label: Name of the limit.
        left: Proven remaining fraction of the limit, or distance beyond the clearance [m]; negative
            if the limit is exceeded or not proven to be respected.
        instant: Time of the smallest margin [s].
        unit: "" for a fraction, "m" for a distance.
    """

    label: str
    left: float
    instant: float
    unit: str = ""

    @property
    def is_respected(self) -> bool:
        """True if the limit is respected at every instant."""
        return self.left >= 0

    @property
    def words(self) -> str:
        """Sentence for a report, with label, remaining or missing amount, and time."""
        size = (
            f"{abs(self.left) * 1000:.3g} mm" if self.unit else f"{abs(self.left):.2%}"
        )
        state = (
            f"{size} left"
            if self.is_respected
            else f"exceeded by {size} or more, or not shown to be kept"
        )
        return f"{self.label}: {state} at t = {self.instant:.3f} s"


@dataclass(frozen=True)
class Proof:
    """Margins of a motion to all limits.

    Attributes:
        margins: Margin of each limit.
        instants: Number of samples at which forces were computed.
        postures: Number of postures at which distances were computed.
    """

    margins: tuple[Margin, ...]
    instants: int
    postures: int

    __get_pydantic_core_schema__ = schema_with_properties("is_valid", "binding")

    @property
    def is_valid(self) -> bool:
        """True if the motion respects all limits at every instant."""
        return all(margin.is_respected for margin in self.margins)

    @property
    def binding(self) -> tuple[str, ...]:
        """Names of the limits that the motion nearly reaches or exceeds.

        A limit is binding if its margin is below MAX_BINDING_SHARE, or below MAX_BINDING_DISTANCE
        for a clearance.
        """
        return tuple(
            margin.label
            for margin in self.margins
            if margin.left
            < (MAX_BINDING_DISTANCE if margin.unit else MAX_BINDING_SHARE)
        )

    @property
    def smallest_margin(self) -> Margin:
        """Margin with the smallest `left`; fractions and distances [m] are compared as numbers."""
        return min(self.margins, key=lambda margin: margin.left)


@dataclass(frozen=True, eq=False)
class MotionConstraints:
    """Limits that a motion must respect.

    Attributes:
        tree: The robot, with a-priori inertias and friction.
        limits: Limits of the joints.
        margin: Usable fraction of the limits of joint positions, velocities and accelerations.
        force_limits: Limits of motor efforts, plate and force sensors.
        collision: Shapes and watched pairs of bodies, whose distances are limited; None if no pair
            is watched.
        clearance: Required distances of the k watched pairs, (k,) [m].
        diagnostics: Diagnostics of pairs that are not watched or have a reduced clearance.
    """

    tree: Tree
    limits: Limits
    margin: float
    force_limits: Sequence[ForceTerm]
    collision: CollisionModel | None
    clearance: Array
    diagnostics: tuple[Diagnostic, ...] = ()


def prove(motion: Fourier, rules: MotionConstraints) -> Proof:
    """Compute proven margins of a motion to all limits.

    Args:
        motion: Periodic motion.
        rules: Limits of the motion.
    """
    forces, instants = force_margins(motion, rules)
    distances, postures = _distance_margins(motion, rules)
    return Proof(
        (*_joint_margins(motion, rules), *forces, *distances), instants, postures
    )


def respects_limits_at_samples(motion: Fourier, rules: MotionConstraints) -> bool:
    """Test whether a motion respects all limits at QUICK_SAMPLES instants of a period.

    This necessary condition allows a quick rejection before a proof.

    Args:
        motion: Periodic motion.
        rules: Limits of the motion.
    """
    samples = NewtonEulerForces(rules.tree, motion.at(motion.instants(QUICK_SAMPLES)))
    shares = _limit_shares(samples.motion, rules.limits)
    if any((share > rules.margin).any() for share in shares.values()):
        return False
    if any((term.values(samples) > 0).any() for term in rules.force_limits):
        return False
    if rules.collision is None:
        return True
    meter = DistanceMeter(rules.collision, rules.clearance + UNPROVEN_DEFICIT)
    return bool((meter.measure(samples.motion.q).values > rules.clearance).all())


def _joint_margins(motion: Fourier, rules: MotionConstraints) -> list[Margin]:
    """Margins of joint positions, velocities and accelerations.

    The supremum of an absolute trigonometric polynomial is at most the largest absolute sample
    divided by cos(pi harmonics / samples).
    """
    count = max(
        force_sample_count(motion.period), SAMPLES_PER_HARMONIC * motion.harmonics
    )
    cosine, times = np.cos(np.pi * motion.harmonics / count), motion.instants(count)
    margins = []
    for kind, shares in _limit_shares(motion.at(times), rules.limits).items():
        labels = [f"{kind} of '{name}'" for name in rules.tree.names]
        margins += smallest_margins(labels, rules.margin - shares.T / cosine, times)
    return margins


def smallest_margins(
    labels: Iterable[str], left: Array, times: Array, unit: str = ""
) -> list[Margin]:
    """Margins of limits from values over time, each at the time of its minimum.

    Args:
        labels: Names of the k limits.
        left: Remaining fraction or distance at M times, (k, M).
        times: Times, (M,) [s].
        unit: "" for fractions, "m" for distances.
    """
    return [
        Margin(label, float(values.min()), float(times[values.argmin()]), unit)
        for label, values in zip(labels, left, strict=True)
    ]


def _limit_shares(motion: Motion, limits: Limits) -> dict[str, Array]:
    """Ratios of absolute positions, velocities and accelerations to limits, by kind, (M, n).

    Positions are relative to the middle of the position range.
    """
    return {
        "position": np.abs(motion.q - limits.middle) / limits.half,
        "velocity": np.abs(motion.qd) / limits.velocity,
        "acceleration": np.abs(motion.qdd) / limits.acceleration,
    }


def force_margins(path: Path, rules: MotionConstraints) -> tuple[list[Margin], int]:
    """Margins of efforts, wrench and centre of pressure on a path, and number of samples.

    The error of piecewise linear interpolation between samples h apart is at most h^2 / 8 times the
    bound of the second derivative; this error is subtracted from the margin. The sampling rate is
    doubled until the error is at most MAX_INTERPOLATION_ERROR or the number of samples reaches
    MAX_SAMPLES.

    Args:
        path: Motion with bounded derivatives.
        rules: Limits of the motion.
    """
    count = force_sample_count(path.duration)
    while True:
        bounds = force_curvature_bounds(rules.tree, derivative_bounds(path, count))
        interpolation_errors = [
            (path.duration / count) ** 2 / 8 * term.curvatures(bounds)
            for term in rules.force_limits
        ]
        if (
            max((error.max(initial=0) for error in interpolation_errors), default=0)
            <= MAX_INTERPOLATION_ERROR
            or 2 * count > MAX_SAMPLES
        ):
            break
        count *= 2
    times = np.arange(count + 1) * path.duration / count
    samples = NewtonEulerForces(rules.tree, path.at(times))
    margins: list[Margin] = []
    for term, error in zip(rules.force_limits, interpolation_errors, strict=True):
        values = term.values(samples)
        interval_maxima = np.maximum(values[:, :-1], values[:, 1:])
        interval_maxima += np.repeat(error, count // INTERVALS, axis=1)
        margins += smallest_margins(term.labels, -interval_maxima, times)
    return margins, count


def force_sample_count(duration: float) -> int:
    """Number of samples of a path at FORCE_SAMPLE_RATE, rounded up to a multiple of `INTERVALS`.

    Args:
        duration: Duration of the path [s].
    """
    return INTERVALS * int(np.ceil(FORCE_SAMPLE_RATE * duration / INTERVALS))


def derivative_bounds(path: Path, count: int) -> Array:
    """Upper bounds of |q| and the first four absolute derivatives, (5, n, INTERVALS).

    The path is divided into INTERVALS equal intervals. Between samples h apart, a function exceeds
    its samples by at most h / 2 times the bound of its derivative.

    Args:
        path: Motion with bounded derivatives.
        count: Number of samples, a multiple of `INTERVALS`.
    """
    times, span = np.arange(count + 1) * path.duration / count, count // INTERVALS
    values = np.abs([path.derivative(times, order) for order in range(5)])
    inner_maxima = values[:, :-1].reshape(5, INTERVALS, span, -1).max(axis=2)
    largest = np.maximum(inner_maxima, values[:, span::span])  # (5, SPANS, n)
    derivative_bound = path.fifth_derivative
    for maxima in largest[::-1]:
        maxima += path.duration / count / 2 * derivative_bound
        derivative_bound = maxima.max(axis=0)
    return np.asarray(largest.transpose(0, 2, 1))


def _distance_margins(
    motion: Fourier, rules: MotionConstraints
) -> tuple[list[Margin], int]:
    """Margins of clearances, and number of postures at which distances were computed.

    Margins are computed for all pairs that come nearer than the largest clearance plus
    MAX_DISTANCE.
    """
    if rules.collision is None:
        return [], 0
    meter = DistanceMeter(rules.collision, rules.clearance + MAX_DISTANCE)
    times, distances = _advance_conservatively(motion, rules, meter)
    labels = [
        f"distance of {name} (over {1000 * clearance:.3g} mm)"
        for name, clearance in zip(rules.collision.names, rules.clearance, strict=True)
    ]
    is_near = distances.min(axis=0) < meter.max_distance
    remaining = (distances - rules.clearance).T[is_near]
    return smallest_margins(compress(labels, is_near), remaining, times, "m"), len(
        times
    )


def _advance_conservatively(
    motion: Fourier, rules: MotionConstraints, meter: DistanceMeter
) -> tuple[Array, Array]:
    """Times (P,) and distances of all pairs (P, k) from conservative advancement.

    P is the number of time steps, k the number of pairs. Every step is short enough that no pair
    can fall below its clearance at its largest approach speed. If a step is shorter than
    MIN_ADVANCE times the period, the advancement ends, and the last distance is set below the
    clearance, which is not proven.

    Args:
        motion: Periodic motion.
        rules: Limits of the motion, with watched pairs.
        meter: Distances in given postures.
    """
    speeds = (
        distance_rate_bounds(meter.collision, rules.limits)
        @ derivative_bounds(motion, force_sample_count(motion.period))[1]
    )
    times, distances, time = [], [], 0.0
    # the bounds of a span apply within it only
    for span, speed in enumerate(np.maximum(speeds, MIN_APPROACH_SPEED).T, start=1):
        end = span * motion.period / INTERVALS
        while time < end:
            distance = meter.measure(motion.derivative(np.array([time]), 0)[0]).values
            times.append(time)
            distances.append(distance)
            steps = (distance - rules.clearance) / speed
            nearest = int(steps.argmin())
            if steps[nearest] < MIN_ADVANCE * motion.period:
                distance[nearest] = min(
                    distance[nearest], rules.clearance[nearest] - UNPROVEN_DEFICIT
                )
                return np.array(times), np.array(distances)
            time = min(time + float(steps[nearest]), end)
    return np.array(times), np.array(distances)


@dataclass(frozen=True, eq=False)
class Slack:
    """Smallest margin of all limits of one kind as a function of time.

    Attributes:
        label: Kind of limit, such as "velocity limits".
        unit: "%" or "mm".
        left: Remaining percentage or distance at M times, in `unit`, (M,).
    """

    label: str
    unit: str
    left: Array


def slack_by_kind(
    motion: Fourier, rules: MotionConstraints, times: Array
) -> list[Slack]:
    """Smallest margin at given times for each kind of limit.

    Margins between the times are not considered. Clearances are included if a pair comes nearer
    than `MAX_DISTANCE`; pairs with a reduced clearance are excluded.

    Args:
        motion: Periodic motion.
        rules: Limits of the motion.
        times: Times, (M,) [s].
    """
    samples = NewtonEulerForces(rules.tree, motion.at(times))
    shares = _limit_shares(samples.motion, rules.limits)
    remaining = {kind: rules.margin - used.max(axis=1) for kind, used in shares.items()}
    remaining |= {
        term.labels[0].split()[0]: -term.values(samples).max(axis=0)
        for term in rules.force_limits
    }
    margins = [
        Slack(f"{kind} limits", "%", 100 * values) for kind, values in remaining.items()
    ]
    if rules.collision is not None:
        meter = DistanceMeter(rules.collision)
        clearance = rules.clearance.max()
        # pairs with reduced clearance are always near, and would be the minimum
        is_full = rules.clearance == clearance
        nearest = meter.measure(samples.motion.q).values[:, is_full].min(axis=1)
        if (nearest < MAX_DISTANCE).any():  # otherwise no pair comes near
            margins.append(Slack("clearances", "mm", 1000 * (nearest - clearance)))
    return margins
