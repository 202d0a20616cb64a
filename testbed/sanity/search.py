"""The mistakes that explain a recording best, one after the other."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from testbed.robot.tree import Tree
from testbed.sanity.mistakes import (
    MOST_JOINTS,
    QUARTERS,
    Mistake,
    Signals,
    mistakes_of_all,
    mistakes_of_joints,
    own_joints,
    rarer_mistakes,
)
from testbed.sanity.model_rows import ModelRows, model_rows
from testbed.sanity.scaled_fit import ScaledFit, scaled_fit

EXPLAINED = 0.02
"""Part of a channel's variance that rough models leave: below it nothing is odd."""

NOISY = 3.0
"""Times the noise's own part that may be left besides."""

CONCERNS = 0.3
"""Part of what is left that the model's bodies must make for a mistake of theirs to explain it."""

PUSHING = 0.9
"""Part that is left where friction would have to push."""

GOOD = 0.2
"""What may be left of a channel where rarer mistakes are not looked for."""

STEP = 10.0
"""By how much the cost must fall for a mistake to be taken up."""

MOST = 6
"""Mistakes in one recording."""

WIDTHS = tuple(np.deg2rad(angle) for angle in (8, 4, 2, 1, 0.5))
"""Steps by which the angle of a zero is refined [rad]."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Data without some mistakes, and how well they can be true.

    Attributes:
        mistakes: That were undone, in this order.
        signals: What is left when they are.
        free_gains: Whether torques are taken as multiples of what they should be.
        rows: Of model and measurement.
        fit: Of the model to them.
    """

    mistakes: tuple[Mistake, ...]
    signals: Signals
    free_gains: bool
    rows: ModelRows
    fit: ScaledFit


def as_given(tree: Tree, signals: Signals, rate: float, *, free_gains: bool = False) -> Reading:
    """The data as they are.

    Args:
        tree: The robot, its masses roughly right.
        signals: Positions, torques, wrench.
        rate: Samples a second [Hz].
        free_gains: Whether torques may be multiples of what they should be.
    """
    rows = model_rows(tree, signals.position, signals.torque, signals.wrench, rate)
    return Reading((), signals, free_gains, rows, scaled_fit(rows, free_gains=free_gains))


def best_reading(tree: Tree, given: Reading, rate: float) -> Reading:
    """The data without the mistakes that explain them best; as given, if they need none.

    Args:
        tree: The robot, its masses roughly right.
        given: The data as they are.
        rate: Samples a second [Hz].
    """
    found = given
    while len(found.mistakes) < MOST and (found is given or not _good(found)):
        signals, better, doubted = found.signals, found, doubted_joints(tree, found)
        if not doubted:
            break
        few = [*mistakes_of_all(tree, signals), *mistakes_of_joints(tree, signals, doubted)]
        better = _best(tree, found, rate, few, better)
        if better is found or _of_zeros(better) or not _good(better):
            rarer = rarer_mistakes(tree, doubted if tree.n <= MOST_JOINTS else ())
            better = _best(tree, found, rate, rarer, better)
        if better is found:
            break
        found = _refined(tree, found, better, rate)
    return found


def larger_motion(tree: Tree, given: Reading, rate: float) -> Reading:
    """The data with radians that were taken for degrees, if that explains them better.

    Friction explains most of a tiny motion's torques, so that nothing need be odd about them.

    Args:
        tree: The robot, its masses roughly right.
        given: The data as they are.
        rate: Samples a second [Hz].
    """
    few = [m for m in mistakes_of_all(tree, given.signals) if m.kind == "radians"]
    return _best(tree, given, rate, few, given)


def _of_zeros(reading: Reading) -> bool:
    """Whether its last mistake is a zero: those of neighbours may hide behind one."""
    return reading.mistakes[-1].kind == "zero"


def _good(reading: Reading) -> bool:
    """Whether nothing is left that a rarer mistake would have to explain."""
    allowed = GOOD + NOISY * reading.rows.noise_share
    return bool((reading.fit.left < allowed)[odd_channels(reading)].all())


def _refined(tree: Tree, start: Reading, found: Reading, rate: float) -> Reading:
    """A reading whose last mistake's odd angles are the best, not those that were tried."""
    mistake = found.mistakes[-1]
    if set(mistake.angles) <= set(QUARTERS):
        return found
    for place, width in product(range(len(mistake.angles)), WIDTHS):
        angles = np.array(mistake.angles)
        for side in (-width, width):
            moved = replace(mistake, angles=tuple(angles + side * np.eye(len(angles))[place]))
            tried = _without(tree, start, moved, rate)
            if tried.fit.cost < found.fit.cost:
                found, mistake = tried, moved
    return found


def doubted_joints(tree: Tree, reading: Reading) -> list[int]:
    """Joints of which something is not explained; all, if it is the wrench.

    Args:
        tree: The robot.
        reading: Of the data.
    """
    odd = odd_channels(reading)
    if (odd >= reading.rows.joints).any():
        return list(own_joints(tree))
    return [int(k) for k in odd]


def odd_channels(reading: Reading) -> NDArray[np.intp]:
    """Channels of which something is not explained.

    Args:
        reading: Of the data.
    """
    rows, left = reading.rows, reading.fit.left
    variance = np.maximum(rows.measured.var(axis=0), 1e-30)
    bodies = rows.bodies.sum(axis=2).var(axis=0) / variance
    bodies[: rows.joints] *= reading.fit.gains[: rows.joints] ** 2
    least = EXPLAINED + NOISY * rows.noise_share
    return np.flatnonzero((left > least) & ((bodies > CONCERNS * left) | (left > PUSHING)))


def _best(
    tree: Tree,
    start: Reading,
    rate: float,
    mistakes: Iterable[Mistake],
    best: Reading,
) -> Reading:
    """The reading with one mistake less that is better than all others by a step, if any is."""
    for mistake in mistakes:
        tried = _without(tree, start, mistake, rate)
        if _price(tried) < _price(best):
            best = tried
    return best


def _price(reading: Reading) -> float:
    """Its cost, and that of its mistakes: of two joints or of odd angles they must explain more."""
    odd = [not set(m.angles) <= set(QUARTERS) for m in reading.mistakes]
    steps = sum(max(1, len(m.angles)) for m in reading.mistakes) + sum(odd)
    return reading.fit.cost + STEP * steps


def _without(tree: Tree, start: Reading, mistake: Mistake, rate: float) -> Reading:
    """A reading with one mistake less; where positions stay, so does what the model says."""
    signals = mistake.undone(start.signals)
    if signals.position is start.signals.position:
        joints, rows = start.rows.joints, start.rows
        there = Signals(rows.speed, rows.measured[:, :joints], rows.measured[:, joints:])
        changed = mistake.undone(there)
        measured = [part for part in (changed.torque, changed.wrench) if part is not None]
        rows = replace(rows, measured=np.hstack(measured))
    else:
        rows = model_rows(tree, signals.position, signals.torque, signals.wrench, rate)
    fit = scaled_fit(rows, free_gains=start.free_gains)
    return Reading((*start.mistakes, mistake), signals, start.free_gains, rows, fit)
