"""Which terms the joints' torques have, chosen by data that no fit has seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import RecordingError, plural, round_significant
from testbed.core.estimation.estimate import channel_units
from testbed.core.estimation.problem import Problem, usual_terms
from testbed.core.estimation.regression.normal_equations import (
    TINY,
    NormalEquations,
    scaled_solve,
)
from testbed.core.estimation.regression.solvers import noise_weights
from testbed.core.estimation.regression.windows import DENSE
from testbed.core.estimation.selection.held_out import (
    OFFERED,
    HeldOut,
    Parts,
    TermChoice,
    grown,
    rivals,
    stretches,
)
from testbed.core.estimation.settings import AUTO
from testbed.core.robot.friction import (
    BACKWARD,
    COULOMB,
    FORWARD,
    OFFSET,
    ROTOR,
    STRIBECK,
    VARYING,
    JointTerm,
    joint_terms,
    stribeck,
)
from testbed.core.robot.joint_law import JointLaw

SPEEDS = tuple(np.geomspace(0.01, 1.0, 13).tolist())
"""First look [rad/s or m/s]."""

CLOSER = 9
"""Speeds of the second look, between the neighbours of the best."""


def with_stribeck_speed(problem: Problem) -> Problem:
    """A problem whose terms say the speed at which friction fades out, one for all joints.

    Args:
        problem: By joint torques, with "stribeck" among the terms.
    """

    def best(speeds: tuple[float, ...]) -> int:
        laws = (*problem.settings.words, *(stribeck(speed) for speed in speeds))
        every = problem.with_settings(terms=laws)
        with one_blas_thread():
            equations = every.equations(every.passes(1))
            costs = [_cost(_with_one(equations, every, speed)) for speed in speeds]
        return int(np.argmin(costs))

    first = best(SPEEDS)
    low, high = SPEEDS[max(first - 1, 0)], SPEEDS[min(first + 1, len(SPEEDS) - 1)]
    closer = tuple(round_significant(speed, 3) for speed in np.geomspace(low, high, CLOSER))
    found = f"{STRIBECK}@{closer[best(closer)]:g}"
    asked = problem.settings.terms or ()
    return problem.with_settings(terms=[found if term == STRIBECK else term for term in asked])


def _with_one(equations: NormalEquations, problem: Problem, speed: float) -> NormalEquations:
    """The equations with the columns of one speed alone."""
    ours, kind, count = stribeck(speed), f"{STRIBECK}@", problem.minimal.count
    kept = [*range(count)]
    for k, term in enumerate(problem.layout.terms, start=count):
        if not term.law.kind.startswith(kind) or term.law == ours:
            kept.append(k)
    return equations.of_unknowns(kept)


def _cost(equations: NormalEquations) -> float:
    """What likelihood says of the best fit: the less the better."""
    weights: Array = noise_weights(equations)
    values = scaled_solve(equations.matrix(weights), equations.vector(weights))
    left = equations.residual(values) / np.maximum(equations.used, 1.0)
    return float(equations.used @ np.log(np.maximum(left, TINY)))


PARTS = 6
"""Of a recording."""

ROUNDS = 2
"""Of a choice: the second knows how much noise the first one leaves."""

FEWEST = 4
"""Rows of a part for each joint, on average, below which nothing can be chosen."""


def with_all_terms(problem: Problem) -> tuple[Problem, TermChoice | None]:
    """A problem whose settings say all terms, and the evidence where held-out data chose them.

    Args:
        problem: By either method.
    """
    choice = None
    if problem.method == "external":
        return problem, choice
    if problem.settings.terms == AUTO:
        choice = choose_terms(problem)
        problem = problem.with_settings(terms=choice.words)
    return (with_stribeck_speed(problem) if problem.settings.open_speed else problem), choice


ONE_WAY = 1e-3
"""Part of dry friction's square beyond an offset that the filter on rows makes of reversals near
them: below it no row shows the other direction."""


def with_fewer_terms(problem: Problem) -> Problem:
    """A problem with the terms that each joint's rows can distinguish.

    Where a joint moves in one direction only, dry friction and offset are one constant, their sum;
    a joint without a row has no terms.

    Args:
        problem: Its settings say all terms; of the plate, there are none.
    """
    drives = problem.drives
    if drives is None:
        return problem
    equations = problem.equations(problem.passes(1))
    one_way = dict(_one_way(problem, equations))
    values = [word for word in problem.settings.words if isinstance(word, JointLaw)]
    words: list[str | JointLaw] = [*values]
    for term in drives.asked:
        joint, law = term.joint, term.law
        if law in values or (joint < drives.tree.n and not equations.used[joint]):
            continue
        law = one_way.get(joint, law) if law in (COULOMB, OFFSET) else law
        words.append(JointTerm(law, joint).name(drives.tree))
    return problem.with_settings(terms=tuple(dict.fromkeys(words)))


def _one_way(problem: Problem, equations: NormalEquations) -> Iterator[tuple[int, JointLaw]]:
    """Joints that never reverse, and what is left of dry friction and offset there."""
    for joint, place in enumerate(problem.channels):
        pair = f"{COULOMB.kind}/{place}", f"{OFFSET.kind}/{place}"
        if not equations.used[joint] or not {*pair} <= {*problem.names}:
            continue
        at = [problem.names.index(name) for name in pair]
        (dry, both), (_, constant) = equations.of_channel(joint)[0][np.ix_(at, at)]
        if dry * constant - both**2 <= ONE_WAY * dry * constant:
            yield joint, FORWARD if both > 0 else BACKWARD


def choose_terms(problem: Problem) -> TermChoice:
    """The terms that held-out data choose.

    Args:
        problem: By joint torques; the terms of its settings do not matter.

    Raises:
        RecordingError: The recording is too short to be cut into parts.
    """
    tree = problem.tree
    usual = joint_terms(tree, usual_terms(tree, problem.source))
    varying = [law for law in VARYING if law.by in problem.source.signals]
    laws = tuple(dict.fromkeys((*(term.law for term in usual), ROTOR, *OFFERED, *varying)))
    problem = problem.with_settings(terms=laws)
    drives = problem.drives
    assert drives is not None, "terms are those of joint torques"
    at = {term: drives.minimal.count + k for k, term in enumerate(drives.terms)}
    base = [term for term in at if term in usual]
    always = [*range(drives.minimal.count), *(at[term] for term in base)]
    offered = {term: place for term, place in at.items() if term not in base}
    look, more = _Look(problem), list[JointTerm]()
    with one_blas_thread():
        for _ in range(ROUNDS):
            parts = look.parts([*always, *(at[term] for term in more)])
            more, growth = grown(
                parts,
                always,
                offered,
                lambda term: term.name(tree),
                lambda one, other: one.joint == other.joint and rivals(one.law, other.law),
            )
        before = look.held_out(parts, always)
        after = look.held_out(parts, [*always, *(at[term] for term in more)])
    within = [term for term in drives.regrouped if term.law == ROTOR]
    words = tuple(term.name(tree) for term in (*base, *more, *within))
    return TermChoice(words, growth, before, after, PARTS)


def held_out(problem: Problem) -> HeldOut:
    """What is left of unseen parts with the terms of the settings.

    Args:
        problem: By either method.

    Raises:
        RecordingError: The recording is too short to be cut into parts.
    """
    look = _Look(problem)
    every = [*range(look.count)]
    with one_blas_thread():
        return look.held_out(look.parts(every), every)


class _Look:
    """A recording's rows with the columns of some terms, cut into parts.

    As many rows as the filter leaves independent: an autoregression takes half of them, which
    short recordings can hardly spare.
    """

    def __init__(self, problem: Problem) -> None:
        problem = problem.with_settings(nuisances=(), known={})
        self.count = len(problem.names)
        self.passes = problem.passes(4, per_cutoff=DENSE)
        plan = self.passes.plan
        if plan.rows < FEWEST * PARTS:
            raise RecordingError(
                f"the recording gives {plural(plan.rows, 'row')}, too few for "
                f"{PARTS}-fold cross-validation; record longer"
            )
        self.units = channel_units(problem.tree, problem.method)
        reach = -(-2 * (len(plan.weights) // 2) // plan.step)
        self.spans = list(stretches(plan.rows, PARTS, reach))
        with one_blas_thread():
            self.equations: NormalEquations = problem.equations(self.passes)

    def parts(self, columns: Sequence[int]) -> Parts:
        """Products of rows by parts, in units of the noise that a fit of some columns leaves."""
        weights = noise_weights(self.equations.of_unknowns(columns))
        root = np.sqrt(weights)
        size = self.count + 1
        unseen, near = np.zeros((2, PARTS, size, size))
        first = 0
        for every, measured in self.passes.rows(np.eye(self.count)):
            rows = np.concatenate([every, measured[..., None]], axis=2) * root[:, None, None]
            for k, (own, beside) in enumerate(self.spans):
                for found, span in ((unseen[k], own), (near[k], beside)):
                    low, high = max(span.start - first, 0), max(span.stop - first, 0)
                    some = rows[:, low:high].reshape(-1, size)
                    found += some.T @ some
            first += rows.shape[1]
        return Parts(unseen, unseen.sum(axis=0) - near)

    def held_out(self, parts: Parts, columns: Sequence[int]) -> HeldOut:
        """What fits of some columns leave, channel by channel."""
        values = np.zeros((self.count, PARTS))
        values[list(columns)] = parts.values(columns).T
        squares, first = np.zeros(len(self.units)), 0
        for predicted, measured in self.passes.rows(values):
            for k, (own, _) in enumerate(self.spans):
                low, high = max(own.start - first, 0), max(own.stop - first, 0)
                left = measured[:, low:high] - predicted[:, low:high, k]
                squares += (left**2).sum(axis=1)
            first += measured.shape[1]
        used = self.equations.used
        residual = np.sqrt(squares / np.maximum(used, 1.0))
        return HeldOut(self.equations.channels, self.units, self.equations.rms, residual, used)
