"""Generalised least squares under coloured noise: unknowns, calibrated covariance, noise model.

Two passes after the one of the weighted solution: residuals with columns made orthonormal, so
that nothing is lost to the equations' condition; then replicas of the noise. Unknowns of the
instrument stand beside the robot's.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
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
    correct_attenuation,
)
from testbed.core.estimation.noise.fits import (
    Fits,
    NoiseFit,
    weighted_fits,
    whitened_fits,
)
from testbed.core.estimation.noise.lagged_products import (
    HIGHEST,
    LaggedProducts,
)
from testbed.core.estimation.noise.noise_model import (
    NoiseModel,
)
from testbed.core.estimation.noise.replicas import Bootstrap, QuantizationSums
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


def constants(products: LaggedProducts) -> tuple[Array, Array]:
    """Constants of the channels that can be distinguished from the parameters.

    Args:
        products: Of unknowns' columns, residuals and ones.

    Returns:
        Combinations of the channels, (C, k), orthonormal; and unknowns that imitate the other
        constants, (C - k, m).
    """
    squares, m = products.products[0], products.unknowns
    mixed = squares[:, :m, -1].T  # (m, C)
    counts = squares[:, -1, -1]
    imitating = scaled_solve(squares[:, :m, :m].sum(axis=0), mixed)
    rest = np.diag(counts) - mixed.T @ imitating
    spread, axes = eigh((rest + rest.T) / 2)
    # share of a constant's square that the parameters leave of it if they cannot imitate it
    identifiable = spread > 1e-8 * max(counts.max(initial=0.0), 1.0)
    return axes[:, identifiable], (imitating @ axes[:, ~identifiable]).T


@dataclass(frozen=True, eq=False)
class AveragedFit:
    """Average of the fits with and without constants of the channels.

    Attributes:
        fit: Unknowns, then constants; its noise is the likelier model's.
        fits: Function that fitted either.
        directions: Combinations of the channels that are constants, (C, k).
        imitating: Unknowns that imitate other constants, (C - k, m).
        correction: Of attenuation, without constants; None where columns have no noise.
        weight: Of the model with constants, 0 to 1.
        chi_square: Of the constants.
    """

    fit: NoiseFit
    fits: Fits
    directions: Array
    imitating: Array
    correction: AttenuationCorrection | None = None
    weight: float = 0.0
    chi_square: float = 0.0

    def chance(self, factor: float) -> float:
        """Probability of constants as large where there are none.

        Args:
            factor: By which sigma is larger than the formula's.
        """
        count = self.directions.shape[1]
        return (
            float(special.chdtrc(count, self.chi_square / factor**2)) if count else 1.0
        )


@stage("fit under coloured noise")
def averaged_fit(
    products: LaggedProducts, noise: LaggedProducts | None, whole: bool
) -> AveragedFit:
    """Unknowns by the fit that suits the rows, averaged over constants where rows suffice.

    Args:
        products: Of unknowns' columns, residuals and ones.
        noise: Products of noise in the same places; None for none.
        whole: Whether no rows are missing.
    """
    fits = whitened_fits if whole else weighted_fits
    (alone,) = fits(products)
    correction = None if noise is None else correct_attenuation(alone, noise)
    if correction is not None:
        alone = correction.fit
    none, imitating = (
        np.zeros((products.products.shape[1], 0)),
        np.zeros((0, products.unknowns)),
    )
    if whole:
        directions, imitating = constants(products)
    # rows below which constants are not looked for
    if not whole or products.rows < 50 or not directions.shape[1]:
        return AveragedFit(alone, fits, none, imitating, correction)
    (beside,) = whitened_fits(products.with_constants(directions))
    if noise is not None:
        beside = correct_attenuation(beside, noise.with_constants(directions)).fit
    own = slice(products.unknowns, None)
    square = (
        scaled_solve(beside.covariance[own, own], beside.values[own])
        @ beside.values[own]
    )
    weight = float(special.expit(square / 2 - directions.shape[1]))
    fit = averaged(alone, beside, weight)
    return AveragedFit(
        fit, fits, directions, imitating, correction, weight, float(square)
    )


def averaged(alone: NoiseFit, beside: NoiseFit, weight: float) -> NoiseFit:
    """Mixture of two fits; without constants, these are zero and certain.

    Args:
        alone: Without constants, (m,).
        beside: With them after the unknowns, (m + k,).
        weight: Of the latter.
    """
    more = (0, len(beside.values) - len(alone.values))
    values = np.pad(alone.values, more)
    apart = beside.values - values

    def mixed(first: Array, second: Array) -> Array:
        return (1 - weight) * np.pad(first, more) + weight * second

    return replace(
        beside if weight > 0.5 else alone,
        values=values + weight * apart,
        covariance=mixed(alone.covariance, beside.covariance)
        + weight * (1 - weight) * np.outer(apart, apart),
        inverse=mixed(alone.inverse, beside.inverse),
    )


@dataclass(frozen=True, eq=False)
class GlsFit:
    """Solution by generalised least squares, its covariance and noise.

    Attributes:
        values: Of the unknowns, (p,).
        covariance: (p, p).
        squares: Sums of the squares of each channel's residuals, (C,).
        noise: Of the residuals.
        sensor_values: Values of the instrument's unknowns, (s,).
        sensor_covariance: Their covariance, (s, s).
    """

    values: Array
    covariance: Array
    squares: Array
    noise: NoiseModel
    sensor_values: Array
    sensor_covariance: Array


@dataclass(frozen=True, eq=False)
class GlsSolution:
    """Generalised least squares in units in which all noise is one.

    Attributes:
        passes: Over all rows.
        encoders: Noise of the positions.
        units: In which all noise is one.
        start: The robot's unknowns before, (p,).
        products: Of rows with rows before them.
        average: Correction of the unknowns, in these units.
    """

    passes: Passes
    encoders: PositionNoise
    units: Whitening
    start: Array
    products: Products
    average: AveragedFit

    @property
    def count(self) -> int:
        """Unknowns that are free, m; those of constants come after them."""
        return int(self.units.basis.shape[1])

    @cached_property
    def step(self) -> Array:
        """Correction of all unknowns, (p + s,)."""
        return (
            self.units.fixed + self.units.basis @ self.average.fit.values[: self.count]
        )

    @cached_property
    def values(self) -> Array:
        """The robot's unknowns, (p,)."""
        return self.start + self.step[: len(self.start)]

    @property
    def sensor_values(self) -> Array:
        """The instrument's unknowns, (s,)."""
        return self.step[len(self.start) :]

    @cached_property
    def constants(self) -> Array:
        """Directions of the constants in the channels as measured, (C, k) [N, N m]."""
        measured = self.average.directions / self.units.root[:, None]
        # part of a channel in a constant that is none but for rounding
        small = np.abs(measured) < 1e-9 * np.abs(measured).max(initial=0.0)
        return np.where(small, 0.0, measured)

    @cached_property
    def bias(self) -> Array:
        """Constants of the channels, (C,) [N, N m]."""
        return np.asarray(self.constants @ self.average.fit.values[self.count :])

    @property
    def bias_sigma(self) -> Array:
        """Standard deviations of the constants by the formula, (C,) [N, N m]."""
        covariance = self.average.fit.covariance[self.count :, self.count :]
        return standard_deviations(self.constants @ covariance @ self.constants.T)

    def rows(self) -> Iterator[WhitenedRows]:
        """Rows with the columns of what is free, and residuals in place of measurements."""
        made = self.encoders.replicas(self.values)
        sensors = self.sensor_values
        for rows in self.units.rows(self.passes, self.values, made):
            of_sensors = rows.sensors[..., : len(sensors)] @ sensors
            residual = rows.measured - self.bias[:, None] - of_sensors
            yield rows._replace(
                columns=self.units.of_free(rows.columns),
                measured=residual,
                white=self.units.root[:, None] * residual,
            )


