"""The fit under coloured noise: unknowns, a calibrated covariance, and what the noise is like.

Two passes after the one that has found the weighted solution: residuals with columns made
orthonormal, so that nothing is lost to the equations' condition; then replicas of the noise.
Unknowns of the instrument, and columns whose traces are looked for, stand beside the robot's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
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
    NOTHING,
    NuisanceColumns,
    Products,
    Whitening,
    whitening_of,
)
from testbed.core.estimation.regression import solvers
from testbed.core.estimation.regression.normal_equations import TINY, scaled_solve
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.regression.windows import Plan

IMITATED = 1e-8
"""Share of a constant's square that the parameters leave of it if they cannot imitate it."""


@dataclass(frozen=True, eq=False)
class Constants:
    """Constants that no parameters can imitate.

    Attributes:
        directions: Combinations of the channels, (C, k), orthonormal.
        hidden: Unknowns that imitate the other constants, (C - k, m).
    """

    directions: Array
    hidden: Array


def constants(given: LaggedProducts) -> Constants:
    """Which constants can be distinguished from the parameters.

    Args:
        given: Products of unknowns' columns, residuals and ones.
    """
    squares = given.products[0]
    m = squares.shape[2] - 2
    normal = squares[:, :m, :m].sum(axis=0)
    mixed = squares[:, :m, m + 1].T  # (m, C)
    counts = squares[:, m + 1, m + 1]
    imitating = scaled_solve(normal, mixed)
    left = np.diag(counts) - mixed.T @ imitating
    spread, axes = eigh((left + left.T) / 2)
    identifiable = spread > IMITATED * max(counts.max(initial=0.0), 1.0)
    return Constants(axes[:, identifiable], (imitating @ axes[:, ~identifiable]).T)


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
    none, m = np.zeros((given.products.shape[1], 0)), given.unknowns
    fits = whitened_fits if whole else weighted_fits
    (plain,) = fits(given)
    taken = None if made is None else correct_attenuation(plain, made)
    alone = plain if taken is None else taken.found
    answer = Answer(alone, fits, none, np.zeros((0, m)), taken)
    if not whole:
        return answer
    there = constants(given)
    answer = replace(answer, hidden=there.hidden)
    count = there.directions.shape[1]
    if given.rows < FEW or not count:
        return answer
    directions = there.directions
    (beside,) = whitened_fits(given.with_constants(directions))
    if made is not None:
        beside = correct_attenuation(beside, made.with_constants(directions)).found
    square = square_of_last(beside, count)
    weight = float(special.expit(square / 2 - count))
    return replace(
        answer,
        found=averaged(alone, beside, weight),
        directions=directions,
        weight=weight,
        square=square,
    )


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


@stage("residuals and replicas of noise")
def generalized_least_squares(
    start: solvers.Fit,
    passes: Passes,
    names: tuple[str, ...],
    beside: NuisanceColumns = NOTHING,
) -> GlsFit:
    """Go on from a weighted solution.

    Args:
        start: The solution, and the weights in whose units rows are taken.
        passes: Over all rows.
        names: Of the robot's unknowns.
        beside: Columns beside theirs.
    """
    units, p = whitening_of(start, beside, passes.plan.layout), len(names)
    m, encoders = units.lead.shape[1], _encoder_noise(passes)
    given = units.products(passes, start.values, HIGHEST, encoders)
    every = units.as_free(given.every)
    made = None if given.noise is None else units.as_free(given.noise)
    answer = averaged_fit(every, made, passes.plan.layout.model == "reaction")
    found, directions = answer.found, answer.directions
    step = units.fixed + units.lead @ found.values[:m]
    values, further = start.values + step[:p], step[p:]
    clues = ScoreTests(units.as_free(given.looked_at), Question(m + beside.trends, beside.tested))
    replicas = Replicas(found.noise, every.with_constants(directions))
    back = _in_channels(units, directions)
    bias, left = back @ found.values[m:], _Left(back)
    repeated = _repetition_sums(passes, found.noise)
    doubt = QuantizationCovariance(found, m)
    for rows in units.rows(passes, values, encoders.again(passes.plan, values)):
        ones = rows.ones[..., None] * directions[:, None]
        columns = units.of_free(rows.columns)
        replicas.add(np.concatenate([columns[..., :m], ones], axis=2), rows.ones)
        clues.add(columns, rows.ones, rows.looked_at)
        doubt.add(columns[..., :m], rows.made)
        far = rows.own - bias[:, None] - rows.further[..., : beside.unknown] @ further
        left.add(far, rows.ones)
        if repeated:
            repeated.add(units.root.T @ far)
    lead = units.lead[:p][units.lead[:p].any(axis=1)]
    factor = replicas.factor(answer.fits, lead)
    by_counts, share = doubt.found()
    spread = factor**2 * found.covariance[:m, :m] + by_counts
    covariance = units.lead @ spread @ units.lead.T
    covariance += _by_facts(units, given.every, directions, found.noise, step)
    noise = replace(
        _found_noise(passes, answer, factor, back, bias),
        hidden=_large(answer.hidden[:, :m] @ units.lead.T, names),
        noise_limited=_noise_limited(answer.alone, units.lead[:p], names),
        least_counts=encoders.least_counts,
        by_counts=share,
        repetition=repeated.found() if repeated else None,
        lateness=_lateness(units, given, answer, start.values, factor, passes.plan),
    )
    tests = clues.found(units.lead[:p])
    own, others = covariance[:p, :p], covariance[p:, p:]
    return GlsFit(values, own, left.squares, noise, further, others, tests)


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
    units: Whitening, given: Products, answer: Answer, values: Array, factor: float, plan: Plan
) -> TimeDelay | None:
    """Of joint torques; of the plate, there are tests that are more sensitive."""
    if plan.layout.model == "reaction" or units.facts is not None or len(plan.weights) == 1:
        return None
    start = np.asarray(np.linalg.solve(units.white, values), dtype=np.float64)
    return lateness(given.every, answer.found, start, factor, plan.rate)


