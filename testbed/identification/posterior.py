"""What a recording adds to its model file: least squares with the file's bodies as a prior.

Every body's pseudo-inertia is J = U Y U' with that of the file U U'; the coordinates of Y are
those of one with a standard deviation of `PRIOR_ERROR` each: the linear form of the prior of
consistent bodies. Friction and offsets are free. Where the data alone determine all parameters
the prior is left out, and the estimate is that of least squares.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array, readonly
from testbed.blas import one_blas_thread
from testbed.codec import with_properties
from testbed.diagnostics import Diagnosed, Diagnostic
from testbed.identification.estimate import Estimate, Method
from testbed.identification.estimate_summary import corrected_by, summary_of
from testbed.identification.problem import Problem
from testbed.identification.regression.normal_equations import scaled_inverse, scaled_solve
from testbed.identification.regression.solvers import noise_weights
from testbed.identification.selection.prediction_errors import (
    FILE,
    PLAIN,
    POSTERIOR,
    REFITTED,
    Prediction,
    PredictionErrors,
    prediction_errors,
)
from testbed.identification.selection.row_products import Parts, RowProducts, products_of
from testbed.identification.selection.term_choice import with_chosen_terms
from testbed.identification.settings import DEFAULTS, Settings
from testbed.parameters.prior import Prior
from testbed.recordings.source import RecordingLike, Source
from testbed.robot.tree import Tree

PRIOR_ERROR = 0.5
"""Of the model file's bodies, in parts of themselves, unless held-out parts ask for another."""

OFFERED = (0.05, 0.1, 0.2, 0.5, 1.0)
"""Errors of the model file's bodies that are tried where none is said."""

DETERMINED = 0.9
"""Share of the prior's variance that the data remove of a parameter that they determine."""

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
        names: Of the minimal parameters and then of the joints' own terms, (p,).
        units: One each.
        count: How many are of bodies.
        file: By the model file, (p,).
        refitted: The same with the joints' own terms fitted to the data, (p,).
        prior_sigma: Standard deviations before the data, (p,).
        values: (p,).
        covariance: (p, p).
        share: Part of the prior's variance that the data remove, (p,).
        worth: How many parameters the data are worth: the trace of the resolution matrix.
        prior_error: Of the model file's bodies, in parts of themselves.
        tried: By prior error, rms of what it leaves of held-out parts over what the file with its
            friction fitted leaves; {} where it was given, or is not needed.
        used: Whether the prior is needed; else the values are those of least squares.
        errors: What it leaves of held-out parts, and what others do.
    """

    method: Method
    names: tuple[str, ...]
    units: tuple[str, ...]
    count: int
    file: Array
    refitted: Array
    prior_sigma: Array
    values: Array
    covariance: Array
    share: Array
    worth: float
    prior_error: float
    tried: Mapping[float, float]
    used: bool
    errors: tuple[PredictionErrors, ...]

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
        return {FILE: self.file, REFITTED: self.refitted, POSTERIOR: self.values}

    @property
    def determined(self) -> tuple[str, ...]:
        """Minimal parameters of bodies that the data determine."""
        pairs = zip(self.names[: self.count], self.share[: self.count].tolist(), strict=True)
        return tuple(name for name, share in pairs if share >= DETERMINED)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Channels of held-out parts that the model file predicts better."""
        return self.worse_than_file(POSTERIOR)

    def worse_than_file(self, which: str) -> tuple[Diagnostic, ...]:
        """Channels of held-out parts that the model file predicts better than an estimate does.

        Args:
            which: "plain" or "posterior".
        """
        return tuple(said for errors in self.errors for said in errors.worse_than_file(which))


@dataclass(frozen=True, eq=False)
class LinearPrior:
    """Unknowns before the data: mean + root z, z of independent numbers of variance one.

    Attributes:
        mean: (p,).
        root: (p, r).
        noise: Variance of each channel's noise at least, (C,) [N^2, N^2 m^2].
    """

    mean: Array
    root: Array
    noise: Array

    @property
    def variance(self) -> Array:
        """(p,)."""
        return np.asarray((self.root**2).sum(axis=1))


