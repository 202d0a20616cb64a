"""The fit under coloured noise: unknowns, a calibrated covariance, and what the noise is like.

Two passes after the one that has found the weighted solution: residuals with columns made
orthonormal, so that nothing is lost to the equations' condition; then replicas of the noise.
Unknowns of the instrument, and columns whose traces are looked for, stand beside the robot's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.stages import stage
from testbed.core.estimation.noise.errors_in_variables import (
    AttenuationCorrection,
    PositionNoise,
    QuantizationCovariance,
    correct_attenuation,
)
from testbed.core.estimation.noise.fits import Fits, NoiseFit, weighted_fits, whitened_fits
from testbed.core.estimation.noise.lagged_products import (
    HIGHEST,
    Autoregression,
    LaggedProducts,
    Whitened,
)
from testbed.core.estimation.noise.noise_model import (
    NoiseModel,
    PeriodicSums,
    TimeDelay,
    lateness,
    period_of,
)
from testbed.core.estimation.noise.score_tests import Question, Replicas, ScoreTests, Trace
from testbed.core.estimation.noise.whitening import (
    NuisanceColumns,
    Products,
    WhitenedRows,
    Whitening,
    whitening_of,
)
from testbed.core.estimation.regression import solvers
from testbed.core.estimation.regression.normal_equations import (
    TINY,
    scaled_solve,
    standard_deviations,
)
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.regression.windows import Plan

IMITATED = 1e-8
"""Share of a constant's square that the parameters leave of it if they cannot imitate it."""


def constants(given: LaggedProducts) -> tuple[Array, Array]:
    """Constants of the channels that can be distinguished from the parameters.

    Args:
        given: Products of unknowns' columns, residuals and ones.

    Returns:
        Combinations of the channels, (C, k), orthonormal; and unknowns that imitate the other
        constants, (C - k, m).
    """
    squares = given.products[0]
    m = given.unknowns
    mixed = squares[:, :m, -1].T  # (m, C)
    counts = squares[:, -1, -1]
    imitating = scaled_solve(squares[:, :m, :m].sum(axis=0), mixed)
    left = np.diag(counts) - mixed.T @ imitating
    spread, axes = eigh((left + left.T) / 2)
    identifiable = spread > IMITATED * max(counts.max(initial=0.0), 1.0)
    return axes[:, identifiable], (imitating @ axes[:, ~identifiable]).T


def square_of_last(found: NoiseFit, count: int) -> float:
    """How far the last `count` unknowns of a fit are from zero: a chi-square if they are."""
    if not count:
        return 0.0
    values, covariance = found.values[-count:], found.covariance[-count:, -count:]
    return float(values @ scaled_solve(covariance, values))


FEW = 50
"""Rows below which constants are not looked for."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Unknowns, and then constants, of both models together.

    Attributes:
        found: Averaged; its noise is the likelier model's.
        fits: What fitted either.
        directions: Combinations of the channels that are constants, (C, k).
        hidden: Unknowns that imitate other constants, (C - k, m).
        alone: Without constants, noise in the columns taken back; None where none was known.
        weight: Of the model with constants, 0 to 1.
        square: How far constants are from zero: a chi-square if they are.
    """

    found: NoiseFit
    fits: Fits
    directions: Array
    hidden: Array
    alone: AttenuationCorrection | None = None
    weight: float = 0.0
    square: float = 0.0


@stage("fit under coloured noise")
def averaged_fit(given: LaggedProducts, made: LaggedProducts | None, whole: bool) -> Answer:
    """Unknowns by the fit that suits the rows, constants averaged where there are rows enough.

    Args:
        given: Products of unknowns' columns, residuals and ones.
        made: Of noise in the same places; None for none.
        whole: Whether no rows are missing.
    """
    fits = whitened_fits if whole else weighted_fits
    (alone,) = fits(given)
    correction = None if made is None else correct_attenuation(alone, made)
    if correction is not None:
        alone = correction.found
    none = np.zeros((given.products.shape[1], 0))
    answer = Answer(alone, fits, none, np.zeros((0, given.unknowns)), correction)
    if not whole:
        return answer
    directions, hidden = constants(given)
    count = directions.shape[1]
    if given.rows < FEW or not count:
        return replace(answer, hidden=hidden)
    (beside,) = whitened_fits(given.with_constants(directions))
    if made is not None:
        beside = correct_attenuation(beside, made.with_constants(directions)).found
    square = square_of_last(beside, count)
    weight = float(special.expit(square / 2 - count))
    found = averaged(alone, beside, weight)
    return Answer(found, fits, directions, hidden, correction, weight, square)


