"""Which hypotheses explain a recording: fits of its positions, from the simple to the rare."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from testbed.core.base.errors import RecordingError
from testbed.core.recordings.recording import Recording
from testbed.core.robot.free_base import FREE, coordinates, poses
from testbed.core.robot.tree import Tree
from testbed.importing.check.explanation import (
    APART,
    ROUGHLY_APART,
    Explanation,
    HypothesisFit,
    ranked,
)
from testbed.importing.check.instants import CUTOFF, LATE, SLOW, Instants, sample
from testbed.importing.check.plate import EXPLAINED, PlateExplanation, frame_of
from testbed.importing.check.prior import prior_of
from testbed.importing.check.remedies import (
    Hypothesis,
    joint_map,
    position_hypotheses,
    position_offset,
    rarer_hypotheses,
)

Progress = Callable[[int, int], None]

DOUBTED = 10.0
"""Gain of a single hypothesis below which no others are looked for where there is no plate [nats].
"""

GOOD = 0.3
"""Share of a torque above which rarer hypotheses are looked for where there is no plate."""

CLOSE = 0.05
"""Share of a torque above which zeros are refined where there is no plate."""

SIGMAS = 3.0
"""Standard deviations by which parameters that the plate hardly identifies may be off."""

MUCH = 20.0
"""Times more than the least that some map of a plate leaves of another fit: it is none."""

JUDGED = 4
"""Fits whose plates are judged; the others cannot come up to them."""

MOST = 6
"""Explanations that are kept, the best first."""

AFRESH = ("late", "quaternion_order")
"""Hypotheses by which a recording's instants are others."""

UNITS = ("degrees", "radians", "base_unit", "quaternion_order")
"""Hypotheses that concern all joints, which are looked at before those of some."""

NOTHING = 1e-6
"""Gain of a hypothesis that changes nothing at all [nats]."""

COARSE, REFUTED = 130, 60.0
"""So many instants are enough to refute a hypothesis that makes them so less likely [nats]."""

STEPS = np.deg2rad([12, -12, 6, -6, 3, -3, 1.5, -1.5, 0.7, -0.7])
"""By which a zero is moved while that is better [rad]."""


