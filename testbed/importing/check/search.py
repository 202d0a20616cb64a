"""Which hypotheses explain a recording: fits of its positions, from the simple to the rare."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from testbed.core.base.errors import RecordingError
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree
from testbed.importing.check.explanation import (
    APART,
    ROUGHLY_APART,
    Explanation,
    HypothesisFit,
    ranked,
)
from testbed.importing.check.instants import sample
from testbed.importing.check.plate import EXPLAINED
from testbed.importing.check.plate_frame import frame_of
from testbed.importing.check.prior import ScaledPrior
from testbed.importing.check.remedies import (
    Hypothesis,
    corrected,
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

UNITS = ("degrees", "radians", "base_unit", "quaternion_order")
"""Hypotheses that concern all joints, which are looked at before those of some."""

NOTHING = 1e-6
"""Gain of a hypothesis that changes nothing at all [nats]."""

STEP, FINEST = np.deg2rad([25.0, 0.5])
"""By how much a zero is moved at most, and how well it is found [rad]."""


class Search:
    """All fits of a recording that were made.

    Attributes:
        prior: The robot.
        frame: How the mapping has read the plate.
        first: The recording as it is; None where it is too short.
        fits: By hypotheses about positions and clocks.
    """

    def __init__(
        self,
        tree: Tree,
        recording: Recording,
        mapping: Mapping[str, Any],
        cutoff: float,
        progress: Progress | None,
    ) -> None:
        """Nothing yet.

        Args:
            tree: The robot, its masses roughly right.
            recording: In the order of its joints.
            mapping: What the recording's mapping file says; empty if it has none.
            cutoff: Up to which frequency [Hz].
            progress: Called with how many hypotheses are fitted, and 0: of how many is not known.
        """
        self.prior = ScaledPrior(tree)
        self.frame = frame_of(mapping)
        self.fits: dict[tuple[Hypothesis, ...], HypothesisFit] = {}
        self._recording, self._progress, self._cutoff = recording, progress, cutoff
        self._offset = position_offset(tree, mapping)
        self._has_plate = recording.wrench is not None
        self.first = self._fit()

    def best(self) -> tuple[Explanation, list[Explanation]]:
        """The recording as it is, and what explains it, the best first."""
        first = self.first
        assert first is not None
        as_recorded = first.as_read.after_plate().as_recorded()
        if first.fine:
            return as_recorded, [as_recorded]
        several = ranked(self._explanations(first))
        nearest = several[0].fit
        if self._has_plate and _moves_zero(nearest):
            several = ranked([*several, *self._refine(nearest).explanations])
        several = list({each.hypotheses: each for each in several[::-1]}.values())[::-1]
        return as_recorded, ranked(each.after_plate() for each in several[:MOST])

    def undecided(self) -> list[Hypothesis]:
        """Those about positions alone by which the recording is about as likely as it is.

        But for such as change nothing at all: a zero about an axis along gravity is a name.
        """
        misfit = self.fits[()].misfit
        most = APART if self._has_plate else ROUGHLY_APART
        worse = {
            each: fit.misfit - misfit
            for each, fit in self.fits.items()
            if len(each) == 1
        }
        return [
            each for (each,), by in worse.items() if by < most and abs(by) > NOTHING
        ]

    def _fit(self, *hypotheses: Hypothesis) -> HypothesisFit | None:
        """A fit by hypotheses about positions and clocks, made once; None where it is no motion."""
        if hypotheses not in self.fits:
            position, late = self._recording.position, 0.0
            for each in hypotheses:
                if each.kind == "late":
                    late += each.values[0]
                    continue
                try:
                    position = corrected(each, position, self._offset)
                except RecordingError:  # a base would stand on its head
                    return None
            moved = replace(self._recording, position=position)
            instants = sample(moved, late, self._cutoff)
            if instants is None:
                return None
            self.fits[hypotheses] = HypothesisFit(
                self.prior, self.frame, hypotheses, instants
            )
            if self._progress is not None:
                self._progress(len(self.fits), 0)
        return self.fits[hypotheses]

    def _explanations(self, first: HypothesisFit) -> list[Explanation]:
        """What may explain it; no more once all is explained."""
        several = [first.as_read]
        for more in self._stages(first, several):
            several += more
            likeliest = _likeliest(several)
            if self._has_plate and likeliest.explained:
                after = likeliest.after_plate()
                if not after.odd_torques(SIGMAS):
                    return several + self._with_signs(after)
        return several

    def _with_signs(self, after: Explanation) -> list[Explanation]:
        """What explains it with other senses of the positions whose torques are unclear."""
        signs = [
            Hypothesis("position_sign", (joint,)) for joint in sorted(after.unclear)
        ]
        signs = [each for each in signs if each not in after.fit.hypotheses]
        return [
            each for fit in self._look(after.fit, signs) for each in fit.explanations
        ]

    def _stages(
        self, first: HypothesisFit, several: list[Explanation]
    ) -> Iterator[list[Explanation]]:
        """Explanations from the simple to the rare.

        Args:
            first: The positions as they were read.
            several: All explanations before.
        """
        tree = self.prior.tree
        yield first.explanations
        hypotheses = list(position_hypotheses(tree, first.instants.motion.q, ()))
        units = [each for each in hypotheses if each.kind in UNITS]
        for looked_at in (units, hypotheses):
            self._look(first, looked_at)
            in_time = self._in_time(first, several)
            if in_time is not None:
                yield from self._stages(in_time, several)
                return
            yield self._promising()
        as_read = several[0]
        if not self._has_plate:
            plain = [each.cost for each in several if not each.sized]
            if as_read.sized and min(plain, default=np.inf) > as_read.cost - DOUBTED:
                # torques of another size leave little to judge of the rest
                del several[1:]
                return
            if not as_read.torques_explained(CLOSE):
                yield self._at_best_zeros(2)
            likeliest = _likeliest(several)
            gain = as_read.as_recorded().cost - likeliest.cost
            if gain < DOUBTED or likeliest.torques_explained(GOOD):
                return
        elif first.plate.mixed(_likeliest(several).plate.unexplained):
            return  # positions are right where only a matrix explains the plate
        self._look(first, rarer_hypotheses(tree, pairs=not self._has_plate))
        yield self._at_best_zeros(3)
        for each in self._nearest(2 if self._has_plate else 4):
            self._look(
                each, position_hypotheses(tree, each.instants.motion.q, each.hypotheses)
            )
        yield self._promising()

    def _in_time(
        self, first: HypothesisFit, several: Sequence[Explanation]
    ) -> HypothesisFit | None:
        """The same with the plate's clock set, where a fit shows that it is late, or early."""
        explained = any(each.explained for each in several)
        if first.hypotheses or not self._has_plate or explained:
            return None
        late, _ = min(
            (each.plate.delay for each in self.fits.values()), key=lambda d: d[1]
        )
        return self._fit(Hypothesis("late", (), (late,))) if late else None

    def _look(
        self, beside: HypothesisFit, hypotheses: Iterable[Hypothesis]
    ) -> list[HypothesisFit]:
        """Fits by one hypothesis more each."""
        fits = [self._fit(*beside.hypotheses, each) for each in hypotheses]
        return [each for each in fits if each is not None]

    def _nearest(self, count: int) -> list[HypothesisFit]:
        return sorted(self.fits.values(), key=lambda each: each.misfit)[:count]

    def _promising(self) -> list[Explanation]:
        """What the nearest fits leave, but for those that no map of a plate explains as well."""
        nearest = self._nearest(JUDGED)
        most = MUCH * min(each.plate.least for each in nearest) + EXPLAINED
        return [
            each
            for fit in nearest
            if fit.plate.least <= most
            for each in fit.explanations
        ]

    def _at_best_zeros(self, count: int) -> list[Explanation]:
        fits = [
            self._refine(each) for each in self._nearest(count) if _moves_zero(each)
        ]
        return [each for fit in fits for each in fit.explanations]

    def _refine(self, fit: HypothesisFit) -> HypothesisFit:
        """A fit whose last zero is the best angle, not one that was tried."""
        from scipy.optimize import minimize_scalar

        *before, last = fit.hypotheses

        def moved(step: float) -> HypothesisFit:
            angles = tuple(round(angle + step, 6) for angle in last.values)
            return self._fit(*before, replace(last, values=angles)) or fit

        best = minimize_scalar(
            lambda step: moved(step).misfit,
            bounds=(-STEP, STEP),
            options={"xatol": FINEST},
        )
        return min(fit, moved(float(best.x)), key=lambda each: each.misfit)


def _likeliest(explanations: Sequence[Explanation]) -> Explanation:
    return min(explanations, key=lambda each: each.cost)


def _moves_zero(fit: HypothesisFit) -> bool:
    """Whether its last hypothesis is another zero."""
    return bool(fit.hypotheses) and fit.hypotheses[-1].kind == "zero"