def averaged(alone: NoiseFit, beside: NoiseFit, weight: float) -> NoiseFit:
    """Both answers; without constants they are zero, for sure.

    Args:
        alone: Without constants, (m,).
        beside: With them after the unknowns, (m + k,).
        weight: Of the latter.
    """
    m, every = len(alone.values), len(beside.values)
    values, covariance, inverse = np.zeros(every), *np.zeros((2, every, every))
    values[:m], covariance[:m, :m], inverse[:m, :m] = alone.values, alone.covariance, alone.inverse
    likelier = beside if weight > 0.5 else alone
    apart = beside.values - values
    return NoiseFit(
        values=values + weight * apart,
        covariance=(1 - weight) * covariance
        + weight * beside.covariance
        + weight * (1 - weight) * np.outer(apart, apart),
        noise=likelier.noise,
        weighting=likelier.weighting,
        inverse=(1 - weight) * inverse + weight * beside.inverse,
    )


ROUNDING = 1e-9
"""Part of a channel in a constant that is none but for rounding."""

LARGE = 0.1
"""An unknown with a larger part than this in a combination is named."""


@dataclass(frozen=True, eq=False)
class GlsFit:
    """A solution after the passes that look at the residuals themselves.

    Attributes:
        values: Of the unknowns, (p,).
        covariance: (p, p).
        squares: Sums of the squares of each channel's residuals, (C,).
        noise: What they are like.
        further: Values of the instrument's unknowns, (s,).
        further_covariance: Theirs, (s, s).
        traces: Of each kind of fault that was looked for, and its chance in mere noise.
    """

    values: Array
    covariance: Array
    squares: Array
    noise: NoiseModel
    further: Array
    further_covariance: Array
    traces: tuple[tuple[Trace, float], ...]


@dataclass(frozen=True, eq=False)
class _Solution:
    """Generalised least squares, by units in which all noise is one.

    Attributes:
        units: These units.
        start: The robot's unknowns before, (p,).
        answer: What is to be added, in these units.
    """

    units: Whitening
    start: Array
    answer: Answer

    @property
    def count(self) -> int:
        """Unknowns that are free, m; those of constants come after them."""
        return int(self.units.lead.shape[1])

    @cached_property
    def step(self) -> Array:
        """What is added to all unknowns, (p + s,)."""
        values = self.answer.found.values[: self.count]
        return self.units.fixed + self.units.lead @ values

    @cached_property
    def values(self) -> Array:
        """The robot's unknowns, (p,)."""
        return self.start + self.step[: len(self.start)]

    @property
    def further(self) -> Array:
        """The instrument's unknowns, (s,)."""
        return self.step[len(self.start) :]

    @cached_property
    def constants(self) -> Array:
        """Directions of the constants in the channels as measured, (C, k) [N, N m]."""
        found = self.answer.directions / self.units.root[:, None]
        found[np.abs(found) < ROUNDING * np.abs(found).max(initial=0.0)] = 0.0
        return found

    @property
    def bias(self) -> Array:
        """Constants of the channels, (C,) [N, N m]."""
        return np.asarray(self.constants @ self.answer.found.values[self.count :])

    def residual(self, rows: WhitenedRows) -> Array:
        """Residuals of a block of rows, (C, M) [N, N m]."""
        of_sensors = rows.further[..., : len(self.further)] @ self.further
        return np.asarray(rows.own - self.bias[:, None] - of_sensors)


