"""Proof that a periodic motion respects its limits at every moment; margins over time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Protocol

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.codec import with_properties
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.robot.tree import Tree
from testbed.motion.clearance import FAR, DistanceMeter
from testbed.motion.collision_model import CollisionModel, levers
from testbed.motion.fourier import Fourier
from testbed.motion.limits import Limits
from testbed.motion.samples import Computed
from testbed.motion.terms import ForceTerm, force_bounds

RATE = 1000.0
"""Samples a second at which forces are looked at first [Hz]."""
DOUBT = 2e-3
"""What may be lost between samples, as a share of a limit; else twice as many are taken."""
MOST = 100_000
"""Samples at most."""
DENSE = 200
"""Samples a harmonic for positions, velocities, accelerations: sup / largest is 1.0001."""
SPANS = 50
"""Spans of a period in which bounds are found apart."""
GLANCE = 60
"""Instants of a period that are looked at before a proof is tried."""
SHORTEST = 1e-5
"""Advancement by less than this part of a period is none."""
STILL = 1e-9
"""Bodies that do not approach each other are taken to do so with this speed [m/s]."""
TOUCH = 1e-9
"""What a distance lacks that could not be shown to be kept [m]."""

CLOSE = 0.01
"""A limit with less than this share of it left is one that binds."""

CLOSE_BY = 0.01
"""Likewise for distances beyond the clearance [m]."""


class Path(Protocol):
    """A motion over a time, with bounded derivatives."""

    @property
    def duration(self) -> float:
        """From its beginning, t = 0, to its end [s]."""

    @property
    def fifth_derivative(self) -> Array:
        """A bound of the magnitude of the fifth derivative, (n,)."""

    def derivative(self, t: Array, order: int) -> Array:
        """A derivative of the positions, of order 0 to 4, at times t, (M, n)."""

    def at(self, t: Array) -> Motion:
        """The motion at times t, (M,) [s]."""


@dataclass(frozen=True)
class Margin:
    """What a motion leaves of one limit.

    Attributes:
        label: What is limited.
        left: What is proven to be left of what may be used, a share, or for clearance in metres;
            negative where it is exceeded, or where that could not be excluded.
        instant: When it is nearest to its limit [s].
        unit: "" for a share, "m" for a distance.
    """

    label: str
    left: float
    instant: float
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Whether the limit is respected at every moment."""
        return self.left >= 0

    @property
    def words(self) -> str:
        """For people: how much is left, or by how much it is exceeded, and when."""
        size = (
            f"{abs(self.left) * 1000:.3g} mm" if self.unit else f"{abs(self.left):.2%}"
        )
        state = (
            f"{size} left"
            if self.holds
            else f"exceeded by {size} or more, or not shown to be kept"
        )
        return f"{self.label}: {state} at t = {self.instant:.3f} s"


@dataclass(frozen=True)
class Proof:
    """Margins of all limits.

    Attributes:
        margins: One a limit.
        instants: Samples at which forces were computed.
        postures: Postures at which distances were measured.
    """

    margins: tuple[Margin, ...]
    instants: int
    postures: int

    __get_pydantic_core_schema__ = with_properties("holds", "binding")

    @property
    def holds(self) -> bool:
        """Whether the motion respects all limits at every moment."""
        return all(margin.holds for margin in self.margins)

    @property
    def binding(self) -> tuple[str, ...]:
        """Limits that the motion comes up to."""
        return tuple(
            m.label for m in self.margins if m.left < (CLOSE_BY if m.unit else CLOSE)
        )

    @property
    def worst(self) -> Margin:
        """The limit with the least left."""
        return min(self.margins, key=lambda margin: margin.left)


@dataclass(frozen=True, eq=False)
class Rules:
    """What a motion must respect.

    Attributes:
        tree: The robot, its inertias and friction an a-priori model.
        limits: Of its joints.
        margin: Share of them that may be used.
        terms: Limits of efforts and plate.
        collision: Shapes and the pairs that are watched; None if nothing is.
        clearance: Distance that each pair keeps, (k,) [m].
        diagnostics: What could not be watched.
    """

    tree: Tree
    limits: Limits
    margin: float
    terms: Sequence[ForceTerm]
    collision: CollisionModel | None
    clearance: Array
    diagnostics: tuple[Diagnostic, ...] = ()


