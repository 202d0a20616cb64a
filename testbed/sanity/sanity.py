"""Whether a recording can be true of a robot at all, before anything is estimated.

Masses need only be right within a factor of a few. A recording is refused where the data
without some mistakes of the mapping are far more likely than the data as they are, and explained
well; where no mistakes explain what a plate has measured; and where a robot would have a negative
weight. Where that is less clear, or torques are only too small or too large, there are warnings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.identification.finding import Finding, in_lines
from testbed.recordings.geometry import check_robot
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source
from testbed.robot.rotations import from_rpy
from testbed.robot.tree import Tree
from testbed.sanity.channel_findings import spike_findings, still_findings, unmoved_finding
from testbed.sanity.cure_words import (
    cure_finding,
    gain_finding,
    named,
    position_finding,
    zero_finding,
)
from testbed.sanity.cures import Cure, cures_of, frame_of, position_offset
from testbed.sanity.explanation import Explanation
from testbed.sanity.instants import Instants
from testbed.sanity.mistakes import Mistake
from testbed.sanity.plate_findings import (
    equal_zeros,
    map_findings,
    weight_finding,
    zero_mistake,
)
from testbed.sanity.search import Progress, Search

CERTAIN, LIKELY = 12.0, 6.0
"""Differences of minus the logarithm of likelihood from which a mistake is certain, or likely."""

WELL, NOISY, TIMES = 0.4, 3.0, 4.0
"""Part of a channel's variance that may be left where a mistake is called certain, times its
noise's part that may be left besides; and times less than before that must be left."""

SMALL, LARGE = 0.4, 2.5
"""Times what the model file says beyond which torques are doubted."""

LEAST, MOST = 0.25, 4.0
"""The same where they are refused: no masses are so wrong."""

SAME = np.deg2rad(3.0)
"""Difference of zeros that are no other ones [rad]."""

OUTSIDE = 1.0
"""Ranges of a joint by which its positions must leave it to be certainly wrong."""

MOST_SAMPLES = 200_000
"""Samples that are looked at, from the recording's middle."""


@dataclass(frozen=True, eq=False)
class Sanity:
    """What speaks for and against a recording.

    Attributes:
        sizes: Torques are so many times what the model file's masses say; nan where they do
            not tell, (n,) or (0,).
        cures: What would cure the recording, to be made together; empty where nothing is wrong.
        runner_up: Kinds of mistakes of the next best explanation.
        times: So many times more is left by that.
        equals: What explains the same, in words.
        given: The recording as it is; None where nothing can be told.
        explanations: What explains it, the best first; none where nothing can be told.
        certain: What is certainly wrong.
        likely: What may be.
    """

    sizes: Array
    cures: tuple[Cure, ...] = ()
    runner_up: tuple[str, ...] = ()
    times: float = 1.0
    equals: tuple[str, ...] = ()
    given: Explanation | None = None
    explanations: tuple[Explanation, ...] = ()
    certain: tuple[Finding, ...] = ()
    likely: tuple[Finding, ...] = ()

    @property
    def best(self) -> Explanation | None:
        """What explains the recording best."""
        return self.explanations[0] if self.explanations else None

    def require(self, *, align: bool = False) -> None:
        """Stop where something is certainly wrong.

        Args:
            align: Whether clocks are set right besides.

        Raises:
            RecordingError: Says what was found, and what would cure it.
        """
        late = len(self.certain) == 1 and [each.kind for each in self.cures] == ["late"]
        if self.certain and not (align and late):
            said = "; ".join(in_lines(self.certain))
            raise RecordingError(f"the recording cannot be true of this robot: {said}")


