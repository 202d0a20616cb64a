"""What a recording adds to its model file: least squares with the file's bodies as a prior.

Every body's pseudo-inertia is J = U Y U' with that of the file U U'; the coordinates of Y are
those of one with the same standard deviation each: the linear form of the prior of consistent
bodies. The joints' own terms are free, but friction is not negative. Where the data alone determine
all parameters the prior is left out, and the estimate is that of least squares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.arrays import Array, readonly
from testbed.blas import one_blas_thread
from testbed.codec import with_properties
from testbed.diagnostics import Diagnosed, Diagnostic
from testbed.identification.estimate import Estimate, Method, instrument_of
from testbed.identification.estimate_summary import corrected_by, summary_of
from testbed.identification.problem import Problem
from testbed.identification.regression.normal_equations import scaled_solve
from testbed.identification.regression.solvers import noise_weights
from testbed.identification.selection.prediction_errors import (
    CONSISTENT,
    FILE,
    PLAIN,
    POSTERIOR,
    REFITTED,
    PredictionErrors,
    prediction_errors,
)
from testbed.identification.selection.row_products import Parts, RowProducts, products_of
from testbed.identification.selection.term_choice import with_chosen_settings
from testbed.identification.settings import DEFAULTS, Settings
from testbed.parameters.prior import Prior
from testbed.recordings.source import RecordingLike, Source
from testbed.robot.tree import Tree

PRIOR_ERROR = 0.5
"""Of the model file's bodies, in parts of themselves: before the data, as one coordinate counts."""

ITERATIONS = 50
"""Of the prior's error at most."""

SETTLED = 1e-3
"""Relative change of the prior's error that is none."""

DETERMINED = 0.9
"""Share of the prior's variance that the data remove of a parameter that they determine."""

WIDE = 1e3
"""Times a prior that is none, nearly."""

ROUNDS = 6
"""Times that the noise of the channels is estimated anew."""

FEWEST = 0.1
"""Part of a channel's rows that parameters leave at least to estimate its noise."""

LEAST = 0.1
"""Part of what the model file with its friction fitted leaves that noise is at least."""


@dataclass(frozen=True, eq=False)
class Posterior(Diagnosed):
    """The minimal parameters by a recording and its model file together.

    Attributes:
        method: By plate or by torques.
        instrument: What a person calls it.
        names: Of the minimal parameters and then of the joints' own terms, (p,).
        units: One each.
        count: How many are of bodies.
        file: By the model file, (p,).
        refitted: The same with the joints' own terms fitted to the data, (p,).
        prior_sigma: Standard deviations before the data, (p,).
        values: (p,).
        covariance: (p, p).
        share: Part of the prior's variance that the data remove, (p,).
        alone: Which of them the data alone determine: with nothing else known of any, their
            variance is at most a tenth of the prior's, (p,).
        worth: How many parameters the data are worth: the trace of the resolution matrix.
        prior_error: Of the model file's bodies, in parts of themselves.
        used: Whether the prior is needed; else the values are those of least squares.
        errors: What it leaves of held-out parts, and what others do.
        consistent: Of consistent bodies, (p,); None where they were not asked for.
    """

    method: Method
    instrument: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    count: int
    file: Array
    refitted: Array
    prior_sigma: Array
    values: Array
    covariance: Array
    share: Array
    alone: tuple[bool, ...]
    worth: float
    prior_error: float
    used: bool
    errors: tuple[PredictionErrors, ...]
    consistent: Array | None = None

    __get_pydantic_core_schema__ = with_properties("sigma", "determined", "diagnostics")

    def __post_init__(self) -> None:
        p = len(self.names)
        for name in ("file", "refitted", "prior_sigma", "values", "share"):
            object.__setattr__(self, name, readonly(getattr(self, name), (p,), name))
        object.__setattr__(self, "covariance", readonly(self.covariance, (p, p), "covariance"))

    @property
    def sigma(self) -> Array:
        """Standard deviations, the prior's doubt among them, (p,)."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)))

    @property
    def models(self) -> dict[str, Array]:
        """Values of the unknowns by what says them, for predictions."""
        found = {FILE: self.file, REFITTED: self.refitted, POSTERIOR: self.values}
        return found if self.consistent is None else {**found, CONSISTENT: self.consistent}

    @property
    def determined(self) -> tuple[str, ...]:
        """Minimal parameters of bodies that the data alone determine."""
        pairs = zip(self.names[: self.count], self.alone[: self.count], strict=True)
        return tuple(name for name, alone in pairs if alone)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Channels of held-out parts that the model file predicts better."""
        return (*self.worse_than_file(POSTERIOR), *self.worse_than_file(CONSISTENT))

    def worse_than_file(self, which: str) -> tuple[Diagnostic, ...]:
        """Channels of held-out parts that the model file predicts better than an estimate does.

        Args:
            which: "plain", "posterior" or "consistent".
        """
        return tuple(said for errors in self.errors for said in errors.worse_than_file(which))