def _by_facts(
    units: Whitening, every: LaggedProducts, directions: Array, noise: Autoregression, step: Array
) -> Array:
    """What doubt about facts adds to the covariance of all unknowns, (p + s, p + s).

    `step` is what was added to them, (p + s,).
    """
    if units.facts is None or units.free is None:
        return np.zeros_like(units.grown)
    count, biases = len(units.fixed), directions.shape[1]
    white = Whitened(every.with_constants(directions), noise.coefficients[None])
    normal = white.sums(noise.sigma[None] ** -2.0)[0, : count + biases, : count + biases]
    lead = linalg.block_diag(units.free.lead, np.eye(biases))
    across = lead.T @ normal
    fixed = np.pad(units.free.fixed, ((0, biases), (0, 0)))
    moved = fixed - lead @ scaled_solve(across @ lead, across @ fixed)
    spread = units.grown @ moved[:count] @ units.facts.doubt(step)
    return np.asarray(spread @ spread.T)


def _found_noise(
    passes: Passes, answer: Answer, factor: float, back: Array, bias: Array
) -> NoiseModel:
    """What the residuals are like; parameters that they say something of are not named yet."""
    noise, count = answer.found.noise, back.shape[1]
    m = len(answer.found.values) - count
    spread = factor**2 * answer.found.covariance[m:, m:]
    return NoiseModel(
        order=noise.order,
        memory=tuple(float(rows) / passes.plan.rate for rows in noise.memory),
        factor=factor,
        bias=bias,
        bias_sigma=np.sqrt(np.einsum("ci,ij,cj->c", back, spread, back)),
        bias_chance=_chance(answer.square / factor**2, count),
        bias_weight=answer.weight,
        span=passes.plan.source.samples / passes.plan.source.rate,
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


class _Left:
    """Sums of the squares of what is left of each channel.

    Under noise that wanders, the likeliest constant may lie far from all that was measured: where
    a channel has one, its residuals are taken about their mean.
    """

    def __init__(self, back: Array) -> None:
        """None yet; `back` are the constants' directions in the channels, (C, k)."""
        self._free = back.any(axis=1)
        self._sums = np.zeros((3, len(back)))

    def add(self, far: Array, ones: Array) -> None:
        """Count residuals, (C, M), where `ones` are not zero."""
        self._sums += [part.sum(axis=1) for part in (ones, far * ones, far**2 * ones)]

    @property
    def squares(self) -> Array:
        """The sums, (C,)."""
        used, first, second = self._sums
        about = second - self._free * first**2 / np.maximum(used, 1.0)
        return np.maximum(about, 0.0)  # rounding, where nothing is left but a constant


def _in_channels(units: Whitening, directions: Array) -> Array:
    """Constants along directions, in the channels as measured, (C, k) [N, N m]."""
    back = np.linalg.inv(units.root.T) @ directions
    back[np.abs(back) < ROUNDING * np.abs(back).max(initial=0.0)] = 0.0
    return back


def _large(part: Array, names: tuple[str, ...]) -> tuple[str, ...]:
    """The first unknowns, by name, with a large part in one of k combinations, (k, p + s)."""
    size = np.abs(part)
    large = size > LARGE * size.max(axis=1, keepdims=True, initial=0.0)
    return tuple(n for n, seen in zip(names, large.any(axis=0), strict=False) if seen)


def _noise_limited(
    found: AttenuationCorrection | None, lead: Array, names: tuple[str, ...]
) -> tuple[str, ...]:
    """Parameters that noise of the encoders hides, of unknowns that make them up, (p, m)."""
    if found is None:
        return ()
    return tuple(n for n, hides in zip(names, found.noise_limited(lead), strict=True) if hides)


def _repetition_sums(passes: Passes, noise: Autoregression) -> PeriodicSums | None:
    """None where the motion has no period, or rows have gaps or are too far apart for it."""
    plan, surveyor = passes.plan, passes.surveyor
    if plan.layout.model != "reaction" or len(plan.spans) > 1:
        return None
    samples = (period_of(surveyor.survey().position) or 0) * surveyor.stride
    rows = round(samples / plan.step)
    period = rows * plan.step / plan.source.rate  # what is compared is so long apart
    return PeriodicSums(noise, rows, period) if rows > HIGHEST else None


def _chance(square: float, count: int) -> float:
    return float(special.chdtrc(count, square)) if count else 1.0
