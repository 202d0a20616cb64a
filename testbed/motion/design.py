"""Design of an excitation trajectory as the best proven result of several searches.

Each search starts from a random motion inside all limits, with one of the allowed frequencies. If
the proof fails between the samples of a search, the amplitudes are reduced slightly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import NoFeasibleMotion
from testbed.core.base.stages import ignore_progress
from testbed.core.parameters.rules import Signal
from testbed.motion.clearance import ClearanceTerm
from testbed.motion.fourier import Fourier
from testbed.motion.information import DesignObjective, SignalProcessing
from testbed.motion.problem import InteriorPointProblem, Series, interior_point_minimum
from testbed.motion.proof import MotionConstraints, Proof, prove
from testbed.motion.random_motion import draw_random_series, rest_posture
from testbed.motion.samples import SampledRows, derivative_stencil
from testbed.motion.terms import ForceTerm

MAX_DRAWS = 60
"""Largest number of random motions tried for a feasible initial motion."""
AMPLITUDE_SHARES = 0.8 ** np.arange(1, 16)
"""Amplitude factors of a random motion, in descending order."""
PROOF_SHARES = (1.0, 0.998, 0.995, 0.99, 0.98, 0.96, 0.93, 0.88, 0.8)
"""Amplitude factors for which a proof is tried."""
EXTRA_CLEARANCE_SHARE, MIN_EXTRA_CLEARANCE = 0.25, 2e-4
"""Extra clearance of a search beyond the clearance to be proven: relative value, and smallest
absolute value [m]."""
MIN_STEPS, MAX_CRITERION_LAG = 30, 2 * np.log(1.25)
"""Number of steps, and excess of the criterion over that of the best search, from which a search is
ended."""
MIN_SAMPLES, SAMPLES_PER_HARMONIC = 80, 16
"""Smallest number of samples of a period in a search, in total and per harmonic."""

SearchCallback = Callable[[int, int, float], None]
"""Callback with the number of finished searches, the number of all searches and the best criterion
so far."""


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """Limits of a motion, parameters to be identified, instruments and searches.

    Attributes:
        rules: Limits that the motion respects.
        information: Unknowns and criterion; the prior information is divided by the number of
            samples.
        rows: Sampled rows of the models that rules and information need.
        pipeline: Filters and duration of the planned recording.
        frequencies: Pairs of fundamental frequency [Hz] and number of harmonics, used by the
            searches in turn.
        search_count: Number of searches.
        seed: Seed of the random motions from which searches start.
    """

    rules: MotionConstraints
    information: DesignObjective
    rows: Mapping[Signal, SampledRows]
    pipeline: SignalProcessing
    frequencies: tuple[tuple[float, int], ...]
    search_count: int = 6
    seed: int = 0

    @cached_property
    def centre_posture(self) -> Array:
        """Centre posture of the second half of the initial motions tried, (n,) [rad or m]."""
        return rest_posture(self.rules)


@dataclass(frozen=True, eq=False)
class Design:
    """Result of a design: motion, criterion and proof.

    Attributes:
        motion: The motion.
        value: Criterion for one sample, the logarithm of a variance: exp(value / 2) is a relative
            standard deviation.
        proof: Margins of all limits.
        searches: Number of searches made.
        is_complete: True if all searches were made without interruption.
    """

    motion: Fourier
    value: float
    proof: Proof
    searches: int
    is_complete: bool


def design(
    problem: DesignProblem,
    watch: SearchCallback = ignore_progress,
    interrupted: Callable[[], bool] = lambda: False,
) -> Design:
    """Find the best motion of several searches that is proven to respect all limits.

    Args:
        problem: Limits, unknowns and searches.
        watch: Callback after every step of a search.
        interrupted: Callback after every step; True stops the design with the best motion so far.

    Raises:
        NoFeasibleMotion: No motion inside the limits was found; the message names the critical
            limit.
    """
    progress = _SearchProgress(problem.search_count, watch, interrupted)
    results: list[tuple[float, Fourier]] = []
    while len(results) < problem.search_count and not progress.stopped:
        search, x = _initial_search(problem, len(results))
        log_samples = float(
            np.log(search.series.instants)
        )  # the criterion is for one sample
        optimum = interior_point_minimum(
            search, x, stop=partial(progress.step, log_samples)
        )
        value = optimum.value + log_samples
        results.append((value, search.series.motion(optimum.x)))
        progress.finish(value)
    best_first = [motion for _, motion in sorted(results, key=lambda pair: pair[0])]
    motion, proof = _first_proven(problem.rules, best_first)
    value = criterion(problem, motion)
    return Design(motion, value, proof, len(results), not progress.stopped)


def criterion(problem: DesignProblem, motion: Fourier) -> float:
    """Criterion of a given motion for one sample, as `Design.value`.

    Args:
        problem: Limits and unknowns.
        motion: The motion.
    """
    search = _search_problem(problem, motion.fundamental, motion.harmonics)
    value = search.evaluate(search.series.unknowns(motion)).value
    return value + float(np.log(search.series.instants))


class _SearchProgress:
    """Criteria of the searches after every step, and decision to stop a search.

    A search ends when it is interrupted, or after MIN_STEPS steps if its criterion exceeds the
    criterion of the best search at the same step by more than MAX_CRITERION_LAG.
    """

    def __init__(
        self, starts: int, watch: SearchCallback, interrupted: Callable[[], bool]
    ) -> None:
        self._starts, self._watch, self._interrupted = starts, watch, interrupted
        self._done = 0
        self._steps: list[
            float
        ] = []  # criteria by step: current search, then best search
        self._best: list[float] = [np.inf]
        self.stopped = False

    def step(self, level: float, value: float) -> bool:
        """Record a step; return True if the search must stop.

        Args:
            level: Constant added to the search's criterion.
            value: Criterion of the search after the step.
        """
        values = self._steps
        values.append(level + value)
        self._watch(self._done, self._starts, min(self._best[-1], values[-1]))
        self.stopped = self._interrupted()
        best_value = self._best[: len(values)][-1]  # best search at the same step
        return self.stopped or (
            len(values) >= MIN_STEPS and values[-1] > best_value + MAX_CRITERION_LAG
        )

    def finish(self, value: float) -> None:
        """Record the end of a search with its final criterion."""
        self._best = min(self._best, [*self._steps, value], key=lambda steps: steps[-1])
        self._steps, self._done = [], self._done + 1
        self._watch(self._done, self._starts, self._best[-1])


def _search_problem(
    problem: DesignProblem, fundamental: float, harmonics: int
) -> InteriorPointProblem:
    """Optimisation problem for a given fundamental frequency and number of harmonics.

    Clearances are increased by the fraction EXTRA_CLEARANCE_SHARE, but at least by
    MIN_EXTRA_CLEARANCE, so that the proof is likely to succeed.

    Args:
        problem: Design problem.
        fundamental: Fundamental frequency [Hz].
        harmonics: Number of harmonics.
    """
    rules, information = problem.rules, problem.information
    terms: list[ForceTerm | ClearanceTerm] = [*rules.force_limits]
    if rules.collision is not None:
        extra_clearance = np.maximum(
            EXTRA_CLEARANCE_SHARE * rules.clearance, MIN_EXTRA_CLEARANCE
        )
        terms.append(ClearanceTerm(rules.collision, rules.clearance + extra_clearance))
    instants = max(MIN_SAMPLES, SAMPLES_PER_HARMONIC * harmonics)
    return InteriorPointProblem(
        series=Series(rules.limits, fundamental, harmonics, instants, rules.margin),
        information=replace(information, prior=information.prior * instants),
        terms=terms,
        rows=problem.rows,
        stencil=derivative_stencil(rules.tree),
        names=rules.tree.names,
    )


def _initial_search(
    problem: DesignProblem, number: int
) -> tuple[InteriorPointProblem, Array]:
    """Optimisation problem of a search, and a random point strictly inside its limits.

    Args:
        problem: Design problem.
        number: Index of the search.

    Raises:
        NoFeasibleMotion: No feasible motion was found; the message names the critical limit.
    """
    search = _search_problem(
        problem, *problem.frequencies[number % len(problem.frequencies)]
    )
    rng = np.random.default_rng([problem.seed, number])
    trials = []
    for draw in range(MAX_DRAWS):
        # the second half of the trials is about one feasible posture
        centre = problem.centre_posture if 2 * draw >= MAX_DRAWS else None
        motions = list(_scaled_motions(search.series, rng, centre))
        label, instant, excess = search.most_critical_limit(
            search.series.unknowns(motions[-1])
        )
        trials.append((excess, label, instant))
        if excess < 0:  # otherwise even the smallest motion is infeasible
            start = _first_feasible(search, motions)
            if start is not None:
                return search, start
    excess, label, instant = min(trials)
    if excess < 0:
        raise NoFeasibleMotion(
            f"none of {MAX_DRAWS} random motions inside the limits excites all parameters: "
            "some joint "
            "has too little room or is too slow; allow more, or lock it"
        )
    raise NoFeasibleMotion(
        f"no motion inside all limits was found in {MAX_DRAWS} random postures: "
        "even one that hardly "
        f"moves exceeds the limit on {label} by {excess:.2g} of it at t = {instant:.3g} s; correct "
        "the limits or the model, or allow more"
    )


def _scaled_motions(
    series: Series, rng: np.random.Generator, centre: Array | None
) -> Iterator[Fourier]:
    """Yield a random motion with its amplitudes scaled by each of AMPLITUDE_SHARES.

    Args:
        series: Frequencies and limits.
        rng: Random generator.
        centre: Centre posture, (n,) [rad or m]; None for a random posture.
    """
    random_series = draw_random_series(
        series.limits, series.fundamental, series.harmonics, rng
    )
    for share in AMPLITUDE_SHARES:
        motion = random_series.sized(float(share))
        yield motion if centre is None else motion.scaled(float(share), centre)


def _first_feasible(
    search: InteriorPointProblem, motions: Iterable[Fourier]
) -> Array | None:
    """Unknowns of the first motion strictly inside all limits, (n p,), or None.

    There are n joints with p unknowns each. The criterion of the motion must be finite, too.
    """
    unknowns = (search.series.unknowns(motion) for motion in motions)
    return next((x for x in unknowns if search.evaluate(x).is_feasible), None)


def _first_proven(
    rules: MotionConstraints, motions: Iterable[Fourier]
) -> tuple[Fourier, Proof]:
    """First motion with a proof, and the proof; amplitudes are reduced if necessary.

    All factors of PROOF_SHARES are tried for the first motion, then for the second, and so on.

    Args:
        rules: Limits of the motion.
        motions: Motions in the order of preference.

    Raises:
        NoFeasibleMotion: No motion can be proven.
    """
    for motion, share in product(motions, PROOF_SHARES):
        scaled = motion.scaled(share, motion.offset)
        proof = prove(scaled, rules)
        if proof.is_valid:
            return scaled, proof
    raise NoFeasibleMotion(
        f"a motion was found, but not proven between its samples: {proof.smallest_margin.words}"
    )