@dataclass(frozen=True, eq=False)
class LinearPrior:
    """Unknowns before the data: mean + root z, z of independent numbers of variance one.

    Attributes:
        mean: (p,).
        root: (p, r), those of the bodies first.
        bodies: How many of z are of bodies.
        noise: Variance of each channel's noise at least, (C,) [N^2, N^2 m^2].
        least: Of z, (r,): friction is not negative; -inf for no bound.
    """

    mean: Array
    root: Array
    bodies: int
    noise: Array
    least: Array

    @property
    def variance(self) -> Array:
        """(p,)."""
        return np.asarray((self.root**2).sum(axis=1))

    def times(self, factor: float) -> LinearPrior:
        """The same with another error of the bodies.

        Args:
            factor: Over the one that it has.
        """
        of_bodies = np.arange(self.root.shape[1]) < self.bodies
        return replace(self, root=np.where(of_bodies, factor, 1.0) * self.root)

    def worth(self, covariance: Array) -> float:
        """How many parameters data are worth: the trace of the resolution, 1 - C P^-1.

        Args:
            covariance: C after the data, (p, p).
        """
        size = np.sqrt(np.where(self.variance > 0, self.variance, 1.0))
        root, after = self.root / size[:, None], covariance / np.outer(size, size)
        inverse = np.linalg.pinv(root)
        left = np.einsum("ij,jk,ik", inverse, after, inverse)
        return float(np.linalg.matrix_rank(root) - left)


def posterior(
    tree: Tree,
    recording: RecordingLike,
    prior: Prior,
    method: Method = "external",
    estimate: Estimate | None = None,
    *,
    prior_error: float | None = None,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    threads: int | None = None,
) -> Posterior:
    """What a recording adds to a model file.

    Args:
        tree: The robot; friction that its joints state is the file's.
        recording: As for `identify`.
        prior: The bodies of the model file (`prior_of`).
        method: As for `identify`.
        estimate: By least squares, with the same settings; None where the data determine none.
        prior_error: Of the file's bodies, in parts of themselves; None for the likeliest.
        gravity: As for `identify`.
        settings: As for `identify`.
        threads: How many to use; default one a processor.

    Raises:
        RecordingError: As `identify`.
    """
    made = [] if estimate is None else [estimate]
    problem, parts = parts_of(tree, recording, method, made, gravity, settings, threads)
    with one_blas_thread():
        error = prior_error or PRIOR_ERROR
        before = linear_prior(problem, prior, error, parts.whole)
        used = not any(determines(each, before) for each in made)
        if used and prior_error is None:
            error = likeliest([(parts.whole, before)])
            before = before.times(error / PRIOR_ERROR)
        values, covariance = with_prior(parts.whole, before)
        if used:
            alone = tuple(alone_determined(parts.whole, before).tolist())
        else:
            values, covariance = made[0].values, np.array(made[0].covariance)
            alone = (True,) * len(values)
        count = problem.minimal.count
        variance = np.maximum(before.variance, np.finfo(float).tiny)
        return Posterior(
            method=method,
            instrument=instrument_of(problem.minimal, method),
            names=problem.names,
            units=problem.units,
            count=count,
            file=before.mean,
            refitted=refitted(parts.whole, before),
            prior_sigma=np.sqrt(before.variance),
            values=values,
            covariance=covariance,
            share=np.clip(1 - np.diagonal(covariance) / variance, 0.0, 1.0),
            alone=alone,
            worth=before.worth(covariance),
            prior_error=error,
            used=used,
            errors=_held_out(problem, before, parts, used=used),
        )


def likeliest_prior_error(
    tree: Tree,
    recording: RecordingLike,
    prior: Prior,
    estimates: Sequence[Estimate],
    settings: Settings = DEFAULTS,
) -> float:
    """The error of the model file's bodies, in parts of themselves, that makes data likeliest.

    Args:
        tree: The robot.
        recording: That of the estimates.
        prior: The bodies of the model file.
        estimates: By least squares, one a method, with the same settings.
        settings: As for `identify`.
    """
    data = []
    for each in estimates:
        problem, parts = parts_of(
            tree, recording, each.method, [each], each.gravity, settings, None
        )
        data.append((parts.whole, linear_prior(problem, prior, PRIOR_ERROR, parts.whole)))
    with one_blas_thread():
        return likeliest(data)