def prove(motion: Fourier, rules: Rules) -> Proof:
    """What a motion is proven to leave of every limit.

    Args:
        motion: The motion.
        rules: What it must respect.
    """
    forces, instants = force_margins(motion, rules)
    distances, postures = _distances(motion, rules)
    return Proof((*_linear(motion, rules), *forces, *distances), instants, postures)


def seems_to_hold(motion: Fourier, rules: Rules) -> bool:
    """Whether all limits are kept at some instants: no proof, but quick."""
    here = Computed(rules.tree, motion.at(motion.instants(GLANCE)))
    shares = _shares(here.motion, rules.limits)
    if any((share > rules.margin).any() for share in shares.values()):
        return False
    if any((term.values(here) > 0).any() for term in rules.terms):
        return False
    if rules.collision is None:
        return True
    meter = DistanceMeter(rules.collision, rules.clearance + TOUCH)
    return bool((meter.measure(here.motion.q).values > rules.clearance).all())


def _linear(motion: Fourier, rules: Rules) -> list[Margin]:
    """Positions, velocities, accelerations."""
    count = max(spans_of(motion.period), DENSE * motion.harmonics)
    slack, times = np.cos(np.pi * motion.harmonics / count), motion.instants(count)
    found = []
    for kind, shares in _shares(motion.at(times), rules.limits).items():
        labels = [f"{kind} of '{name}'" for name in rules.tree.names]
        found += margins_of(labels, rules.margin - shares.T / slack, times)
    return found


def margins_of(
    labels: Iterable[str], left: Array, times: Array, unit: str = ""
) -> list[Margin]:
    """Margins of limits, each at the instant when least is left.

    Args:
        labels: What is limited, (k,).
        left: What is left at each instant, (k, M).
        times: (M,) [s].
        unit: "" for shares, "m" for distances.
    """
    return [
        Margin(label, float(each.min()), float(times[each.argmin()]), unit)
        for label, each in zip(labels, left, strict=True)
    ]


def _shares(motion: Motion, limits: Limits) -> dict[str, Array]:
    """Positions, velocities and accelerations over their limits, by kind, (M, n) each."""
    return {
        "position": np.abs(motion.q - limits.middle) / limits.half,
        "velocity": np.abs(motion.qd) / limits.velocity,
        "acceleration": np.abs(motion.qdd) / limits.acceleration,
    }


