"""Search for hypotheses that explain a recording, from simple to rare hypotheses."""

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
    MIN_HYPOTHESIS_GAIN,
    Explanation,
    HypothesisFit,
    rank_explanations,
)
from testbed.importing.check.instants import low_passed_instants
from testbed.importing.check.plate import EXPLAINED_SHARE
from testbed.importing.check.plate_frame import plate_frame_of
from testbed.importing.check.prior import ScaledPrior
from testbed.importing.check.remedies import (
    DEGREES_THRESHOLD,
    MAX_SEARCHED_JOINTS,
    RADIANS_THRESHOLD,
    USUAL_ZERO_OFFSETS,
    Hypothesis,
    candidate_orders,
    corrected_positions,
    joints_without_free_base,
    position_offset,
)

Progress = Callable[[int, int], None]
"""Callback with the number of fitted hypotheses and their total, 0 if unknown."""

MAX_RESIDUAL_RATIO = 20.0
"""Largest ratio of a fit's residual under the best linear map to the least of all fits."""

MAX_EVALUATED_FITS = 4
"""Number of fits whose maps of the plate are evaluated: those with the least misfit."""

MAX_EXPLANATIONS = 6
"""Largest number of explanations, the best first."""

UNIT_KINDS = ("degrees", "radians", "base_unit", "quaternion_order")
"""Kinds of hypotheses on all joints together, which are tested before single joints."""

MIN_EFFECT = 1e-6
"""Least change of the cost by a hypothesis that has an effect at all [nats]."""

MAX_ZERO_STEP, ZERO_TOLERANCE = np.deg2rad([25.0, 0.5])
"""Largest change of a zero in its refinement, and tolerance of the result [rad]."""


RARE_ZEROS = tuple(np.deg2rad([-135, -45, 45, 135]).tolist())
"""Changes of zeros by odd multiples of 45 degrees [rad]."""

BASE_UNITS = (1e-3, 1e-2, 1e2, 1e3)
"""Factors by which positions of a base may be too large: mm or cm for m, and inverse."""

SCALAR_LAST = (3, 0, 1, 2)
"""Indices of w, x, y, z in a quaternion stored as x, y, z, w."""