def likeliest(data: Sequence[tuple[RowProducts, LinearPrior]]) -> float:
    """The error of the bodies that makes data likeliest: the evidence's fixed point.

    Coordinates that the data determine have this error on average; `PRIOR_ERROR` counts as one.

    Source    D. J. C. MacKay, Bayesian interpolation (Neural Computation 4, 1992)

    Args:
        data: Rows, and the prior of their unknowns with `PRIOR_ERROR`.
    """
    error = PRIOR_ERROR
    for _ in range(ITERATIONS):
        square, count = PRIOR_ERROR**2, 1.0
        for rows, prior in data:
            z, after = _linear(rows, prior.times(error / PRIOR_ERROR))
            square += float(error**2 * z[: prior.bodies] @ z[: prior.bodies])
            count += float((1 - np.diagonal(after)[: prior.bodies]).sum())
        before, error = error, float(np.sqrt(square / count))
        if abs(error - before) < SETTLED * before:
            break
    return error


def parts_of(
    tree: Tree,
    recording: RecordingLike,
    method: Method,
    made: Sequence[Estimate],
    gravity: ArrayLike | None,
    settings: Settings,
    threads: int | None,
) -> tuple[Problem, Parts]:
    """A problem, and its rows, faults of the instrument that an estimate found taken back.

    Args:
        tree: The robot.
        recording: As for `identify`.
        method: By plate or by torques.
        made: The estimate by least squares, if there is one.
        gravity: As for `identify`.
        settings: As for `identify`.
        threads: How many to use; default one a processor.
    """
    settings = with_chosen_settings(settings, made)
    problem = Problem.of(tree, recording, method, settings, gravity=gravity, threads=threads)
    source, free = problem.source, "bias" in problem.settings.nuisances or not made
    for each in made:
        source = corrected_by(source, problem.tree, summary_of(each))
        free = free or bool(each.unidentifiable)
    return problem, products_of(problem, source, free and method == "external")


def linear_prior(problem: Problem, prior: Prior, error: float, rows: RowProducts) -> LinearPrior:
    """Unknowns by the model file; terms of the joints are free: as large as the torques allow.

    Args:
        problem: Says which unknowns.
        prior: The file's bodies.
        error: Of these, in parts of themselves.
        rows: Products of all rows.
    """
    count, drives = problem.minimal.count, problem.drives
    bodies = problem.minimal.standard_matrix
    mean, root = np.zeros(len(problem.names)), np.zeros((len(problem.names), 10 * problem.tree.n))
    mean[:count], root[:count] = bodies @ prior.standard.ravel(), error * bodies @ prior.root
    if drives is not None:
        equations = rows.equations(drives.columns, np.zeros(len(mean)))
        size = np.einsum("cii->ci", equations.normal)
        most = size.argmax(axis=0), np.arange(size.shape[1])  # the channel where each shows most
        scale = np.sqrt(equations.squares[most[0]] / np.where(size[most] > 0, size[most], np.inf))
        mean += drives.values(np.zeros((problem.tree.n, 10)), problem.tree)
        root = np.hstack([root, drives.columns * scale])
    tiny = np.full(len(rows.channels), np.finfo(float).tiny)
    before = LinearPrior(mean, root, bodies.shape[1], tiny, _bounds(problem, mean, root))
    left = refitted(rows, before)
    noise = LEAST**2 * rows.squares(left, rows.constants(left)) / np.maximum(rows.rows, 1.0)
    return replace(before, noise=np.maximum(noise, tiny))


def _bounds(problem: Problem, mean: Array, root: Array) -> Array:
    """Least coordinates, (r,), of mean + root z without negative friction."""
    least = np.full(root.shape[1], -np.inf)
    terms = () if problem.drives is None else problem.drives.terms
    for k, term in enumerate(terms, start=problem.minimal.count):
        (own,) = np.nonzero(root[k])
        if term.law.resists and len(own) == 1:  # else it is a sum with terms of other shafts
            least[own] = -mean[k] / root[k, own]
    return least


def with_prior(rows: RowProducts, prior: LinearPrior) -> tuple[Array, Array]:
    """Least squares with a prior, under noise that its own residuals show.

    A channel's noise is as strong as what is left, and (1 + r) / (1 - r) rows of a correlation r
    from one to the next say as much as one alone. Friction that would drive the motion is zero.

    Args:
        rows: Products of the rows that are used.
        prior: Of the unknowns.

    Returns:
        Values, (p,), and their covariance, (p, p): that without the bounds of friction.
    """
    z, after = _linear(rows, prior)
    return prior.mean + prior.root @ z, prior.root @ after @ prior.root.T


