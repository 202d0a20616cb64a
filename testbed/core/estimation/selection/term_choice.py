"""Which terms the joints' torques have, chosen by data that no fit has seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import RecordingError, plural
from testbed.core.estimation.estimate import channel_units
from testbed.core.estimation.problem import Problem, usual_terms
from testbed.core.estimation.regression.normal_equations import NormalEquations
from testbed.core.estimation.regression.solvers import noise_weights
from testbed.core.estimation.regression.windows import DENSE
from testbed.core.estimation.selection.folds import (
    CrossProducts,
    CrossValidation,
    Folds,
)
from testbed.core.estimation.selection.held_out import (
    OFFERED,
    HeldOut,
    TermChoice,
    forward_selection,
    rivals,
)
from testbed.core.estimation.settings import AUTO
from testbed.core.robot.friction import (
    BACKWARD,
    COULOMB,
    FORWARD,
    OFFSET,
    ROTOR,
    VARYING,
    JointTerm,
    joint_terms,
)
from testbed.core.robot.joint_law import JointLaw

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
    if problem.method == "external" or problem.settings.terms != AUTO:
        return problem, None
    choice = choose_terms(problem)
    return problem.with_settings(terms=choice.words), choice


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


def _one_way(
    problem: Problem, equations: NormalEquations
) -> Iterator[tuple[int, JointLaw]]:
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
    laws = tuple(
        dict.fromkeys((*(term.law for term in usual), ROTOR, *OFFERED, *varying))
    )
    problem = problem.with_settings(terms=laws)
    drives = problem.drives
    assert drives is not None, "terms are those of joint torques"
    at = {term: drives.minimal.count + k for k, term in enumerate(drives.terms)}
    base = [term for term in at if term in usual]
    always, more = (
        [*range(drives.minimal.count), *(at[term] for term in base)],
        list[JointTerm](),
    )
    data = _FoldedRows.of(problem)
    for _ in range(ROUNDS):
        folds = data.validation([*always, *(at[term] for term in more)])
        more, growth = forward_selection(
            folds,
            always,
            {term: column for term, column in at.items() if term not in base},
            lambda term: term.name(tree),
            lambda one, other: one.joint == other.joint and rivals(one.law, other.law),
        )
    regrouped = [term for term in drives.regrouped if term.law == ROTOR]
    return TermChoice(
        words=tuple(term.name(tree) for term in (*base, *more, *regrouped)),
        growth=growth,
        before=data.held_out(folds, always),
        after=data.held_out(folds, [*always, *(at[term] for term in more)]),
        parts=PARTS,
    )


def held_out(problem: Problem) -> HeldOut:
    """Residuals of unseen folds with the terms of the settings.

    Args:
        problem: By either method.

    Raises:
        RecordingError: The recording is too short to be cut into folds.
    """
    data, every = _FoldedRows.of(problem), range(len(problem.names))
    return data.held_out(data.validation(every), every)


@dataclass(frozen=True, eq=False)
class _FoldedRows:
    """Products of a recording's rows, fold by fold.

    As many rows as the filter leaves independent: an autoregression takes half of them, which
    short recordings can hardly spare.

    Attributes:
        units: N m or N, one a channel.
        equations: Of all rows.
        products: Of the folds.
    """

    units: tuple[str, ...]
    equations: NormalEquations
    products: CrossProducts

    @classmethod
    def of(cls, problem: Problem) -> _FoldedRows:
        """Products by two passes.

        Args:
            problem: By either method.

        Raises:
            RecordingError: The recording is too short to be cut into folds.
        """
        problem = problem.with_settings(nuisances=(), known={})
        passes = problem.passes(2, per_cutoff=DENSE)
        plan = passes.plan
        if plan.rows < FEWEST * PARTS:
            raise RecordingError(
                f"the recording gives {plural(plan.rows, 'row')}, too few for "
                f"{PARTS}-fold cross-validation; record longer"
            )
        folds = Folds.even(
            plan.rows, PARTS, -(-2 * (len(plan.weights) // 2) // plan.step)
        )
        with one_blas_thread():
            equations = problem.equations(passes)
            rows = passes.rows(np.eye(len(problem.names)))
            blocks = (np.concatenate([x, y[..., None]], axis=2) for x, y in rows)
            products = folds.products(blocks)
        return cls(channel_units(problem.tree, problem.method), equations, products)

    def validation(self, columns: Sequence[int]) -> CrossValidation:
        """Products weighted by the noise that a fit of some columns leaves."""
        return self.products.weighted(
            noise_weights(self.equations.of_unknowns(columns))
        )

    def held_out(self, folds: CrossValidation, columns: Sequence[int]) -> HeldOut:
        """Residuals of fits of some columns, channel by channel."""
        used, signal = self.equations.used, self.equations.rms
        squares = self.products.residual_squares(folds, columns)
        residual = np.sqrt(squares / np.maximum(used, 1.0))
        return HeldOut(self.equations.channels, self.units, signal, residual, used)