class Search:
    """All fits of a recording that were made.

    Attributes:
        prior: The robot.
        frame: How the mapping has read the plate.
        instants: Of the recording as it is; None where it is too short.
        fits: By hypotheses about positions and clocks.
    """

    def __init__(
        self, tree: Tree, recording: Recording, mapping: Mapping[str, Any],
        progress: Progress | None = None,
    ) -> None:  # fmt: skip
        """Nothing yet.

        Args:
            tree: The robot, its masses roughly right.
            recording: In the order of its joints.
            mapping: What the recording's mapping file says; empty if it has none.
            progress: Called with how many hypotheses are fitted, and 0: of how many is not known.
        """
        self.prior = prior_of(tree)
        self.frame = frame_of(mapping)
        self.instants = sample(recording)
        self.fits: dict[tuple[Hypothesis, ...], HypothesisFit] = {}
        self._recording, self._progress, self._cutoff = recording, progress, CUTOFF
        self._offset = position_offset(tree, mapping)
        self._has_plate = recording.wrench is not None

    def best(self) -> tuple[Explanation, list[Explanation]]:
        """The recording as it is, and what explains it, the best first."""
        first = self._first()
        as_recorded = first.as_read.after_plate().as_recorded()
        if first.fine:
            return as_recorded, [as_recorded]
        several = ranked(self._explanations(first))
        nearest = several[0].fit
        if self._has_plate and _moves_zero(nearest):
            several = ranked([*several, *self._refine(nearest).explanations])
        several = list({each.hypotheses: each for each in several[::-1]}.values())[::-1]
        return as_recorded, ranked(each.after_plate() for each in several[:MOST])

    def _first(self) -> HypothesisFit:
        """The recording as it is; below a lower frequency where noise hides it above."""
        assert self.instants is not None
        first = self._fit((), self.instants)
        if not self._has_plate or first.as_read.explained or _nearest(first).shown:
            return first
        slow = sample(self._recording, cutoff=SLOW)
        if slow is None:
            return first
        calm = HypothesisFit(self.prior, self.frame, (), slow)
        if not _nearest(calm).shown or _nearest(calm).cost > _nearest(first).cost - APART:
            return first
        self.instants, self._cutoff, self.fits[()] = slow, SLOW, calm
        return calm

    def undecided(self) -> list[Hypothesis]:
        """Those about positions alone by which the recording is about as likely as it is.

        But for such as change nothing at all: a zero about an axis along gravity is a name.
        """
        first = self.fits[()]
        most = APART if self._has_plate else ROUGHLY_APART
        gains = {each: first.misfit - fit.misfit for each, fit in self.fits.items()}
        return [
            each[0]
            for each, gain in gains.items()
            if len(each) == 1 and gain > -most and abs(gain) > NOTHING
        ]

    def _fit(self, hypotheses: tuple[Hypothesis, ...], instants: Instants) -> HypothesisFit:
        """A fit, made once."""
        if hypotheses not in self.fits:
            self.fits[hypotheses] = HypothesisFit(self.prior, self.frame, hypotheses, instants)
        return self.fits[hypotheses]

    def _apply(self, beside: HypothesisFit, hypothesis: Hypothesis) -> HypothesisFit | None:
        """A fit by one hypothesis more about positions or clocks; None where it is no motion."""
        hypotheses = (*beside.hypotheses, hypothesis)
        if hypothesis.kind in AFRESH:
            instants = self._sample_afresh(hypotheses)
        else:
            instants = self._transform(beside.instants, hypothesis)
        return None if instants is None else self._fit(hypotheses, instants)

    def _transform(self, instants: Instants, hypothesis: Hypothesis) -> Instants:
        return instants.transform(*joint_map(hypothesis, self.prior.tree.n, self._offset))

    def _sample_afresh(self, hypotheses: tuple[Hypothesis, ...]) -> Instants | None:
        """Instants by hypotheses that change what is read when, or how a base stands."""
        recording, late = self._recording, 0.0
        for each in hypotheses:
            if each.kind == "late":
                late += each.values[0]
            if each.kind == "quaternion_order":
                base, joints = np.split(recording.position, [FREE], axis=1)
                pose = poses(base)
                pose[:, 3:] = pose[:, 3:][:, list(each.values)]
                try:
                    position = np.hstack([coordinates(pose), joints])
                except RecordingError:  # the base would stand on its head
                    return None
                recording = replace(recording, position=position)
        instants = sample(recording, late, self._cutoff)
        for each in hypotheses:
            if instants is not None and each.kind not in AFRESH:
                instants = self._transform(instants, each)
        return instants

    def _explanations(self, first: HypothesisFit) -> list[Explanation]:
        """What may explain it; no more once all is explained."""
        several = [first.as_read]
        for more in self._stages(first, several):
            several += more
            likeliest = min(several, key=lambda each: each.cost)
            if self._has_plate and likeliest.explained:
                after = likeliest.after_plate()
                if not after.odd_torques(SIGMAS):
                    several += self._with_signs(after)
                    break
        return several

    def _with_signs(self, after: Explanation) -> list[Explanation]:
        """What explains it with other senses of the positions whose torques are unclear."""
        same = {joint for each in after.fit.hypotheses for joint in each.joints
                 if each.kind == "position_sign"}  # fmt: skip
        signs = [Hypothesis("position_sign", (joint,)) for joint in sorted(after.unclear - same)]
        fits = (self._apply(after.fit, each) for each in signs)
        return [each for fit in fits if fit is not None for each in fit.explanations]

    def _stages(
        self, first: HypothesisFit, several: list[Explanation]
    ) -> Iterator[list[Explanation]]:
        """Explanations from the simple to the rare.

        Args:
            first: The positions as they were read.
            several: All explanations before.
        """
        tree = self.prior.tree
        hypotheses = list(position_hypotheses(tree, first.instants.position, ()))
        yield first.explanations
        units = [each for each in hypotheses if each.kind in UNITS]
        self._look(first, units)
        if units:  # without them the fits are those that were judged
            yield self._promising()
        explained = any(each.explained for each in several)
        in_time = None if explained else self._in_time(first)
        if in_time is None:
            self._look(first, hypotheses)
            in_time = None if explained else self._in_time(first)
        if in_time is not None:
            yield from self._stages(in_time, several)
            return
        if not self._has_plate:
            yield self._promising()
            plain = [each.cost for each in several if not each.sized]
            if several[0].sized and min(plain, default=np.inf) > several[0].cost - DOUBTED:
                del several[1:]  # torques of another size leave little to judge of the rest
                return
            if not several[0].torques_explained(CLOSE):
                yield self._at_best_zeros(2)
            likeliest = min(several, key=lambda each: each.cost)
            gain = several[0].as_recorded().cost - likeliest.cost
            if gain < DOUBTED or likeliest.torques_explained(GOOD):
                return
        yield self._promising()
        likeliest = min(several, key=lambda each: each.cost)
        if self._has_plate and first.plate.mixed(likeliest.plate.unexplained):
            return  # positions are right where only a matrix explains the plate
        self._look(first, rarer_hypotheses(tree, pairs=not self._has_plate))
        yield self._at_best_zeros(3)
        for each in self._nearest(2 if self._has_plate else 4):
            self._look(each, position_hypotheses(tree, each.instants.position, each.hypotheses))
        yield self._promising()

    def _in_time(self, first: HypothesisFit) -> HypothesisFit | None:
        """The same with the plate's clock set, where a fit shows that it is late, or early."""
        if first.hypotheses or not self._has_plate:
            return None
        late, times = min((each.plate.delay for each in self.fits.values()), key=lambda d: d[1])
        if times > LATE:
            return None
        return self._apply(first, Hypothesis("late", (), (late,)))

    def _look(self, beside: HypothesisFit, hypotheses: Iterable[Hypothesis]) -> None:
        """Fit further hypotheses, except those that a few instants refute."""
        several = list(hypotheses)
        step = len(beside.instants.position) // COARSE
        few = beside.instants.every(max(step, 1))
        coarse = step > 1 and len(several) > 1 and not self._has_plate
        known = self._misfit(beside, few) if coarse else 0.0
        for each in several:
            changed = None
            if coarse and each.kind not in AFRESH:
                changed = self._transform(few, each)
            if changed is None or self._misfit(beside, changed) < known + REFUTED:
                self._apply(beside, each)
            if self._progress is not None:
                self._progress(len(self.fits), 0)

    def _misfit(self, beside: HypothesisFit, instants: Instants) -> float:
        return HypothesisFit(self.prior, self.frame, beside.hypotheses, instants).misfit

    def _nearest(self, count: int) -> list[HypothesisFit]:
        return sorted(self.fits.values(), key=lambda each: each.bound)[:count]

    def _promising(self) -> list[Explanation]:
        """What the nearest fits leave, but for those that no map of a plate explains as well."""
        nearest = self._nearest(JUDGED)
        most = MUCH * min(each.plate.least for each in nearest) + EXPLAINED
        return [each for fit in nearest if fit.plate.least <= most for each in fit.explanations]

    def _at_best_zeros(self, count: int) -> list[Explanation]:
        fits = [self._refine(each) for each in self._nearest(count) if _moves_zero(each)]
        return list(chain.from_iterable(each.explanations for each in fits))

    def _refine(self, fit: HypothesisFit) -> HypothesisFit:
        """A fit whose last zero is the best angle, not one that was tried."""
        *before, last = fit.hypotheses
        for step in STEPS:
            nearer = True
            while nearer:
                added = Hypothesis("zero", last.joints, (step,) * len(last.joints))
                angles = tuple(round(angle + step, 6) for angle in last.values)
                moved = replace(last, values=angles)
                instants = self._transform(fit.instants, added)
                trial = self._fit((*before, moved), instants)
                nearer = trial.misfit < fit.misfit
                if nearer:
                    fit, last = trial, moved
        return fit


def _nearest(fit: HypothesisFit) -> PlateExplanation:
    """The plate's best explanation, the positions being as they are."""
    return min(fit.plate.explanations, key=lambda each: each.cost)


def _moves_zero(fit: HypothesisFit) -> bool:
    """Whether its last hypothesis is another zero."""
    return bool(fit.hypotheses) and fit.hypotheses[-1].kind == "zero"