class Search:
    """Search for explanations of a recording, with a cache of all fits.

    An explanation is a map of the plate's channels together with hypotheses on mapping errors.

    Attributes:
        prior: Prior of the robot's parameters.
        frame: Frame and units of the plate according to the mapping.
        first: Fit without hypotheses; None if the recording is too short.
        fits: Fits, keyed by their hypotheses on positions and clocks.
    """

    def __init__(
        self,
        tree: Tree,
        recording: Recording,
        mapping: Mapping[str, Any],
        cutoff: float,
        progress: Progress | None,
    ) -> None:
        """Fit the recording without hypotheses.

        Args:
            tree: Robot, with approximately right masses.
            recording: Recording in the robot's order of joints.
            mapping: Content of the recording's mapping file; empty if there is no mapping.
            cutoff: Cutoff frequency of the low-pass filter [Hz].
            progress: Callback with the number of fitted hypotheses, and with 0 as the unknown
                total.
        """
        self.prior = ScaledPrior(tree)
        self.frame = plate_frame_of(mapping)
        self.fits: dict[tuple[Hypothesis, ...], HypothesisFit] = {}
        self._recording, self._progress, self._cutoff = recording, progress, cutoff
        self._offset = position_offset(tree, mapping)
        self.first = self._fit()

    def find_best_explanations(self) -> tuple[Explanation, list[Explanation]]:
        """Explanation with the plate as recorded, and the best explanations in order.

        At most `MAX_EXPLANATIONS` are returned, sorted by penalised cost. If the last hypothesis of
        the best fit is another joint zero, this zero is optimised. The search is skipped if the
        robot explains the plate as recorded.
        """
        initial = self.first
        assert initial is not None
        as_read = initial.explanation_as_read
        if as_read.plate.is_explained():
            return as_read, [as_read]
        explanations = rank_explanations(self._explanations(initial))
        nearest = explanations[0].fit
        if _moves_zero(nearest):
            explanations = rank_explanations(
                [*explanations, *self._refine(nearest).explanations]
            )
        explanations = list(
            {each.hypotheses: each for each in explanations[::-1]}.values()
        )[::-1]
        return as_read, rank_explanations(explanations[:MAX_EXPLANATIONS])

    def explanations_with_reversed_joints(
        self, best: Explanation, joints: Iterable[int]
    ) -> Iterator[Explanation]:
        """Yield explanations of equal plate cost in which one joint's position sign is reversed.

        Costs are equal if they exceed the cost of the best explanation by less than
        `MIN_HYPOTHESIS_GAIN`.

        Args:
            best: Best explanation.
            joints: Indices of the candidate joints.
        """
        for joint in joints:
            sign = Hypothesis("position_sign", (joint,))
            fit = self._fit(*best.fit.hypotheses, sign)
            if fit is None or sign in best.fit.hypotheses:
                continue
            other = _likeliest_explanation([fit.explanation_as_read, *fit.explanations])
            if other.cost < best.cost + MIN_HYPOTHESIS_GAIN:
                yield other

    def undetermined_hypotheses(self) -> list[Hypothesis]:
        """Single position hypotheses under which the data are about equally likely.

        Their cost exceeds the cost of the positions as recorded by less than `MIN_HYPOTHESIS_GAIN`.
        Hypotheses without any effect are omitted: a zero about an axis along gravity is equivalent
        to other parameters.
        """
        misfit = self.fits[()].approximate_cost
        increases = {
            each: fit.approximate_cost - misfit
            for each, fit in self.fits.items()
            if len(each) == 1
        }
        return [
            each
            for (each,), increase in increases.items()
            if increase < MIN_HYPOTHESIS_GAIN and abs(increase) > MIN_EFFECT
        ]

    def _fit(self, *hypotheses: Hypothesis) -> HypothesisFit | None:
        """Fit under hypotheses on positions and clocks, with caching.

        The result is None if the corrected base orientation is singular or the recording is too
        short.
        """
        if hypotheses not in self.fits:
            position, delay = self._recording.position, 0.0
            for each in hypotheses:
                if each.kind == "late":
                    delay += each.values[0]
                    continue
                try:
                    position = corrected_positions(each, position, self._offset)
                except RecordingError:  # singular orientation of the base
                    return None
            moved = replace(self._recording, position=position)
            instants = low_passed_instants(moved, delay, self._cutoff)
            if instants is None:
                return None
            self.fits[hypotheses] = HypothesisFit(
                self.prior, self.frame, hypotheses, instants
            )
            if self._progress is not None:
                self._progress(len(self.fits), 0)
        return self.fits[hypotheses]

    def _explanations(self, first: HypothesisFit) -> list[Explanation]:
        """Explanations from successive search stages, up to the first that explains the wrench.

        Args:
            first: Fit without hypotheses.
        """
        explanations = [first.explanation_as_read]
        for stage in self._stages(first, explanations):
            explanations += stage
            if _likeliest_explanation(explanations).plate.is_explained():
                break
        return explanations

    def _stages(
        self, first: HypothesisFit, explanations: list[Explanation]
    ) -> Iterator[list[Explanation]]:
        """Yield explanations from each stage of the search, from simple to rare hypotheses.

        The stages are: the plate alone; units of positions; single hypotheses on positions; joint
        zeros shifted by odd multiples of 45 deg, optimised; two hypotheses on positions. If the
        plate turns out to be delayed, the stages start again with the delay corrected.

        Args:
            first: Fit with the positions as recorded.
            explanations: Explanations from all previous stages, updated by the caller.
        """
        tree = self.prior.tree
        yield first.explanations
        hypotheses = list(position_hypotheses(tree, first.instants.motion.q, ()))
        units = [each for each in hypotheses if each.kind in UNIT_KINDS]
        for tested in (units, hypotheses):
            self._fit_each(first, tested)
            synchronised = self._fit_with_delay(first, explanations)
            if synchronised is not None:
                yield from self._stages(synchronised, explanations)
                return
            yield self._promising_explanations()
        if first.plate.has_crosstalk(
            _likeliest_explanation(explanations).plate.unexplained
        ):
            return  # positions are right where only a matrix explains the plate
        self._fit_each(first, oblique_zero_hypotheses(tree))
        yield self._refined_explanations(3)
        for each in self._nearest_fits(2):
            self._fit_each(
                each, position_hypotheses(tree, each.instants.motion.q, each.hypotheses)
            )
        yield self._promising_explanations()

    def _fit_with_delay(
        self, first: HypothesisFit, explanations: Sequence[Explanation]
    ) -> HypothesisFit | None:
        """Fit with the plate's delay corrected; None if no delay is significant.

        The delay is taken from the fit with the least ratio of residuals. The result is also None
        if an explanation already explains the plate, or if the first fit has hypotheses.
        """
        explained = any(each.plate.is_explained() for each in explanations)
        if first.hypotheses or explained:
            return None
        delay, _ = min(
            (each.plate.delay for each in self.fits.values()), key=lambda d: d[1]
        )
        return self._fit(Hypothesis("late", (), (delay,))) if delay else None

    def _fit_each(
        self, fit_before: HypothesisFit, hypotheses: Iterable[Hypothesis]
    ) -> list[HypothesisFit]:
        """Fits with the hypotheses of a given fit and one additional hypothesis each.

        Args:
            fit_before: Fit with the given hypotheses.
            hypotheses: Additional hypotheses.
        """
        fits = [self._fit(*fit_before.hypotheses, each) for each in hypotheses]
        return [each for each in fits if each is not None]

    def _nearest_fits(self, count: int) -> list[HypothesisFit]:
        """Given number of fits with the least approximate cost, in increasing order."""
        return sorted(self.fits.values(), key=lambda each: each.approximate_cost)[
            :count
        ]

    def _promising_explanations(self) -> list[Explanation]:
        """Explanations of the four fits with the least approximate cost.

        Fits are omitted if their residual share exceeds 20 times the least residual share by more
        than 0.1 %.
        """
        nearest = self._nearest_fits(MAX_EVALUATED_FITS)
        largest_residual = (
            MAX_RESIDUAL_RATIO
            * min(each.plate.least_residual_share for each in nearest)
            + EXPLAINED_SHARE
        )
        return [
            each
            for fit in nearest
            if fit.plate.least_residual_share <= largest_residual
            for each in fit.explanations
        ]

    def _refined_explanations(self, count: int) -> list[Explanation]:
        """Explanations of the nearest fits with optimised joint zeros.

        Args:
            count: Number of fits with the least approximate cost; those whose last hypothesis is a
                joint zero are refined.
        """
        fits = [
            self._refine(each)
            for each in self._nearest_fits(count)
            if _moves_zero(each)
        ]
        return [each for fit in fits for each in fit.explanations]

    def _refine(self, fit: HypothesisFit) -> HypothesisFit:
        """Fit with the last joint zero optimised, within 25 deg, for the least cost."""
        from scipy.optimize import minimize_scalar

        *others, last = fit.hypotheses

        def shifted_fit(step: float) -> HypothesisFit:
            angles = tuple(round(angle + step, 6) for angle in last.values)
            return self._fit(*others, replace(last, values=angles)) or fit

        best = minimize_scalar(
            lambda step: shifted_fit(step).approximate_cost,
            bounds=(-MAX_ZERO_STEP, MAX_ZERO_STEP),
            options={"xatol": ZERO_TOLERANCE},
        )
        return min(
            fit, shifted_fit(float(best.x)), key=lambda each: each.approximate_cost
        )


