"""Which hypotheses explain a recording: fits of its positions, from the simple to the rare."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree
from testbed.importing.check.explanation import (
    APART,
    Explanation,
    HypothesisFit,
    ranked,
)
from testbed.importing.check.instants import sample
from testbed.importing.check.plate import EXPLAINED
from testbed.importing.check.plate_frame import frame_of
from testbed.importing.check.prior import ScaledPrior
from testbed.importing.check.remedies import (
    BEYOND,
    LITTLE,
    MOST_JOINTS,
    QUARTERS,
    Hypothesis,
    corrected,
    orders,
    own_joints,
    position_offset,
)

Progress = Callable[[int, int], None]

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


SCANNED = tuple(np.deg2rad([-135, -45, 45, 135]).tolist())
"""Other zeros to try [rad]."""

BASE_UNITS = (1e-3, 1e-2, 1e2, 1e3)
"""Times that a base's positions are taken too small or too large: mm or cm for m."""

SCALAR_LAST = (3, 0, 1, 2)
"""Where w, x, y, z of a quaternion stand that is x, y, z, w."""


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
        self.first = self._fit()

    def best(self) -> tuple[Explanation, list[Explanation]]:
        """The plate as it is read, and what explains it, the best first."""
        first = self.first
        assert first is not None
        as_read = first.as_read
        if as_read.plate.explained():
            return as_read, [as_read]
        several = ranked(self._explanations(first))
        nearest = several[0].fit
        if _moves_zero(nearest):
            several = ranked([*several, *self._refine(nearest).explanations])
        several = list({each.hypotheses: each for each in several[::-1]}.values())[::-1]
        return as_read, ranked(several[:MOST])

    def with_senses(
        self, best: Explanation, joints: Iterable[int]
    ) -> Iterator[Explanation]:
        """Yield explanations with one joint's position sign reversed, of equal plate cost.

        Args:
            best: The likeliest.
            joints: Indices of those that are tried.
        """
        for joint in joints:
            sign = Hypothesis("position_sign", (joint,))
            fit = self._fit(*best.fit.hypotheses, sign)
            if fit is None or sign in best.fit.hypotheses:
                continue
            other = _likeliest([fit.as_read, *fit.explanations])
            if other.cost < best.cost + APART:
                yield other

    def undecided(self) -> list[Hypothesis]:
        """Those about positions alone by which the recording is about as likely as it is.

        But for such as change nothing at all: a zero about an axis along gravity is a name.
        """
        misfit = self.fits[()].misfit
        worse = {
            each: fit.misfit - misfit
            for each, fit in self.fits.items()
            if len(each) == 1
        }
        return [
            each for (each,), by in worse.items() if by < APART and abs(by) > NOTHING
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
            if _likeliest(several).plate.explained():
                break
        return several

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
        if first.plate.mixed(_likeliest(several).plate.unexplained):
            return  # positions are right where only a matrix explains the plate
        self._look(first, rarer_hypotheses(tree))
        yield self._at_best_zeros(3)
        for each in self._nearest(2):
            self._look(
                each, position_hypotheses(tree, each.instants.motion.q, each.hypotheses)
            )
        yield self._promising()

    def _in_time(
        self, first: HypothesisFit, several: Sequence[Explanation]
    ) -> HypothesisFit | None:
        """The same with the plate's clock set, where a fit shows that it is late, or early."""
        explained = any(each.plate.explained() for each in several)
        if first.hypotheses or explained:
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


def position_hypotheses(
    tree: Tree, position: Array, beside: Sequence[Hypothesis]
) -> Iterator[Hypothesis]:
    """Yield hypotheses on position units, signs, zeros and joint orders.

    Args:
        tree: The robot.
        position: (T, n) [rad or m].
        beside: Hypotheses that hold.
    """
    own = own_joints(tree)
    turning = [k for k in own if tree.joints[k].revolute]
    before = {each.kind for each in beside}
    if turning and not before & {"degrees", "radians"}:
        if np.abs(position[:, turning]).max() > BEYOND:
            yield Hypothesis("degrees", tuple(turning))
        if np.ptp(position[:, turning], axis=0).max() < LITTLE:
            yield Hypothesis("radians", tuple(turning))
    if tree.floating and "base_unit" not in before:
        yield from (Hypothesis("base_unit", (), (factor,)) for factor in BASE_UNITS)
    if tree.floating and "quaternion_order" not in before:
        yield Hypothesis("quaternion_order", (), SCALAR_LAST)
    yield from (Hypothesis("position_sign", (joint,)) for joint in own)
    if tree.n > MOST_JOINTS:
        return
    for joint, angle in product(_inner_joints(tree), QUARTERS):
        yield Hypothesis("zero", (joint,), (angle,))
    for order in orders(own):
        moved = tuple(k for k in own if order[k] != k)
        if all(tree.joints[k].kind == tree.joints[order[k]].kind for k in moved):
            yield Hypothesis("position_order", moved, order)


def rarer_hypotheses(tree: Tree) -> Iterator[Hypothesis]:
    """Yield hypotheses on joint zeros by odd multiples of 45 degrees.

    Args:
        tree: The robot.
    """
    for joint in _inner_joints(tree) if tree.n <= MOST_JOINTS else []:
        yield from (Hypothesis("zero", (joint,), (angle,)) for angle in SCANNED)


def _inner_joints(tree: Tree) -> list[int]:
    """Joints that turn and carry others: the last one's zero only renames its body's parameters."""
    return [k for k in own_joints(tree) if tree.joints[k].revolute and tree.children(k)]
