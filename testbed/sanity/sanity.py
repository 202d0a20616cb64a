"""Whether a recording can be true of a robot at all, before anything is estimated.

Masses need only be right within a factor of a few. A recording is refused where the data
without some mistake of the mapping are far more likely than the data as they are, and explained
well; where that is less clear, or torques are only too small or too large, there are warnings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.identification.finding import Finding, in_lines
from testbed.recordings.geometry import check_robot
from testbed.recordings.source import Source
from testbed.robot.tree import Tree
from testbed.sanity.cures import (
    gain_finding,
    mistake_finding,
    position_finding,
    position_offset,
)
from testbed.sanity.mistakes import QUARTERS, Signals, merged
from testbed.sanity.scaled_fit import LEAST, MOST
from testbed.sanity.search import (
    EXPLAINED,
    NOISY,
    Reading,
    as_given,
    best_reading,
    doubted_joints,
    larger_motion,
)

CERTAIN, LIKELY = 40.0, 15.0
"""Differences of minus the logarithm of likelihood from which a mistake is certain, or likely."""

WELL = 0.4
"""Part of a channel's variance that may be left where a mistake is called certain."""

CLEAR, TOLD = 0.01, 5.0
"""Part of a torque's variance that bodies alone must explain for its size to be told, and how
many times what is left that must be."""

MOSTLY = 0.1
"""What may be left in the middle one of the channels where torques of any size explain them: tiny
torques of a model that says nothing would be no explanation."""

SHARP = 10.0
"""Times less than before that must be left where a zero is not of a quarter turn."""

SMALL, LARGE = 0.4, 2.5
"""Times what the model file says beyond which torques are doubted."""

OUTSIDE = 1.0
"""Ranges of a joint by which its positions must leave it to be certainly wrong."""

ENOUGH = 200_000
"""Samples that are looked at, from the recording's middle."""


@dataclass(frozen=True, eq=False)
class Sanity:
    """What speaks for and against a recording.

    Attributes:
        joints: Joint names.
        factors: What the bodies' inertias must be multiplied by, (n,).
        left: Part of each channel's variance that rough masses, friction and rotors leave, (C,).
        sizes: Torques are so many times what the model file's masses say; nan where they do
            not tell, (n,) or (0,).
        certain: What is certainly wrong.
        likely: What may be.
    """

    joints: tuple[str, ...]
    factors: Array
    left: Array
    sizes: Array
    certain: tuple[Finding, ...]
    likely: tuple[Finding, ...]

    def require(self) -> None:
        """Stop where something is certainly wrong.

        Raises:
            RecordingError: Says what was found, and what would cure it.
        """
        if self.certain:
            said = "; ".join(in_lines(self.certain))
            raise RecordingError(f"the recording cannot be true of this robot: {said}")


def check_sanity(tree: Tree, source: Source) -> Sanity:
    """What speaks for and against a recording.

    Args:
        tree: The robot, its masses right within a factor of a few; not used for estimates.
        source: The recording.

    Raises:
        RecordingError: It is of another robot, or too short to tell.
    """
    check_robot(source, tree)
    tree = tree.with_gravity(source.facts.get("gravity"))
    first = max(0, (source.samples - ENOUGH) // 2)
    part = source.part(first, min(source.samples, first + ENOUGH)).ordered(tree)
    mapping: Mapping[str, Any] = source.facts.get("mapping", {})
    offset = position_offset(tree, mapping)
    signals = Signals(np.array(part.position), part.torque, part.wrench, offset)
    given = as_given(tree, signals, source.rate)
    sized = _likeliest(tree, given, source.rate)
    gain = given.fit.cost - sized.fit.cost
    wrong = [mistake_finding(tree, m, given, sized, mapping) for m in merged(sized.mistakes)]
    sizes = torque_sizes(sized)
    clear = gain > CERTAIN and _explains(given, sized)
    told = sizes[np.isfinite(sizes)]
    doubtful = told if clear else np.median(told, keepdims=True) if len(told) else told
    beyond = gain > LIKELY and sized.free_gains and not _within(doubtful, LEAST, MOST)
    size = [gain_finding(tree, sizes, LEAST, MOST, mapping)] if beyond else []
    outside = [] if clear else position_finding(tree, signals.position, OUTSIDE)
    certain = [*outside, *(wrong if clear else []), *size]
    likely = wrong if not clear and gain > LIKELY else []
    if not beyond and not _within(sizes, SMALL, LARGE):
        likely = [*likely, gain_finding(tree, sizes, SMALL, LARGE, mapping)]
    return Sanity(
        tree.names, sized.fit.factors, sized.fit.left, sizes, tuple(certain), tuple(likely)
    )


def _likeliest(tree: Tree, given: Reading, rate: float) -> Reading:
    """The reading that explains the data best; torques of any size only where nothing else does."""
    given = larger_motion(tree, given, rate)
    if not doubted_joints(tree, given):
        return given
    found = freed = given
    if given.rows.joints:
        freed = as_given(tree, given.signals, rate, free_gains=True)
    starts = [given] if freed is given else [given, freed]
    if freed.fit.cost < given.fit.cost - LIKELY:
        starts = starts[::-1]  # torques of another size: looked at first
    for start in starts:
        reading = best_reading(tree, start, rate)
        other = reading.free_gains and not found.free_gains
        margin = LIKELY if other else 0.0
        if reading.fit.cost < found.fit.cost - margin:
            found = reading
        most = not found.free_gains or np.median(found.fit.left) < MOSTLY
        if most and not doubted_joints(tree, found):
            break
    return found


def torque_sizes(reading: Reading) -> Array:
    """Times what the model file's masses say that torques are; nan where they do not tell, (n,).

    Args:
        reading: Of the data.
    """
    rows, fit = reading.rows, reading.fit
    sizes = np.full(rows.joints, np.nan)
    for joint in range(rows.joints):
        share = rows.bodies[:, joint] - rows.bodies[:, joint].mean(axis=0)
        moved = (rows.shifts[:, joint] - rows.shifts[:, joint].mean(axis=0)) @ fit.shifts
        model = float(np.linalg.norm(share.sum(axis=1)))
        told = fit.rigid[joint] > max(CLEAR, TOLD * fit.left[joint])
        if told and model > 0:
            sizes[joint] = fit.gains[joint] * np.linalg.norm(share @ fit.factors + moved) / model
    return sizes


def _within(sizes: Array, least: float, most: float) -> bool:
    told = sizes[np.isfinite(sizes)]
    return bool(((told > least) & (told < most)).all())


def _explains(given: Reading, found: Reading) -> bool:
    """Whether channels that are explained better are explained well."""
    before, after = given.fit.left, found.fit.left
    better = (before > EXPLAINED) & (after < before / 2)
    odd = [m for m in found.mistakes if m.kind == "zero" and not set(m.angles) <= set(QUARTERS)]
    if odd:  # wrong centres of mass may look like an odd angle, but never explain all
        better = (before > EXPLAINED) & (after < before / SHARP)
    well = WELL + NOISY * found.rows.noise_share
    return bool(better.any() and (after < well)[better].all())