def _likeliest_explanation(explanations: Sequence[Explanation]) -> Explanation:
    """Explanation with the least cost."""
    return min(explanations, key=lambda each: each.cost)


def _moves_zero(fit: HypothesisFit) -> bool:
    """Test whether the last hypothesis of a fit is another joint zero."""
    return bool(fit.hypotheses) and fit.hypotheses[-1].kind == "zero"


def position_hypotheses(
    tree: Tree, position: Array, applied: Sequence[Hypothesis]
) -> Iterator[Hypothesis]:
    """Yield hypotheses on units, signs, zeros and order of the joint positions.

    Degrees or radians are proposed only if the size of the motion makes them plausible. Zeros
    shifted by 90 or 180 deg, and orders, are proposed only for robots of at most 12 joints. A free
    base adds hypotheses on its unit and on the order of its quaternion.

    Args:
        tree: Robot.
        position: Joint positions, (T, n) [rad or m], at T instants.
        applied: Hypotheses already applied.
    """
    joints = joints_without_free_base(tree)
    revolute = [k for k in joints if tree.joints[k].revolute]
    kinds = {each.kind for each in applied}
    if revolute and not kinds & {"degrees", "radians"}:
        if np.abs(position[:, revolute]).max() > DEGREES_THRESHOLD:
            yield Hypothesis("degrees", tuple(revolute))
        if np.ptp(position[:, revolute], axis=0).max() < RADIANS_THRESHOLD:
            yield Hypothesis("radians", tuple(revolute))
    if tree.floating and "base_unit" not in kinds:
        yield from (Hypothesis("base_unit", (), (factor,)) for factor in BASE_UNITS)
    if tree.floating and "quaternion_order" not in kinds:
        yield Hypothesis("quaternion_order", (), SCALAR_LAST)
    yield from (Hypothesis("position_sign", (joint,)) for joint in joints)
    if tree.n > MAX_SEARCHED_JOINTS:
        return
    for joint, angle in product(_inner_joints(tree), USUAL_ZERO_OFFSETS):
        yield Hypothesis("zero", (joint,), (angle,))
    for order in candidate_orders(joints):
        affected = tuple(k for k in joints if order[k] != k)
        if all(tree.joints[k].kind == tree.joints[order[k]].kind for k in affected):
            yield Hypothesis("position_order", affected, order)


def oblique_zero_hypotheses(tree: Tree) -> Iterator[Hypothesis]:
    """Yield hypotheses on joint zeros shifted by odd multiples of 45 degrees.

    Args:
        tree: Robot.
    """
    for joint in _inner_joints(tree) if tree.n <= MAX_SEARCHED_JOINTS else []:
        yield from (Hypothesis("zero", (joint,), (angle,)) for angle in RARE_ZEROS)


def _inner_joints(tree: Tree) -> list[int]:
    """Indices of revolute joints that carry other joints.

    For a last joint, another zero is equivalent to other parameters of its body.
    """
    return [
        k
        for k in joints_without_free_base(tree)
        if tree.joints[k].revolute and tree.children(k)
    ]
