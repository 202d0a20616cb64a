"""Choice of the joint laws (friction, offset, rotor inertia) by cross-validation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import RecordingError, count_with_noun
from testbed.core.estimation.estimate import channel_units
from testbed.core.estimation.problem import Problem, usual_terms
from testbed.core.estimation.regression.normal_equations import NormalEquations
from testbed.core.estimation.regression.solvers import noise_weights
from testbed.core.estimation.regression.windows import DENSE_ROWS_PER_CUTOFF
from testbed.core.estimation.selection.folds import (
    CrossProducts,
    CrossValidation,
    Folds,
)
from testbed.core.estimation.selection.held_out import (
    CANDIDATE_LAWS,
    TermChoice,
    TestResiduals,
    are_exclusive,
    forward_selection,
)
from testbed.core.estimation.settings import AUTOMATIC_TERMS
from testbed.core.robot.friction import (
    BACKWARD_CONSTANT,
    COULOMB,
    DRIFT_LAWS,
    FORWARD_CONSTANT,
    OFFSET,
    ROTOR,
    JointTerm,
    joint_terms,
)
from testbed.core.robot.joint_law import JointLaw

FOLD_COUNT = 6
"""Number of folds of a recording."""

SELECTION_ROUNDS = 2
"""Number of forward selections: the second is weighted by the noise that the first one leaves."""

MIN_ROWS_PER_FOLD = 4
"""Smallest number of rows of a fold for cross-validation."""


def with_chosen_terms(problem: Problem) -> tuple[Problem, TermChoice | None]:
    """Problem with "auto" terms replaced by terms chosen in cross-validation, and the evidence.

    For the force plate and for stated terms, the problem is unchanged and the evidence is None.

    Args:
        problem: Problem of either method.
    """
    if problem.method == "wrench" or problem.settings.terms != AUTOMATIC_TERMS:
        return problem, None
    choice = choose_terms(problem)
    return problem.with_settings(terms=choice.words), choice


MIN_INDEPENDENT_SHARE = 1e-3
"""Smallest share of dry friction's square that is independent of an offset. The filter on rows
makes such a share at nearby reversals; below it, no row shows the other direction."""


def with_distinguishable_terms(problem: Problem) -> Problem:
    """Problem with only the terms that each joint's rows can distinguish.

    For a joint that moves in one direction only, dry friction and offset are replaced by their sum,
    a constant; a joint without rows has no terms.

    Args:
        problem: Problem with all terms stated; unchanged for the force plate.
    """
    drives = problem.drives
    if drives is None:
        return problem
    equations = problem.equations(problem.passes(1))
    one_way_laws = dict(_one_way_laws(problem, equations))
    stated_laws = [
        word for word in problem.settings.words if isinstance(word, JointLaw)
    ]
    words: list[str | JointLaw] = [*stated_laws]
    for term in drives.asked:
        joint, law = term.joint, term.law
        if law in stated_laws or (joint < drives.tree.n and not equations.used[joint]):
            continue
        law = one_way_laws.get(joint, law) if law in (COULOMB, OFFSET) else law
        words.append(JointTerm(law, joint).name(drives.tree))
    return problem.with_settings(terms=tuple(dict.fromkeys(words)))


def _one_way_laws(
    problem: Problem, equations: NormalEquations
) -> Iterator[tuple[int, JointLaw]]:
    """Yield joints that move in one direction only, with the law of the constant torque.

    For these joints, the columns of dry friction and offset are collinear (MIN_INDEPENDENT_SHARE).
    The law is the sum of both for forward or for backward motion.
    """
    for joint, name in enumerate(problem.channels):
        terms = f"{COULOMB.kind}/{name}", f"{OFFSET.kind}/{name}"
        if not equations.used[joint] or not {*terms} <= {*problem.names}:
            continue
        indices = [problem.names.index(name) for name in terms]
        (dry_square, product), (_, offset_square) = equations.of_channel(joint)[0][
            np.ix_(indices, indices)
        ]
        if (
            dry_square * offset_square - product**2
            <= MIN_INDEPENDENT_SHARE * dry_square * offset_square
        ):
            yield joint, FORWARD_CONSTANT if product > 0 else BACKWARD_CONSTANT


def choose_terms(problem: Problem) -> TermChoice:
    """Choose the joint laws of a problem by forward selection in cross-validation.

    The default laws (`usual_terms`) are always included. Candidates are the rotor inertia,
    CANDIDATE_LAWS, and laws that depend on recorded time or temperature, for each joint and shaft
    separately.

    Args:
        problem: Problem of joint torques; the terms of its settings are ignored.

    Raises:
        RecordingError: The recording is too short for the folds.
    """
    tree = problem.tree
    default_terms = joint_terms(tree, usual_terms(tree, problem.source))
    varying = [law for law in DRIFT_LAWS if law.by in problem.source.signals]
    laws = tuple(
        dict.fromkeys(
            (*(term.law for term in default_terms), ROTOR, *CANDIDATE_LAWS, *varying)
        )
    )
    problem = problem.with_settings(terms=laws)
    drives = problem.drives
    assert drives is not None, "terms are those of joint torques"
    column_of = {term: drives.minimal.count + k for k, term in enumerate(drives.terms)}
    base_terms = [term for term in column_of if term in default_terms]
    base_columns, selected = (
        [*range(drives.minimal.count), *(column_of[term] for term in base_terms)],
        list[JointTerm](),
    )
    folded_rows = _FoldedRows.from_problem(problem)
    for _ in range(SELECTION_ROUNDS):
        folds = folded_rows.validation(
            [*base_columns, *(column_of[term] for term in selected)]
        )
        selected, steps = forward_selection(
            folds,
            base_columns,
            {
                term: index
                for term, index in column_of.items()
                if term not in base_terms
            },
            lambda term: term.name(tree),
            lambda first, second: (
                first.joint == second.joint and are_exclusive(first.law, second.law)
            ),
        )
    regrouped = [term for term in drives.regrouped if term.law == ROTOR]
    return TermChoice(
        words=tuple(term.name(tree) for term in (*base_terms, *selected, *regrouped)),
        growth=steps,
        before=folded_rows.held_out(folds, base_columns),
        after=folded_rows.held_out(
            folds, [*base_columns, *(column_of[term] for term in selected)]
        ),
        parts=FOLD_COUNT,
    )


def cross_validate(problem: Problem) -> TestResiduals:
    """Test residuals of a cross-validation with the terms of the settings.

    Each of FOLD_COUNT (6) consecutive folds is predicted from a fit to the other folds.

    Args:
        problem: Problem of either method.

    Raises:
        RecordingError: The recording is too short for the folds.
    """
    folded_rows, columns = _FoldedRows.from_problem(problem), range(len(problem.names))
    return folded_rows.held_out(folded_rows.validation(columns), columns)


@dataclass(frozen=True, eq=False)
class _FoldedRows:
    """Products of a recording's rows, fold by fold.

    Rows are twice as dense as for an autoregression, so that short recordings have enough rows.

    Attributes:
        units: Unit of each channel, N m or N.
        equations: Normal equations of all rows.
        products: Products of the columns of each fold.
    """

    units: tuple[str, ...]
    equations: NormalEquations
    products: CrossProducts

    @classmethod
    def from_problem(cls, problem: Problem) -> _FoldedRows:
        """Compute the products of a problem's rows in two passes.

        Args:
            problem: Problem of either method.

        Raises:
            RecordingError: The recording is too short for the folds.
        """
        problem = problem.with_settings(nuisances=(), known={})
        passes = problem.passes(2, per_cutoff=DENSE_ROWS_PER_CUTOFF)
        plan = passes.plan
        if plan.rows < MIN_ROWS_PER_FOLD * FOLD_COUNT:
            raise RecordingError(
                f"the recording gives {count_with_noun(plan.rows, 'row')}, too few for "
                f"{FOLD_COUNT}-fold cross-validation; record longer"
            )
        folds = Folds.equal_size(
            plan.rows, FOLD_COUNT, -(-2 * (len(plan.weights) // 2) // plan.step)
        )
        with one_blas_thread():
            equations = problem.equations(passes)
            rows = passes.rows(np.eye(len(problem.names)))
            blocks = (
                np.concatenate([columns, measured[..., None]], axis=2)
                for columns, measured in rows
            )
            products = folds.products(blocks)
        return cls(channel_units(problem.tree, problem.method), equations, products)

    def validation(self, columns: Sequence[int]) -> CrossValidation:
        """Products weighted by the inverse noise variances of a fit of the given columns.

        Args:
            columns: Indices of the columns fitted to all rows.
        """
        return self.products.weighted_sums(
            noise_weights(self.equations.of_unknowns(columns))
        )

    def held_out(self, folds: CrossValidation, columns: Sequence[int]) -> TestResiduals:
        """Test residuals of each channel for fits of the given columns.

        Args:
            folds: Weighted products, which determine the fits.
            columns: Indices of the fitted columns.
        """
        used, signal = self.equations.used, self.equations.rms
        squares = self.products.residual_squares(folds, columns)
        residual = np.sqrt(squares / np.maximum(used, 1.0))
        return TestResiduals(
            self.equations.channels, self.units, signal, residual, used
        )