def _linear(rows: RowProducts, prior: LinearPrior) -> tuple[Array, Array]:
    """The same: z, (r,), and its covariance, (r, r)."""
    equations = rows.equations(prior.root, prior.mean)
    used = np.maximum(equations.used, 1.0)
    variance = np.maximum(equations.squares / used, prior.noise)
    repeated, z = np.ones(len(used)), np.zeros(prior.root.shape[1])
    after: Array = np.eye(len(z))
    for _ in range(ROUNDS):
        weights = np.diag(np.where(equations.used > 0, 1 / (variance * repeated), 0.0))
        matrix, vector = equations.matrix(weights) + np.eye(len(z)), equations.vector(weights)
        after = np.asarray(np.linalg.inv(matrix))
        z = after @ vector
        if (z < prior.least).any():
            from scipy.optimize import lsq_linear

            half = np.linalg.cholesky(matrix)
            z = lsq_linear(half.T, np.linalg.solve(half, vector), (prior.least, np.inf), "bvls").x
        correlation = rows.correlation(prior.mean + prior.root @ z, prior.noise * used)
        repeated = (1 + correlation) / (1 - correlation)
        lost = np.einsum("cij,ji->c", equations.normal, after) / variance
        left = np.diagonal(equations.residual(z)) / np.maximum(used - lost, FEWEST * used)
        variance = np.maximum(left, prior.noise)
    return z, after


def alone_determined(rows: RowProducts, prior: LinearPrior) -> NDArray[np.bool_]:
    """Which unknowns the data alone determine: nearly nothing else is known of any, (p,).

    The prior's bodies hold mass, centre and inertia together; what it carries from one parameter to
    another is not the data's.

    Args:
        rows: Products of the rows that are used.
        prior: Of the unknowns.
    """
    _, covariance = with_prior(rows, replace(prior, root=WIDE * prior.root))
    found: NDArray[np.bool_] = np.diagonal(covariance) <= (1 - DETERMINED) * prior.variance
    return found


def determines(estimate: Estimate, prior: LinearPrior) -> bool:
    """Whether the data alone determine every parameter: then no prior is needed.

    Args:
        estimate: By least squares.
        prior: Of its unknowns.
    """
    most = (1 / DETERMINED - 1) * prior.variance
    return bool((np.diagonal(estimate.covariance) < most).all())


def _held_out(
    problem: Problem, prior: LinearPrior, parts: Parts, *, used: bool = True
) -> tuple[PredictionErrors, ...]:
    """What the model file and fits of some parts leave of others, split by split."""
    none, found = np.zeros(len(problem.channels)), []
    for kind, split in parts.splits.items():
        pairs = []
        for seen, rest in split:
            fits = {REFITTED: refitted(seen, prior), PLAIN: _plain(seen)}
            fits[POSTERIOR] = with_prior(seen, prior)[0] if used else fits[PLAIN]
            said = {name: (values, seen.constants(values)) for name, values in fits.items()}
            pairs.append(({FILE: (prior.mean, none), **said}, rest))
        found.append(prediction_errors(problem, kind, pairs))
    return tuple(found)


def refitted(rows: RowProducts, prior: LinearPrior) -> Array:
    """The model file's values, the joints' own terms fitted, (p,).

    Args:
        rows: Products of the rows that are used.
        prior: Of the unknowns.
    """
    return with_prior(rows, prior.times(0.0))[0]


def _plain(rows: RowProducts) -> Array:
    """Least squares, (p,)."""
    p = len(rows.unknowns)
    equations = rows.equations(np.eye(p), np.zeros(p))
    weights = noise_weights(equations, None)
    return scaled_solve(equations.matrix(weights), equations.vector(weights))


def errors_of_another(
    problem: Problem, source: Source, models: Mapping[str, Array]
) -> PredictionErrors:
    """What a model file and estimates leave of another recording.

    All but the file as it is stand about the mean of what they leave of the plate: its zero
    belongs to a recording.

    Args:
        problem: The other recording.
        source: The same, faults of the instrument taken back.
        models: Values of the unknowns by what says them.
    """
    parts = products_of(problem, source, problem.method == "external")
    unseen = parts.whole
    none = np.zeros(len(problem.channels))
    said = {
        name: (values, none if name == FILE else unseen.constants(values))
        for name, values in models.items()
    }
    return prediction_errors(problem, "another", [(said, parts.each)])
