"""The most informative motion within the limits, proven; the room's front door.

Several searches from random motions inside all limits, each with one of the frequencies that are
allowed; the best result that can be proven. A proof that fails by a little between the samples of
the search is had by a slightly smaller swing; by more, from a search with more samples and more
room, which goes on from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import InfeasibleMotion
from testbed.core.parameters.rules import Model
from testbed.motion.clearance import ClearanceTerm
from testbed.motion.fourier import Fourier
from testbed.motion.information import Information
from testbed.motion.limits import LimitTerm
from testbed.motion.problem import Problem, Series, minimise
from testbed.motion.proof import Proof, Rules, prove
from testbed.motion.random_motion import rest_posture, sample
from testbed.motion.samples import SampledRows, stencil

DRAWS = 60
"""Random motions tried for a start inside the limits."""
SHARES = 0.8 ** np.arange(1, 16)
"""Of their swing, largest first."""
SMALLER = (1.0, 0.998, 0.995, 0.99, 0.98)
"""Shares of the swing for which a proof is tried before anything else."""
MUCH_SMALLER = (0.96, 0.93, 0.88, 0.8)
"""Shares that are tried in the end."""
FINER = (2, 4)
"""Times as many samples, and as much room, in a search that goes on where a proof failed."""
ROOM, LEAST_ROOM = 0.25, 2e-4
"""What a search keeps beyond the clearance that is to be proven: a share of it, at least [m]."""
FAIR, BEHIND = 30, 2 * np.log(1.25)
"""A search ends that after so many steps or more is so much behind the best one at that step."""
INSTANTS, DENSITY = 80, 16
"""Samples of a period in a search: at least so many, and so many a harmonic."""

Watch = Callable[[int, int, float], None]
"""Called with searches done, searches in all, and the best criterion so far."""


@dataclass(frozen=True, eq=False)
class Wish:
    """What motion is wanted.

    Attributes:
        rules: What it must respect.
        information: What it should identify; its prior is a share of one sample.
        rows: Of the models that rules and information look at, by the kernel.
        frequencies: Fundamental [Hz] and number of harmonics of the series allowed.
        starts: Searches.
        seconds: After which no search goes on [s]; infinite for no limit. Where it ends them,
            the result depends on the machine.
        seed: Of the random motions that searches start from.
    """

    rules: Rules
    information: Information
    rows: Mapping[Model, SampledRows]
    frequencies: tuple[tuple[float, int], ...]
    starts: int
    seconds: float
    seed: int

    @cached_property
    def rest(self) -> Array:
        """Posture about which few draws are tried, (n,) [rad or m]."""
        return rest_posture(self.rules)


@dataclass(frozen=True)
class SearchRecord:
    """One search.

    Attributes:
        fundamental: [Hz].
        harmonics: Number of harmonics.
        start: Criterion of the random motion it began with.
        end: Criterion reached.
    """

    fundamental: float
    harmonics: int
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class Design:
    """A motion that may be run, and how it was found.

    Attributes:
        motion: The motion.
        value: Its criterion for one sample: exp(value / 2) is a relative sigma.
        proof: What it leaves of every limit.
        searches: All that were made.
        complete: Whether all searches that were wished for were made, none cut short by time.
    """

    motion: Fourier
    value: float
    proof: Proof
    searches: tuple[SearchRecord, ...]
    complete: bool


def design(
    wish: Wish,
    watch: Watch = lambda done, total, best: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> Design:
    """The best motion of several searches that is proven to respect all limits.

    Args:
        wish: What is wanted.
        watch: Called after every step of a search.
        interrupted: Asked after every step whether to go on with what there is.

    Raises:
        InfeasibleMotion: No motion inside the limits was found; says which is in the way.
    """
    clock = _Clock(wish, watch, interrupted)
    found: list[tuple[float, Fourier]] = []
    records: list[SearchRecord] = []
    while len(records) < wish.starts and not clock.late:
        problem, x = _start(wish, len(records))
        level = float(np.log(problem.series.instants))  # a criterion is one sample's
        start = problem.inside(x).value + level
        reached = minimise(problem, x, stop=partial(clock.step, level))
        value, series = reached.value + level, problem.series
        found.append((value, series.motion(reached.x)))
        records.append(SearchRecord(series.fundamental, series.harmonics, start, value))
        clock.finish(value)
    best_first = [each for _, each in sorted(found, key=lambda pair: pair[0])]
    motion, proof = _proven(wish, best_first, lambda value: clock.over)
    return Design(motion, criterion(wish, motion), proof, tuple(records), not clock.late)


def criterion(wish: Wish, motion: Fourier) -> float:
    """The criterion of any motion for one sample, as `Design.value`."""
    problem = _problem(wish, motion.fundamental, motion.harmonics)
    value = problem.inside(problem.series.unknowns(motion)).value
    return value + float(np.log(problem.series.instants))


class _Clock:
    """When to stop, and what to report meanwhile."""

    def __init__(self, wish: Wish, watch: Watch, interrupted: Callable[[], bool]) -> None:
        self._end, self._starts, self._watch = time.monotonic() + wish.seconds, wish.starts, watch
        self._interrupted = interrupted
        self._best, self._done = np.inf, 0
        self._steps: list[float] = []  # of the search that is made, then of the best so far
        self._best_steps: list[float] = []
        self.late = False

    @property
    def over(self) -> bool:
        """Whether the time is up, or somebody has interrupted."""
        return self._interrupted() or time.monotonic() > self._end

    def step(self, level: float, value: float) -> bool:
        """Whether a search that has reached a value, above a level, must stop."""
        self._steps.append(level + value)
        self._watch(self._done, self._starts, min(self._best, level + value))
        self.late = self.over
        return self.late or self._behind

    @property
    def _behind(self) -> bool:
        """Whether the search will hardly become the best."""
        same = self._best_steps[: len(self._steps)]
        return len(self._steps) >= FAIR and bool(same) and self._steps[-1] > same[-1] + BEHIND

    def finish(self, value: float) -> None:
        """A search has ended with a value."""
        if value < self._best:
            self._best, self._best_steps = value, self._steps
        self._steps, self._done = [], self._done + 1
        self._watch(self._done, self._starts, self._best)


def _problem(wish: Wish, fundamental: float, harmonics: int, finer: int = 1) -> Problem:
    """The search with these frequencies, with so many times the usual samples and room."""
    rules = wish.rules
    terms: list[LimitTerm] = list(rules.terms)
    if rules.collision is not None and rules.collision.pairs:
        room = finer * np.maximum(ROOM * rules.clearance, LEAST_ROOM)
        terms.append(ClearanceTerm(rules.collision, rules.limits, rules.clearance + room))
    instants = finer * max(INSTANTS, DENSITY * harmonics)
    asked = wish.information
    return Problem(
        series=Series(rules.limits, fundamental, harmonics, instants, rules.margin),
        information=replace(asked, prior=asked.prior * instants),
        terms=terms,
        rows=wish.rows,
        stencil=stencil(rules.tree),
        names=rules.tree.names,
    )


def _start(wish: Wish, number: int) -> tuple[Problem, Array]:
    """A search, and a random motion strictly inside its limits.

    Raises:
        InfeasibleMotion: None was found; says what the nearest one exceeds.
    """
    problem = _problem(wish, *wish.frequencies[number % len(wish.frequencies)])
    series, rng = problem.series, np.random.default_rng([wish.seed, number])
    nearest: tuple[str, float, float] | None = None
    limits = wish.rules.limits
    for draws in range(DRAWS):
        draw = sample(limits, series.fundamental, series.harmonics, rng)
        at_home = 2 * draws >= DRAWS
        motions = [draw.sized(float(share)) for share in SHARES]
        if at_home:  # few postures are free: begin about one that is
            motions = [m.scaled(float(s), wish.rest) for m, s in zip(motions, SHARES, strict=True)]
        slow = series.unknowns(motions[-1])
        if (problem.inside(slow).limits < 0).all():
            larger = (series.unknowns(motion) for motion in motions)
            found = next((x for x in larger if problem.inside(x).holds), None)
            if found is not None:
                return problem, found
            continue  # so slow a motion does not identify all parameters
        worst = problem.worst(slow)
        if nearest is None or worst[2] < nearest[2]:
            nearest = worst
    if nearest is None:
        raise InfeasibleMotion(
            f"none of {DRAWS} random motions inside the limits excites all parameters: some joint "
            "has too little room or is too slow; allow more, or lock it"
        )
    label, instant, over = nearest
    raise InfeasibleMotion(
        f"no motion inside all limits was found in {DRAWS} random postures: even one that hardly "
        f"moves exceeds the limit on {label} by {over:.2g} of it at t = {instant:.3g} s; correct "
        "the limits or the model, or allow more"
    )


def _proven(
    wish: Wish, motions: Sequence[Fourier], stop: Callable[[float], bool]
) -> tuple[Fourier, Proof]:
    """The first motion that can be proven: refined if need be, or a little smaller.

    Raises:
        InfeasibleMotion: None can be.
    """
    proof: Proof | None = None
    for motion in motions:
        tried = motion
        for finer in (*FINER, 0):
            smaller, proof = _smaller(wish, tried, SMALLER)
            if proof.holds:
                return smaller, proof
            if finer:
                tried = _refined(wish, tried, finer, stop)
        smaller, proof = _smaller(wish, tried, MUCH_SMALLER)
        if proof.holds:
            return smaller, proof
    assert proof is not None
    raise InfeasibleMotion(
        f"a motion was found, but not proven between its samples: {proof.worst.words}"
    )


def _smaller(wish: Wish, motion: Fourier, shares: Sequence[float]) -> tuple[Fourier, Proof]:
    """The motion with the largest of some shares of its swing that is proven, else the least."""
    for share in shares:
        smaller = motion.scaled(share, motion.offset)
        proof = prove(smaller, wish.rules)
        if proof.holds:
            break
    return smaller, proof


def _refined(wish: Wish, motion: Fourier, finer: int, stop: Callable[[float], bool]) -> Fourier:
    """What a finer search makes of a motion; the motion where that has no start inside limits."""
    problem = _problem(wish, motion.fundamental, motion.harmonics, finer)
    shrunk = (motion.scaled(share, motion.offset) for share in (*SMALLER, *MUCH_SMALLER))
    starts = (problem.series.unknowns(each) for each in shrunk)
    inside = next((x for x in starts if problem.inside(x).holds), None)
    if inside is None:
        return motion
    return problem.series.motion(minimise(problem, inside, stop=stop).x)