class ResidualSums:
    """Squares of the channels' residuals, about their mean where a channel has a constant.

    Under noise that wanders, the likeliest constant may lie far from all that was measured.
    """

    def __init__(self, constant: NDArray[np.bool_]) -> None:
        """Nothing yet.

        Args:
            constant: Whether each channel has a constant, (C,).
        """
        self._constant, self._sums = constant, np.zeros((3, len(constant)))

    def add(self, rows: WhitenedRows) -> None:
        """Go on with consecutive rows."""
        residual, ones = rows.measured, rows.ones
        self._sums += np.stack([ones, residual * ones, residual**2 * ones]).sum(axis=2)

    def result(self) -> Array:
        """Sums of squares, (C,)."""
        used, first, second = self._sums
        about = second - self._constant * first**2 / np.maximum(used, 1.0)
        return np.maximum(about, 0.0)  # rounding, where nothing is left but a constant


@stage("residuals and replicas of noise")
def generalized_least_squares(
    start: solvers.Fit, passes: Passes, beside: NuisanceColumns
) -> GlsSolution:
    """Go on from a weighted solution, by one pass.

    Args:
        start: The solution, and the weights in whose units rows are taken.
        passes: Over all rows.
        beside: Columns beside the robot's.
    """
    units, encoders = (
        whitening_of(start, beside, passes.plan.layout),
        _encoder_noise(passes),
    )
    products = units.products(passes, start.values, HIGHEST, encoders)
    average = averaged_fit(
        units.as_free(products.every),
        products.noise and units.as_free(products.noise),
        whole=passes.plan.layout.model == "reaction",
    )
    return GlsSolution(passes, encoders, units, start.values, products, average)