def check_sanity(tree: Tree, source: Source, progress: Progress | None = None) -> Sanity:
    """What speaks for and against a recording.

    Args:
        tree: The robot, its masses right within a factor of a few; not used for estimates.
        source: The recording.
        progress: Told how much of the search for mistakes is done.

    Raises:
        RecordingError: It is of another robot.
    """
    check_robot(source, tree)
    tree = tree.with_gravity(source.facts.get("gravity"))
    first = max(0, (source.samples - MOST_SAMPLES) // 2)
    part = source.part(first, min(source.samples, first + MOST_SAMPLES)).ordered(tree)
    mapping: Mapping[str, Any] = source.facts.get("mapping", {})
    position = np.array(part.position)
    search = Search(
        tree, (position, part.torque, part.wrench), source.rate,
        position_offset(tree, mapping), frame_of(mapping), progress,
    )  # fmt: skip
    by_channels = _by_channels(tree, part, search.given)
    if by_channels is not None:
        return by_channels
    given, found = search.best()
    best, gain = found[0], given.cost - found[0].cost
    clear = gain > CERTAIN and explains(given, best)
    foreign, certain, likely, more = _about_plate(best, source.tare)
    unmoved = unmoved_finding(tree, given)
    if unmoved is not None and unmoved.number and (foreign or not clear):
        sure, maybe = (unmoved,) * foreign, (unmoved,) * (not foreign)
        return Sanity(best.sizes, certain=sure, likely=maybe)
    wrong = [m for m in best.timed if m.kind != "torque_size"]
    if foreign or gain <= LIKELY:
        wrong = []
    cures: tuple[Cure, ...] = ()
    others = _others(tree, found)
    if wrong or more:
        before = np.concatenate([best.unchanged, given.left[len(best.unchanged) :]])
        cures = cures_of(tree, [*wrong, *more], before, best.left, mapping, len(best.unchanged))
    if wrong:
        said = cure_finding(tree, cures, *others, gain)
        if clear:
            certain, likely = [said, *certain], []
        else:
            likely = [*likely, said]
    elif more:
        likely = [*likely, zero_finding(cures[-1])]
    if not foreign:
        sure, maybe = gain_findings(tree, best, mapping)
        certain, likely = [*certain, *sure], [*likely, *maybe]
    certain = [*(position_finding(tree, position, OUTSIDE) if not wrong else ()), *certain]
    likely += [unmoved] if unmoved is not None else []
    return Sanity(best.sizes, cures, *others, given, tuple(found), tuple(certain), tuple(likely))


def _by_channels(tree: Tree, part: Recording, taken: Instants | None) -> Sanity | None:
    """What channels say by themselves, where nothing else can be told."""
    spikes = tuple(spike_findings(part))
    still, resting = still_findings(tree, taken) if taken is not None else ((), ())
    if taken is not None and not (spikes or still or resting):
        return None
    sure = spikes or (*position_finding(tree, part.position, OUTSIDE), *still)
    return Sanity(np.zeros(0), certain=sure, likely=() if spikes else resting)


def _about_plate(best: Explanation, tare: Array | None
                 ) -> tuple[bool, list[Finding], list[Finding], list[Mistake]]:  # fmt: skip
    """Whether no mapping explains the plate; what is certain, what likely; its zero's mistake."""
    if best.map is None:
        return False, [], [], []
    sure, maybe = map_findings(best)
    if sure:
        return True, sure, [], []
    zero = zero_mistake(best, tare)
    return False, list(weight_finding(best, tare)), maybe, [zero] if zero is not None else []


def gain_findings(
    tree: Tree, best: Explanation, mapping: Mapping[str, Any]
) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """Torques of another size, where that is certain, and where it is likely.

    Args:
        tree: The robot.
        best: What explains the recording best.
        mapping: What the recording's mapping file says.
    """
    odd = any(m.kind == "torque_size" for m in best.mistakes)
    if odd and not _within(best.sizes, LEAST, MOST):
        return (gain_finding(tree, best.sizes, LEAST, MOST, mapping),), ()
    if not _within(best.sizes, SMALL, LARGE):
        return (), (gain_finding(tree, best.sizes, SMALL, LARGE, mapping),)
    return (), ()


def explains(given: Explanation, found: Explanation) -> bool:
    """Whether channels that are explained better are explained well.

    Args:
        given: The data as they are.
        found: The data without mistakes.
    """
    before, after = given.left, found.left.copy()
    for each in found.mistakes:
        if each.kind == "torque_order":  # what is left of a column, whosever it is
            after[list(each.values)] = found.left[: len(each.values)]
    better = (before > TIMES * after) & (before > NOISY * given.noise)
    better |= np.array([m.kind == "shift" for m in found.mistakes]).any() & (before < WELL)
    return bool(better.any() and (after < WELL + NOISY * found.noise)[better].all())


def _others(tree: Tree, found: list[Explanation]) -> tuple[tuple[str, ...], float, tuple[str, ...]]:
    """The next best explanation that is none like the best, times more that it leaves; equals."""
    best = found[0]
    least = best.cost + best.tolerance
    equals = dict.fromkeys(equal_zeros(tree, best.mistakes))
    for each in found[1:]:
        if each.cost <= least and each.count <= best.count and not _alike(each, best):
            equals[" and ".join(named(tree, m) for m in each.mistakes) or "nothing wrong"] = None
    others = [each for each in found[1:] if each.cost > least and each.mistakes != best.mistakes]
    if not others:
        return (), 1.0, tuple(equals)
    nearest = min(others, key=lambda each: each.cost)
    about = slice(-6, None) if best.map is not None else slice(None)
    times = float(nearest.left[about].sum() / (best.left[about].sum() + 1e-9))
    return tuple(dict.fromkeys(m.kind for m in nearest.mistakes)), times, tuple(equals)


def _alike(one: Explanation, other: Explanation) -> bool:
    """Whether two explanations are the same, zeros and turns to a few degrees."""
    pairs = zip_longest(_sorted(one), _sorted(other), fillvalue=Mistake("zero"))
    return all(a == b or _near(a, b) for a, b in pairs)


def _sorted(one: Explanation) -> list[Mistake]:
    return sorted(one.mistakes, key=lambda each: (each.kind, each.joints))


def _near(one: Mistake, other: Mistake) -> bool:
    """Whether two mistakes are one, but for what noise makes of it."""
    if (one.kind, one.joints) != (other.kind, other.joints):
        return False
    if one.kind == "turn":
        cosine = (np.trace(from_rpy(one.values) @ from_rpy(other.values).T) - 1) / 2
        return bool(cosine > np.cos(SAME))
    zeros = one.kind == "zero" and np.allclose(one.values, other.values, atol=SAME)
    return one.kind in ("shift", "tare") or zeros


def _within(sizes: Array, least: float, most: float) -> bool:
    told = sizes[np.isfinite(sizes)]
    return bool(((told > least) & (told < most)).all())