def force_margins(path: Path, rules: Rules) -> tuple[list[Margin], int]:
    """What a path leaves of efforts, wrench and centre of pressure, and samples taken.

    Args:
        path: A motion with bounded derivatives.
        rules: What it must respect.
    """
    count = spans_of(path.duration)
    while True:
        bounds = force_bounds(rules.tree, suprema(path, count))
        lost = [
            (path.duration / count) ** 2 / 8 * t.curvatures(bounds) for t in rules.terms
        ]
        if (
            max((part.max(initial=0) for part in lost), default=0) <= DOUBT
            or 2 * count > MOST
        ):
            break
        count *= 2
    times = np.arange(count + 1) * path.duration / count
    samples = Computed(rules.tree, path.at(times))
    found: list[Margin] = []
    for term, excess in zip(rules.terms, lost, strict=True):
        values = term.values(samples)
        ends = np.maximum(values[:, :-1], values[:, 1:])
        ends += np.repeat(excess, count // SPANS, axis=1)
        found += margins_of(term.labels, -ends, times)
    return found, count


def spans_of(duration: float) -> int:
    """Samples of a path, a multiple of its spans."""
    return SPANS * int(np.ceil(RATE * duration / SPANS))


def suprema(path: Path, count: int) -> Array:
    """Bounds of |q| and its next four derivatives in spans of a path, (5, n, SPANS).

    Between samples h apart a function is at most h/2 sup|its derivative| more than at them.

    Args:
        path: A motion with bounded derivatives.
        count: Samples, a multiple of SPANS.
    """
    times, span = np.arange(count + 1) * path.duration / count, count // SPANS
    sizes = np.abs([path.derivative(times, order) for order in range(5)])
    inner = sizes[:, :-1].reshape(5, SPANS, span, -1).max(axis=2)
    largest = np.maximum(inner, sizes[:, span::span])  # (5, SPANS, n)
    beyond = path.fifth_derivative
    for each in largest[::-1]:
        each += path.duration / count / 2 * beyond
        beyond = each.max(axis=0)
    return np.asarray(largest.transpose(0, 2, 1))


def _distances(motion: Fourier, rules: Rules) -> tuple[list[Margin], int]:
    """Least distances of pairs, and how often they were measured."""
    if rules.collision is None:
        return [], 0
    meter = DistanceMeter(rules.collision, rules.clearance + FAR)
    times, distances = _advanced(motion, rules, meter)
    labels = [
        f"distance of {name} (over {1000 * kept:.3g} mm)"
        for name, kept in zip(rules.collision.names, rules.clearance, strict=True)
    ]
    near = distances.min(axis=0) < meter.far
    left = (distances - rules.clearance).T[near]
    return margins_of(compress(labels, near), left, times, "m"), len(times)


def _advanced(
    motion: Fourier, rules: Rules, meter: DistanceMeter
) -> tuple[Array, Array]:
    """Times and distances of all pairs, (P,) and (P, k), by conservative advancement.

    From each time to the next no pair can use up what it has beyond its clearance. The last row
    falls short of a clearance where a next time cannot be found.
    """
    speeds = (
        levers(meter.collision, rules.limits)
        @ suprema(motion, spans_of(motion.period))[1]
    )
    times, distances, time = [], [], 0.0
    # each in its span alone
    for number, speed in enumerate(np.maximum(speeds, STILL).T, start=1):
        end = number * motion.period / SPANS
        while time < end:
            distance = meter.measure(motion.derivative(np.array([time]), 0)[0]).values
            times.append(time)
            distances.append(distance)
            ahead = (distance - rules.clearance) / speed
            first = int(ahead.argmin())
            if ahead[first] < SHORTEST * motion.period:
                distance[first] = min(distance[first], rules.clearance[first] - TOUCH)
                return np.array(times), np.array(distances)
            time = min(time + float(ahead[first]), end)
    return np.array(times), np.array(distances)


@dataclass(frozen=True, eq=False)
class Slack:
    """What the nearest limit of a kind leaves of what may be used.

    Attributes:
        label: The kind, as "velocity limits".
        unit: "%" or "mm".
        left: At each instant, (M,).
    """

    label: str
    unit: str
    left: Array


def slack(motion: Fourier, rules: Rules, times: Array) -> list[Slack]:
    """What is left of every kind of limit; of clearances, where anything comes nearer than FAR.

    Args:
        motion: The motion.
        rules: What it must respect.
        times: (M,) [s].
    """
    here = Computed(rules.tree, motion.at(times))
    shares = _shares(here.motion, rules.limits)
    left = {kind: rules.margin - used.max(axis=1) for kind, used in shares.items()}
    left |= {
        term.labels[0].split()[0]: -term.values(here).max(axis=0)
        for term in rules.terms
    }
    found = [
        Slack(f"{kind} limits", "%", 100 * values) for kind, values in left.items()
    ]
    if rules.collision is not None:
        meter = DistanceMeter(rules.collision)
        wanted = rules.clearance.max()
        # others are built nearer, and would hide all else
        whole = rules.clearance == wanted
        nearest = meter.measure(here.motion.q).values[:, whole].min(axis=1)
        if (nearest < FAR).any():  # else nothing ever comes near
            found.append(Slack("clearances", "mm", 1000 * (nearest - wanted)))
    return found