@stage("residuals and replicas of noise")
def bootstrap(solution: GlsSolution, names: tuple[str, ...]) -> GlsFit:
    """Calibrate the covariance by one pass over residuals and replicas of noise.

    Args:
        solution: By generalised least squares.
        names: Of the robot's unknowns.
    """
    units, average, p = solution.units, solution.average, len(names)
    robot = units.basis[:p]
    residuals = ResidualSums(np.any(solution.constants, axis=1))
    known = robot[robot.any(axis=1)]
    replicas = Bootstrap(average.fit.noise, average.directions, known)
    quantization = QuantizationSums(average.fit, solution.count)
    for rows in solution.rows():
        for sums in (residuals, replicas, quantization):
            sums.add(rows)
    factor, (by_counts, share) = replicas.result(average.fits), quantization.result()
    covariance = _covariance(solution, factor, by_counts)
    return GlsFit(
        values=solution.values,
        covariance=covariance[:p, :p],
        squares=residuals.result(),
        noise=_noise_model(solution, names, factor, share),
        sensor_values=solution.sensor_values,
        sensor_covariance=covariance[p:, p:],
    )


def _noise_model(
    solution: GlsSolution,
    names: tuple[str, ...],
    factor: float,
    share: float,
) -> NoiseModel:
    """Noise of the residuals, and the parameters that it hides or limits."""
    average, plan, robot = solution.average, solution.passes.plan, solution.units.basis
    correction, noise = average.correction, average.fit.noise
    limited = () if correction is None else correction.noise_limited(robot)
    return NoiseModel(
        order=noise.order,
        memory=tuple(float(rows) / plan.rate for rows in noise.memory),
        factor=factor,
        bias=solution.bias,
        bias_sigma=factor * solution.bias_sigma,
        bias_chance=average.chance(factor),
        bias_weight=average.weight,
        span=plan.source.samples / plan.source.rate,
        hidden=_named(_large(average.imitating @ robot.T), names),
        noise_limited=_named(limited, names),
        least_counts=solution.encoders.least_counts,
        by_counts=share,
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
        beside: Columns beside theirs.
    """
    units, p = whitening_of(start, beside, passes.plan.layout), len(start.values)
    products = units.products(passes, start.values, 0).every
    (fit,) = whitened_fits(units.as_free(products), 0)
    own = slice(p, p + beside.unknown)
    squares = np.einsum("c,cii->i", fit.noise.sigma**-2.0, products.products[0])[own]
    basis = units.basis[own]
    variance = np.einsum("si,ij,sj->s", basis, fit.covariance, basis)
    variance = np.maximum(variance, TINY)
    share = 1 / np.sqrt(np.maximum(squares * variance, 1.0))
    share[~basis.any(axis=1)] = 1.0  # known
    return (units.fixed + units.basis @ fit.values)[own], np.sqrt(variance), share


def _covariance(solution: GlsSolution, factor: float, by_counts: Array) -> Array:
    """Of all unknowns, (p + s, p + s): by the fit, by counts of encoders, by doubt about facts."""
    units, average, m = solution.units, solution.average, solution.count
    spread = factor**2 * average.fit.covariance[:m, :m] + by_counts
    covariance = np.asarray(units.basis @ spread @ units.basis.T)
    facts = units.beside.facts
    if facts is None or units.free is None:
        return covariance
    size, biases = len(units.fixed), average.directions.shape[1]
    products = solution.products.every.with_constants(average.directions)
    normal = average.fit.normal(products)[: size + biases, : size + biases]
    basis = linalg.block_diag(units.free.lead, np.eye(biases))
    fixed = np.pad(units.free.fixed, ((0, biases), (0, 0)))
    across = basis.T @ normal
    moved = fixed - basis @ scaled_solve(across @ basis, across @ fixed)
    root = units.grown @ moved[:size] @ facts.doubt(solution.step)
    return np.asarray(covariance + root @ root.T)


def _encoder_noise(passes: Passes) -> PositionNoise:
    """Noise of the encoders that is in the columns; zero where it is none, or unknown."""
    plan, survey = passes.plan, passes.surveyor.survey()
    inferred = not plan.source.senses_kinematics
    filtered = inferred and len(plan.weights) > 1
    return PositionNoise(
        plan, survey.encoder_noise * inferred, survey.encoder_count * filtered
    )


def _named(which: Iterable[bool], names: tuple[str, ...]) -> tuple[str, ...]:
    """The first unknowns of those that are named, (p,) or more."""
    return tuple(name for name, named in zip(names, which, strict=False) if named)


def _large(part: Array) -> NDArray[np.bool_]:
    """Unknowns with a large part in one of k combinations, (k, p + s)."""
    size = np.abs(part)
    # an unknown with a larger part than this in a combination is named
    large = size > 0.1 * size.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(large.any(axis=0))
