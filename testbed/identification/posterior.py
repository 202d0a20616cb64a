"""What a recording adds to its model file: least squares with the file's bodies as a prior.

Every body's pseudo-inertia is J = U Y U' with that of the file U U'; the coordinates of Y are
those of one with a standard deviation of `PRIOR_ERROR` each: the linear form of the prior of
consistent bodies. Friction and offsets are free. Where the data alone determine all parameters
the prior is left out, and the estimate is that of least squares.
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
"""Of the model file's bodies, in parts of themselves, unless held-out parts ask for another."""

OFFERED = (0.05, 0.1, 0.2, 0.5, 1.0)
"""Errors of the model file's bodies that are tried where none is said."""

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
        tried: By prior error, rms of what it leaves of held-out parts over what the file with its
            friction fitted leaves; {} where it was given, or is not needed.
        used: Whether the prior is needed; else the values are those of least squares.
        errors: What it leaves of held-out parts, and what others do.
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
        """Minimal parameters of bodies that the data alone determine."""
        pairs = zip(self.names[: self.count], self.alone[: self.count], strict=True)
        return tuple(name for name, alone in pairs if alone)

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
    problem, parts = _parts(tree, recording, method, made, gravity, settings, threads)
    with one_blas_thread():
        error, tried = prior_error or PRIOR_ERROR, dict[float, float]()
        before = linear_prior(problem, prior, error, parts.whole)
        used = not any(determines(each, before) for each in made)
        if used and prior_error is None:
            offered = [e for e in OFFERED if e <= PRIOR_ERROR or len(parts.splits) > 1]
            tried = errors_of_held_out(problem, prior, parts, offered)
            error = min(reversed(tried), key=lambda each: tried[each])
            before = linear_prior(problem, prior, error, parts.whole)
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
            refitted=_refitted(parts.whole, before.mean, count),
            prior_sigma=np.sqrt(before.variance),
            values=values,
            covariance=covariance,
            share=np.clip(1 - np.diagonal(covariance) / variance, 0.0, 1.0),
            alone=alone,
            worth=before.worth(covariance),
            prior_error=error,
            tried=tried,
            used=used,
            errors=_held_out(problem, before, parts, used=used),
        )


def chosen_prior_error(
    tree: Tree,
    recording: RecordingLike,
    prior: Prior,
    estimates: Sequence[Estimate],
    offered: Sequence[float],
    settings: Settings = DEFAULTS,
) -> dict[float, float]:
    """By error of the bodies, rms of what it leaves of held-out parts over what the file leaves.

    Args:
        tree: The robot.
        recording: That of the estimates.
        prior: The bodies of the model file.
        estimates: By least squares, one a method, with the same settings.
        offered: Errors, in parts of the bodies.
        settings: As for `identify`.
    """
    squares = dict.fromkeys(offered, 0.0)
    for each in estimates:
        problem, parts = _parts(tree, recording, each.method, [each], each.gravity, settings, None)
        with one_blas_thread():
            for error, left in errors_of_held_out(problem, prior, parts, offered).items():
                squares[error] += left**2 / len(estimates)
    return {error: float(np.sqrt(square)) for error, square in squares.items()}


def _parts(
    tree: Tree,
    recording: RecordingLike,
    method: Method,
    made: Sequence[Estimate],
    gravity: ArrayLike | None,
    settings: Settings,
    threads: int | None,
) -> tuple[Problem, Parts]:
    """A problem, and its rows, faults of the instrument that an estimate found taken back."""
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
        size, largest = np.einsum("cii->ci", equations.normal), equations.squares[:, None]
        scale = np.sqrt((largest / np.where(size > 0, size, np.inf)).max(axis=0))
        mean += drives.values(np.zeros((problem.tree.n, 10)), problem.tree)
        root = np.hstack([root, drives.columns * scale])
    left = _refitted(rows, mean, count)
    noise = LEAST**2 * rows.squares(left, rows.constants(left)) / np.maximum(rows.rows, 1.0)
    return LinearPrior(mean, root, np.maximum(noise, np.finfo(float).tiny))


def with_prior(rows: RowProducts, prior: LinearPrior) -> tuple[Array, Array]:
    """Least squares with a prior, under noise that its own residuals show.

    A channel's noise is as strong as what is left, and (1 + r) / (1 - r) rows of a correlation r
    from one to the next say as much as one alone.

    Args:
        rows: Products of the rows that are used.
        prior: Of the unknowns.

    Returns:
        Values, (p,), and their covariance, (p, p).
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
    return prior.mean + prior.root @ z, prior.root @ after @ prior.root.T


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


def errors_of_held_out(
    problem: Problem, prior: Prior, parts: Parts, offered: Sequence[float]
) -> dict[float, float]:
    """By error of the bodies, what it leaves of parts of another kind, or of halves.

    Args:
        problem: The recording.
        prior: The bodies of the model file.
        parts: Of the recording.
        offered: Errors, in parts of the bodies.
    """
    tried = {each: linear_prior(problem, prior, each, parts.whole) for each in offered}
    return {
        each: _held_out(problem, before, parts)[-1].over_file(POSTERIOR)
        for each, before in tried.items()
    }


def _held_out(
    problem: Problem, prior: LinearPrior, parts: Parts, *, used: bool = True
) -> tuple[PredictionErrors, ...]:
    """What the model file and fits of some parts leave of others, split by split."""
    count, none, found = problem.minimal.count, np.zeros(len(problem.channels)), []
    for kind, split in parts.splits.items():
        pairs = []
        for seen, rest in split:
            fits = {REFITTED: _refitted(seen, prior.mean, count), PLAIN: _plain(seen)}
            fits[POSTERIOR] = with_prior(seen, prior)[0] if used else fits[PLAIN]
            said = {name: (values, seen.constants(values)) for name, values in fits.items()}
            pairs.append(({FILE: (prior.mean, none), **said}, rest))
        found.append(prediction_errors(problem, kind, pairs))
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