class _SecondPass:
    """Bootstrap, tests, quantization, repetition and residuals, block by block of rows."""

    def __init__(
        self, solution: _Solution, given: Products, passes: Passes, beside: NuisanceColumns
    ) -> None:
        units, found, m = solution.units, solution.answer.found, solution.count
        every = units.as_free(given.every)
        question = Question(m + beside.trends, beside.tested)
        self._solution = solution
        self._sums = np.zeros((3, len(units.root)))
        self.tests = ScoreTests(units.as_free(given.looked_at), question)
        self.bootstrap = Replicas(found.noise, every.with_constants(solution.answer.directions))
        self.quantization = QuantizationCovariance(found, m)
        self.repetition = _repetition_sums(passes, found.noise)

    def add(self, rows: WhitenedRows) -> None:
        """Go on with consecutive rows."""
        solution, ones = self._solution, rows.ones
        columns = solution.units.of_free(rows.columns)
        own = columns[..., : solution.count]
        constant = ones[..., None] * solution.answer.directions[:, None]
        residual = solution.residual(rows)
        self.bootstrap.add(np.concatenate([own, constant], axis=2), ones)
        self.tests.add(columns, ones, rows.looked_at)
        self.quantization.add(own, rows.made)
        self._sums += [part.sum(axis=1) for part in (ones, residual * ones, residual**2 * ones)]
        if self.repetition:
            self.repetition.add(solution.units.root[:, None] * residual)

    @property
    def squares(self) -> Array:
        """Squares of the channels' residuals, (C,).

        Under noise that wanders, the likeliest constant may lie far from all that was measured:
        where a channel has one, its residuals are taken about their mean.
        """
        used, first, second = self._sums
        constant = self._solution.constants.any(axis=1)
        about = second - constant * first**2 / np.maximum(used, 1.0)
        return np.maximum(about, 0.0)  # rounding, where nothing is left but a constant


@stage("residuals and replicas of noise")
def generalized_least_squares(
    start: solvers.Fit,
    passes: Passes,
    names: tuple[str, ...],
    beside: NuisanceColumns,
) -> GlsFit:
    """Go on from a weighted solution.

    Args:
        start: The solution, and the weights in whose units rows are taken.
        passes: Over all rows.
        names: Of the robot's unknowns.
        beside: Columns beside theirs.
    """
    plan, p = passes.plan, len(names)
    units = whitening_of(start, beside, plan.layout)
    encoders = _encoder_noise(passes)
    given = units.products(passes, start.values, HIGHEST, encoders)
    answer = averaged_fit(
        units.as_free(given.every),
        None if given.noise is None else units.as_free(given.noise),
        whole=plan.layout.model == "reaction",
    )
    solution = _Solution(units, start.values, answer)
    second = _SecondPass(solution, given, passes, beside)
    for rows in units.rows(passes, solution.values, encoders.again(plan, solution.values)):
        second.add(rows)
    lead = units.lead[:p]
    factor = second.bootstrap.factor(answer.fits, lead[lead.any(axis=1)])
    by_counts, share = second.quantization.found()
    covariance = _covariance(solution, given.every, factor, by_counts)
    noise = replace(
        _noise_model(solution, plan, factor),
        hidden=_named(_large(answer.hidden[:, : solution.count] @ units.lead.T), names),
        noise_limited=_named(answer.alone.noise_limited(lead), names) if answer.alone else (),
        least_counts=encoders.least_counts,
        by_counts=share,
        repetition=second.repetition.found() if second.repetition else None,
        lateness=_lateness(solution, given.every, factor, plan),
    )
    return GlsFit(
        values=solution.values,
        covariance=covariance[:p, :p],
        squares=second.squares,
        noise=noise,
        further=solution.further,
        further_covariance=covariance[p:, p:],
        traces=second.tests.found(lead),
    )


def sensor_step(
    start: solvers.Fit, passes: Passes, beside: NuisanceColumns
) -> tuple[Array, Array, Array]:
    """The instrument's unknowns alone, (s,), their sigma as if noise were white, and their shares.

    Good enough to correct a recording with: the fit that follows knows better. The share is how
    much of an unknown's effect is its own, (s,): the rest others can show, too.

    Args:
        start: A weighted solution of the robot's unknowns.
        passes: Over all rows.
        beside: Columns beside theirs, no tested ones among them.
    """
    units, p = whitening_of(start, beside, passes.plan.layout), len(start.values)
    given = units.products(passes, start.values, 0).every
    (found,) = whitened_fits(units.as_free(given), 0)
    own = slice(p, p + beside.unknown)
    squares = np.einsum("c,cii->i", found.noise.sigma**-2.0, given.products[0])[own]
    lead = units.lead[own]
    variance = np.einsum("si,ij,sj->s", lead, found.covariance, lead)
    variance = np.maximum(variance, TINY)
    share = 1 / np.sqrt(np.maximum(squares * variance, 1.0))
    share[~lead.any(axis=1)] = 1.0  # known
    return (units.fixed + units.lead @ found.values)[own], np.sqrt(variance), share