@dataclass(frozen=True, eq=False)
class LinearPosterior:
    """Unknowns after the data.

    Attributes:
        values: (p,).
        covariance: (p, p).
        worth: Trace of the resolution matrix.
    """

    values: Array
    covariance: Array
    worth: float


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
        prior_error: Of the file's bodies, in parts of themselves; None for the one that predicts
            the fast parts by the slow ones best, or, of a steady motion, each half by the other:
            motion of another kind alone can ask for more than `PRIOR_ERROR`.
        gravity: As for `identify`.
        settings: As for `identify`.
        threads: How many to use; default one a processor.

    Raises:
        RecordingError: As `identify`.
    """
    made = [] if estimate is None else [estimate]
    settings = with_chosen_terms(settings, made)
    problem = Problem.of(tree, recording, method, settings, gravity=gravity, threads=threads)
    source = problem.source
    for each in made:
        source = corrected_by(source, problem.tree, summary_of(each))
    plate = method == "external"
    free = estimate is None or bool(estimate.unidentifiable) or "bias" in settings.nuisances
    with one_blas_thread():
        parts = products_of(problem, source, plate and free)
        whole = parts.whole
        count, tried = problem.minimal.count, dict[float, float]()
        error = prior_error or PRIOR_ERROR
        before = linear_prior(problem, prior, error, whole)
        used = estimate is None or not determines(estimate, before)
        if used and prior_error is None:
            tried = {
                each: _held_out(problem, prior, each, parts)[-1].over_file(POSTERIOR)
                for each in OFFERED
                if each <= PRIOR_ERROR or len(parts.splits) > 1
            }
            error = min(reversed(tried), key=lambda each: tried[each])
            before = linear_prior(problem, prior, error, whole)
        found = with_prior(whole, before) if used or estimate is None else _alone(estimate, before)
        errors = _held_out(problem, prior, error, parts, used=used)
        refitted = _refitted(whole, before.mean, count)
    left = np.diagonal(found.covariance)
    variance = before.variance
    share = 1 - np.divide(left, variance, out=np.ones_like(left), where=variance > 0)
    return Posterior(
        method=method,
        names=problem.names,
        units=problem.units,
        count=count,
        file=before.mean,
        refitted=refitted,
        prior_sigma=np.sqrt(variance),
        values=found.values,
        covariance=found.covariance,
        share=np.clip(share, 0.0, 1.0),
        worth=found.worth,
        prior_error=error,
        tried=tried,
        used=used,
        errors=errors,
    )


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
        size, largest = np.einsum("cii->ci", equations.normal), equations.squares[:, None]
        scale = np.sqrt((largest / np.where(size > 0, size, np.inf)).max(axis=0))
        mean += drives.values(np.zeros((problem.tree.n, 10)), problem.tree)
        root = np.hstack([root, drives.columns * scale])
    left = _refitted(rows, mean, count)
    noise = LEAST**2 * rows.squares(left, rows.constants(left)) / np.maximum(rows.rows, 1.0)
    return LinearPrior(mean, root, np.maximum(noise, np.finfo(float).tiny))


def with_prior(rows: RowProducts, prior: LinearPrior) -> LinearPosterior:
    """Least squares with a prior, under noise that its own residuals show.

    A channel's noise is as strong as what is left, and (1 + r) / (1 - r) rows of a correlation r
    from one to the next say as much as one alone.

    Args:
        rows: Products of the rows that are used.
        prior: Of the unknowns.
    """
    equations = rows.equations(prior.root, prior.mean)
    used = np.maximum(equations.used, 1.0)
    variance = np.maximum(equations.squares / used, prior.noise)
    repeated, z = np.ones(len(used)), np.zeros(prior.root.shape[1])
    after: Array = np.eye(len(z))
    for _ in range(ROUNDS):
        weights = np.diag(np.where(equations.used > 0, 1 / (variance * repeated), 0.0))
        after = np.asarray(np.linalg.inv(equations.matrix(weights) + np.eye(len(z))))
        z = after @ equations.vector(weights)
        correlation = rows.correlation(prior.mean + prior.root @ z, prior.noise * used)
        repeated = (1 + correlation) / (1 - correlation)
        lost = np.einsum("cij,ji->c", equations.normal, after) / variance
        left = np.diagonal(equations.residual(z)) / np.maximum(used - lost, FEWEST * used)
        variance = np.maximum(left, prior.noise)
    values = prior.mean + prior.root @ z
    return LinearPosterior(
        values, prior.root @ after @ prior.root.T, len(z) - float(np.trace(after))
    )


def determines(estimate: Estimate, prior: LinearPrior) -> bool:
    """Whether the data alone determine every parameter: then no prior is needed.

    Args:
        estimate: By least squares.
        prior: Of its unknowns.
    """
    most = (1 / DETERMINED - 1) * prior.variance
    return bool((np.diagonal(estimate.covariance) < most).all())


def _alone(estimate: Estimate, prior: LinearPrior) -> LinearPosterior:
    """The estimate itself, and what its data are worth."""
    information = prior.root.T @ scaled_inverse(estimate.covariance) @ prior.root
    sharpness = np.linalg.eigvalsh(information)
    worth = float((sharpness / (1 + sharpness)).sum())
    return LinearPosterior(estimate.values, estimate.covariance, worth)


def _held_out(
    problem: Problem, prior: Prior, error: float, parts: Parts, *, used: bool = True
) -> tuple[PredictionErrors, ...]:
    """What the model file and fits of some parts leave of others, split by split."""
    before, found = linear_prior(problem, prior, error, parts.whole), []
    for split in parts.splits:
        pairs = [
            (_predictions(seen, before, problem.minimal.count, used=used), rest)
            for seen, rest in split.pairs
        ]
        found.append(prediction_errors(problem, split.kind, pairs))
    return tuple(found)


def _refitted(rows: RowProducts, start: Array, count: int) -> Array:
    """The model file's values, the joints' own terms fitted, (p,)."""
    lead = np.eye(len(start))[:, count:]
    found = np.array(start)
    if lead.shape[1]:
        equations = rows.equations(lead, start)
        weights = noise_weights(equations, None)
        found[count:] += scaled_solve(equations.matrix(weights), equations.vector(weights))
    return found


def _plain(rows: RowProducts) -> Array:
    """Least squares, (p,)."""
    p = len(rows.unknowns)
    equations = rows.equations(np.eye(p), np.zeros(p))
    weights = noise_weights(equations, None)
    return scaled_solve(equations.matrix(weights), equations.vector(weights))


def _predictions(
    seen: RowProducts, prior: LinearPrior, count: int, *, used: bool
) -> dict[str, Prediction]:
    """What the model file and fits of some rows say, by what makes them."""
    plain = _plain(seen)
    values = {
        REFITTED: _refitted(seen, prior.mean, count),
        PLAIN: plain,
        POSTERIOR: with_prior(seen, prior).values if used else plain,
    }
    none = np.zeros(len(seen.channels))
    fits = {name: (each, seen.constants(each)) for name, each in values.items()}
    return {FILE: (prior.mean, none), **fits}


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
    unseen = products_of(problem, source, problem.method == "external").whole
    none = np.zeros(len(problem.channels))
    said = {
        name: (values, none if name == FILE else unseen.constants(values))
        for name, values in models.items()
    }
    return prediction_errors(problem, "another", [(said, unseen)])
