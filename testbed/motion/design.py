"""Design of an excitation trajectory: several searches within the limits, the best one proven.

Several searches from random motions inside all limits, each with one of the frequencies that are
allowed; the best result that can be proven. A proof that fails between the samples of the search
is had by a smaller swing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import InfeasibleMotion
from testbed.core.base.stages import unreported
from testbed.core.parameters.rules import Model
from testbed.motion.clearance import ClearanceTerm
from testbed.motion.fourier import Fourier
from testbed.motion.information import DesignObjective, Pipeline
from testbed.motion.problem import InteriorPointProblem, Series, minimise
from testbed.motion.proof import Proof, Rules, prove
from testbed.motion.random_motion import rest_posture, sample
from testbed.motion.samples import SampledRows, stencil
from testbed.motion.terms import ForceTerm

DRAWS = 60
"""Random motions tried for a start inside the limits."""
SHARES = 0.8 ** np.arange(1, 16)
"""Of their swing, largest first."""
SMALLER = (1.0, 0.998, 0.995, 0.99, 0.98, 0.96, 0.93, 0.88, 0.8)
"""Shares of the swing for which a proof is tried."""
ROOM, LEAST_ROOM = 0.25, 2e-4
"""What a search keeps beyond the clearance that is to be proven: a share of it, at least [m]."""
FAIR, BEHIND = 30, 2 * np.log(1.25)
"""A search ends that after so many steps or more is so much behind the best one at that step."""
INSTANTS, DENSITY = 80, 16
"""Samples of a period in a search: at least so many, and so many a harmonic."""

Watch = Callable[[int, int, float], None]
"""Called with searches done, searches in all, and the best criterion so far."""


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """Limits of a motion, parameters to be identified, instruments and searches.

    Attributes:
        rules: Limits that the motion respects.
        information: Unknowns and criterion; the prior is a share of one sample.
        rows: Sampled rows of the models that rules and information need.
        pipeline: Filters and duration of the recording to be made.
        frequencies: Fundamental [Hz] and number of harmonics of the series allowed.
        starts: Number of searches.
        seed: Seed of the random motions that searches start from.
    """

    rules: Rules
    information: DesignObjective
    rows: Mapping[Model, SampledRows]
    pipeline: Pipeline
    frequencies: tuple[tuple[float, int], ...]
    starts: int = 6
    seed: int = 0

    @cached_property
    def rest(self) -> Array:
        """Posture about which few draws are tried, (n,) [rad or m]."""
        return rest_posture(self.rules)


@dataclass(frozen=True, eq=False)
class Design:
    """A motion that may be run, and how it was found.

    Attributes:
        motion: The motion.
        value: Its criterion for one sample: exp(value / 2) is a relative sigma.
        proof: What it leaves of every limit.
        searches: Number of searches made.
        complete: Whether all searches were made, none interrupted.
    """

    motion: Fourier
    value: float
    proof: Proof
    searches: int
    complete: bool


def design(
    problem: DesignProblem,
    watch: Watch = unreported,
    interrupted: Callable[[], bool] = lambda: False,
) -> Design:
    """Find the best motion of several searches that is proven to respect all limits.

    Args:
        problem: Limits, unknowns and searches.
        watch: Called after every step of a search.
        interrupted: Asked after every step whether to go on with the best so far.

    Raises:
        InfeasibleMotion: No motion inside the limits was found; says which is in the way.
    """
    progress = _Progress(problem.starts, watch, interrupted)
    found: list[tuple[float, Fourier]] = []
    while len(found) < problem.starts and not progress.stopped:
        search, x = _start(problem, len(found))
        level = float(np.log(search.series.instants))  # a criterion is one sample's
        reached = minimise(search, x, stop=partial(progress.step, level))
        value = reached.value + level
        found.append((value, search.series.motion(reached.x)))
        progress.finish(value)
    best_first = [motion for _, motion in sorted(found, key=lambda pair: pair[0])]
    motion, proof = _proven(problem.rules, best_first)
    value = criterion(problem, motion)
    return Design(motion, value, proof, len(found), not progress.stopped)


def criterion(problem: DesignProblem, motion: Fourier) -> float:
    """The criterion of any motion for one sample, as `Design.value`."""
    search = _search(problem, motion.fundamental, motion.harmonics)
    value = search.inside(search.series.unknowns(motion)).value
    return value + float(np.log(search.series.instants))


class _Progress:
    """Values that searches reached step by step, and whether to stop one."""

    def __init__(
        self, starts: int, watch: Watch, interrupted: Callable[[], bool]
    ) -> None:
        self._starts, self._watch, self._interrupted = starts, watch, interrupted
        self._done = 0
        self._steps: list[
            float
        ] = []  # of the search that is made, then of the best so far
        self._best: list[float] = [np.inf]
        self.stopped = False

    def step(self, level: float, value: float) -> bool:
        """Whether a search that has reached a value, above a level, must stop."""
        steps = self._steps
        steps.append(level + value)
        self._watch(self._done, self._starts, min(self._best[-1], steps[-1]))
        self.stopped = self._interrupted()
        same = self._best[: len(steps)][-1]  # of the best search at that step
        return self.stopped or (len(steps) >= FAIR and steps[-1] > same + BEHIND)

    def finish(self, value: float) -> None:
        """A search has ended with a value."""
        self._best = min(self._best, [*self._steps, value], key=lambda steps: steps[-1])
        self._steps, self._done = [], self._done + 1
        self._watch(self._done, self._starts, self._best[-1])


def _search(
    problem: DesignProblem, fundamental: float, harmonics: int
) -> InteriorPointProblem:
    """The search with these frequencies."""
    rules, information = problem.rules, problem.information
    terms: list[ForceTerm | ClearanceTerm] = [*rules.terms]
    if rules.collision is not None:
        room = np.maximum(ROOM * rules.clearance, LEAST_ROOM)
        terms.append(ClearanceTerm(rules.collision, rules.clearance + room))
    instants = max(INSTANTS, DENSITY * harmonics)
    return InteriorPointProblem(
        series=Series(rules.limits, fundamental, harmonics, instants, rules.margin),
        information=replace(information, prior=information.prior * instants),
        terms=terms,
        rows=problem.rows,
        stencil=stencil(rules.tree),
        names=rules.tree.names,
    )


def _start(problem: DesignProblem, number: int) -> tuple[InteriorPointProblem, Array]:
    """A search, and a random motion strictly inside its limits.

    Raises:
        InfeasibleMotion: None was found; says what the nearest one exceeds.
    """
    search = _search(problem, *problem.frequencies[number % len(problem.frequencies)])
    rng = np.random.default_rng([problem.seed, number])
    exceeded = []
    for draw in range(DRAWS):
        # few postures are free: about one
        about = problem.rest if 2 * draw >= DRAWS else None
        motions = list(_drawn(search.series, rng, about))
        label, instant, over = search.worst(search.series.unknowns(motions[-1]))
        exceeded.append((over, label, instant))
        if over < 0:  # else even the slowest motion is outside
            start = _first_inside(search, motions)
            if start is not None:
                return search, start
    over, label, instant = min(exceeded)
    if over < 0:
        raise InfeasibleMotion(
            f"none of {DRAWS} random motions inside the limits excites all parameters: some joint "
            "has too little room or is too slow; allow more, or lock it"
        )
    raise InfeasibleMotion(
        f"no motion inside all limits was found in {DRAWS} random postures: even one that hardly "
        f"moves exceeds the limit on {label} by {over:.2g} of it at t = {instant:.3g} s; correct "
        "the limits or the model, or allow more"
    )


def _drawn(
    series: Series, rng: np.random.Generator, about: Array | None
) -> Iterator[Fourier]:
    """A random motion, smaller and smaller; about a posture, (n,), if one is given."""
    draw = sample(series.limits, series.fundamental, series.harmonics, rng)
    for share in SHARES:
        motion = draw.sized(float(share))
        yield motion if about is None else motion.scaled(float(share), about)


def _first_inside(
    search: InteriorPointProblem, motions: Iterable[Fourier]
) -> Array | None:
    """Unknowns of the first motion that is strictly inside all limits; None for none."""
    unknowns = (search.series.unknowns(motion) for motion in motions)
    return next((x for x in unknowns if search.inside(x).holds), None)


def _proven(rules: Rules, motions: Iterable[Fourier]) -> tuple[Fourier, Proof]:
    """The first motion that can be proven, if need be a little smaller.

    Raises:
        InfeasibleMotion: None can be.
    """
    for motion, share in product(motions, SMALLER):
        smaller = motion.scaled(share, motion.offset)
        proof = prove(smaller, rules)
        if proof.holds:
            return smaller, proof
    raise InfeasibleMotion(
        f"a motion was found, but not proven between its samples: {proof.worst.words}"
    )