def _lateness(
    solution: _Solution, every: LaggedProducts, factor: float, plan: Plan
) -> TimeDelay | None:
    """Of joint torques; of the plate, there are tests that are more sensitive."""
    units = solution.units
    if plan.layout.model == "reaction" or units.facts is not None or len(plan.weights) == 1:
        return None
    start = np.asarray(np.linalg.solve(units.white, solution.start), dtype=np.float64)
    return lateness(every, solution.answer.found, start, factor, plan.rate)


def _covariance(
    solution: _Solution, every: LaggedProducts, factor: float, by_counts: Array
) -> Array:
    """Of all unknowns, (p + s, p + s): by the fit, by counts of encoders, by doubt about facts."""
    units, answer, m = solution.units, solution.answer, solution.count
    spread = factor**2 * answer.found.covariance[:m, :m] + by_counts
    covariance = np.asarray(units.lead @ spread @ units.lead.T)
    if units.facts is None or units.free is None:
        return covariance
    noise, biases = answer.found.noise, answer.directions.shape[1]
    white = Whitened(every.with_constants(answer.directions), noise.coefficients[None])
    size = len(units.fixed) + biases
    normal = white.sums(noise.sigma[None] ** -2.0)[0, :size, :size]
    lead = linalg.block_diag(units.free.lead, np.eye(biases))
    fixed = np.pad(units.free.fixed, ((0, biases), (0, 0)))
    across = lead.T @ normal
    moved = fixed - lead @ scaled_solve(across @ lead, across @ fixed)
    root = units.grown @ moved[: len(units.fixed)] @ units.facts.doubt(solution.step)
    return np.asarray(covariance + root @ root.T)


def _noise_model(solution: _Solution, plan: Plan, factor: float) -> NoiseModel:
    """What the residuals are like; parameters that they say something of are not named yet."""
    answer, m, back = solution.answer, solution.count, solution.constants
    noise, count = answer.found.noise, back.shape[1]
    spread = back @ answer.found.covariance[m:, m:] @ back.T
    chance = float(special.chdtrc(count, answer.square / factor**2)) if count else 1.0
    return NoiseModel(
        order=noise.order,
        memory=tuple(float(rows) / plan.rate for rows in noise.memory),
        factor=factor,
        bias=solution.bias,
        bias_sigma=factor * standard_deviations(spread),
        bias_chance=chance,
        bias_weight=answer.weight,
        span=plan.source.samples / plan.source.rate,
        hidden=(),
    )


def _encoder_noise(passes: Passes) -> PositionNoise:
    """Noise of the encoders that is in the columns; zero where it is none, or unknown."""
    plan, survey = passes.plan, passes.surveyor.survey()
    none = np.zeros(plan.layout.tree.n)
    if plan.source.senses_kinematics:
        return PositionNoise(none, none)
    filtered = len(plan.weights) > 1
    return PositionNoise(survey.encoder_noise, survey.encoder_count if filtered else none)


def _named(which: NDArray[np.bool_], names: tuple[str, ...]) -> tuple[str, ...]:
    """The first unknowns of those that are named, (p,) or more."""
    return tuple(name for name, named in zip(names, which, strict=False) if named)


def _large(part: Array) -> NDArray[np.bool_]:
    """Unknowns with a large part in one of k combinations, (k, p + s)."""
    size = np.abs(part)
    large = size > LARGE * size.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(large.any(axis=0))


def _repetition_sums(passes: Passes, noise: Autoregression) -> PeriodicSums | None:
    """None where the motion has no period, or rows have gaps or are too far apart for it."""
    plan, surveyor = passes.plan, passes.surveyor
    if plan.layout.model != "reaction" or len(plan.spans) > 1:
        return None
    samples = (period_of(surveyor.survey().position) or 0) * surveyor.stride
    rows = round(samples / plan.step)
    period = rows * plan.step / plan.source.rate  # what is compared is so long apart
    return PeriodicSums(noise, rows, period) if rows > HIGHEST else None
