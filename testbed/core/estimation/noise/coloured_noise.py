"""Generalised least squares under coloured noise, with calibrated covariance.

Two passes over the rows follow the weighted least-squares solution. The first computes residuals
with orthonormal columns, so that no accuracy is lost to the condition of the normal equations; the
second calibrates the covariance by replicas of the noise. Sensor unknowns are estimated together
with the robot unknowns.
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
from testbed.core.base.stages import timed_stage
from testbed.core.estimation.noise.errors_in_variables import (
    AttenuationCorrection,
    PositionNoise,
    correct_attenuation,
)
from testbed.core.estimation.noise.fits import (
    FitFunction,
    NoiseFit,
    weighted_fits,
    whitened_fits,
)
from testbed.core.estimation.noise.lagged_products import (
    MAX_AUTOREGRESSION_ORDER,
    LaggedProducts,
)
from testbed.core.estimation.noise.noise_model import NoiseModel
from testbed.core.estimation.noise.replicas import Bootstrap, QuantizationSums
from testbed.core.estimation.noise.whitening import (
    NuisanceColumns,
    ProductsWithNoise,
    WhitenedRows,
    Whitening,
    whitening_of,
)
from testbed.core.estimation.regression import solvers
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    solve_scaled,
    standard_deviations,
)
from testbed.core.estimation.regression.passes import Passes


def identifiable_constants(products: LaggedProducts) -> tuple[Array, Array]:
    """Separate identifiable channel offsets from offsets collinear with the unknowns.

    An eigenvector of the offsets' Schur complement in the normal matrix (lag zero) is identifiable
    if its eigenvalue exceeds 1e-8 times the largest number of rows.

    Args:
        products: Lagged products of the unknowns' columns, residuals and row indicators.

    Returns:
        Orthonormal channel combinations with an identifiable offset, (C, k), and combinations of
            the unknowns equivalent to each remaining offset, (C - k, m).
    """
    squares, m = products.products[0], products.unknowns
    mixed = squares[:, :m, -1].T  # (m, C)
    counts = squares[:, -1, -1]
    combinations = solve_scaled(squares[:, :m, :m].sum(axis=0), mixed)
    rest = np.diag(counts) - mixed.T @ combinations
    spread, axes = eigh((rest + rest.T) / 2)
    # smallest part of a constant's square that is left if the parameters cannot imitate it
    identifiable = spread > 1e-8 * max(counts.max(initial=0.0), 1.0)
    return axes[:, identifiable], (combinations @ axes[:, ~identifiable]).T


@dataclass(frozen=True, eq=False)
class AveragedFit:
    """Average of the fits with and without constant channel offsets.

    Attributes:
        fit: Estimates of the unknowns, then of the constants; noise of the more likely model.
        fit_function: Function that computed both fits.
        directions: Combinations of the channels with a constant offset, (C, k).
        collinear_unknowns: Combinations of unknowns equivalent to the other offsets, (C - k, m).
        correction: Attenuation correction of the fit without constants; None if columns have no
            noise.
        weight: Weight of the model with constants, 0 to 1.
        chi_square: Wald statistic of the constants.
    """

    fit: NoiseFit
    fit_function: FitFunction
    directions: Array
    collinear_unknowns: Array
    correction: AttenuationCorrection | None = None
    weight: float = 0.0
    chi_square: float = 0.0

    def p_value(self, factor: float) -> float:
        """P-value of the constants from a chi-square test; 1 if there are no constants.

        Args:
            factor: Ratio of the calibrated to the formal standard deviations.
        """
        count = self.directions.shape[1]
        return (
            float(special.chdtrc(count, self.chi_square / factor**2)) if count else 1.0
        )


@timed_stage("fit under coloured noise")
def averaged_fit(
    products: LaggedProducts, noise: LaggedProducts | None, gapless: bool
) -> AveragedFit:
    """Fit under coloured noise, averaged over models with and without constants.

    Akaike weights are used. Constants require at least 50 rows, no gaps and an identifiable offset.

    Args:
        products: Lagged products of the unknowns' columns, residuals and row indicators.
        noise: Lagged products of the encoder noise in the columns; None for no correction.
        gapless: True if no rows are missing.
    """
    fit_function = whitened_fits if gapless else weighted_fits
    (plain,) = fit_function(products)
    correction = None if noise is None else correct_attenuation(plain, noise)
    if correction is not None:
        plain = correction.fit
    no_directions, collinear_unknowns = (
        np.zeros((products.products.shape[1], 0)),
        np.zeros((0, products.unknowns)),
    )
    if gapless:
        directions, collinear_unknowns = identifiable_constants(products)
    # smallest number of rows for the estimation of constants
    if not gapless or products.rows < 50 or not directions.shape[1]:
        return AveragedFit(
            plain, fit_function, no_directions, collinear_unknowns, correction
        )
    (extended,) = whitened_fits(products.with_constants(directions))
    if noise is not None:
        extended = correct_attenuation(extended, noise.with_constants(directions)).fit
    constants = slice(products.unknowns, None)
    square = (
        solve_scaled(
            extended.covariance[constants, constants], extended.values[constants]
        )
        @ extended.values[constants]
    )
    weight = float(special.expit(square / 2 - directions.shape[1]))
    fit = mixture_fit(plain, extended, weight)
    return AveragedFit(
        fit,
        fit_function,
        directions,
        collinear_unknowns,
        correction,
        weight,
        float(square),
    )


def mixture_fit(plain: NoiseFit, extended: NoiseFit, weight: float) -> NoiseFit:
    """Mean and covariance of a mixture of the fits without and with constants.

    The fit without constants contributes constants of zero with zero variance.

    Args:
        plain: Fit without constants, (m,).
        extended: Fit with constants after the unknowns, (m + k,).
        weight: Weight of the fit with constants.
    """
    padding = (0, len(extended.values) - len(plain.values))
    values = np.pad(plain.values, padding)
    difference = extended.values - values

    def mixed_matrix(first: Array, second: Array) -> Array:
        return (1 - weight) * np.pad(first, padding) + weight * second

    return replace(
        extended if weight > 0.5 else plain,
        values=values + weight * difference,
        covariance=mixed_matrix(plain.covariance, extended.covariance)
        + weight * (1 - weight) * np.outer(difference, difference),
        inverse=mixed_matrix(plain.inverse, extended.inverse),
    )


@dataclass(frozen=True, eq=False)
class GlsFit:
    """Generalised least-squares solution with calibrated covariance and noise model.

    Attributes:
        values: Robot unknowns, (p,).
        covariance: Covariance of the robot unknowns, (p, p).
        residual_squares: Sum of squared residuals of each channel, (C,).
        noise: Noise model of the residuals.
        sensor_values: Sensor unknowns, (s,).
        sensor_covariance: Covariance of the sensor unknowns, (s, s).
    """

    values: Array
    covariance: Array
    residual_squares: Array
    noise: NoiseModel
    sensor_values: Array
    sensor_covariance: Array


@dataclass(frozen=True, eq=False)
class GlsSolution:
    """Generalised least-squares solution in whitened units, before calibration.

    Attributes:
        passes: Passes over all rows.
        encoders: Encoder noise.
        units: Whitening, which scales the noise to unit variance.
        start: Robot unknowns of the preceding weighted solution, (p,).
        products: Lagged products of the rows.
        average: Averaged fit of the correction to the unknowns, in whitened units.
    """

    passes: Passes
    encoders: PositionNoise
    units: Whitening
    start: Array
    products: ProductsWithNoise
    average: AveragedFit

    @property
    def count(self) -> int:
        """Number m of free unknowns, which precede the constants in the fit."""
        return int(self.units.basis.shape[1])

    @cached_property
    def step(self) -> Array:
        """Correction of all unknowns, robot and sensors, (p + s,)."""
        return (
            self.units.fixed_values
            + self.units.basis @ self.average.fit.values[: self.count]
        )

    @cached_property
    def values(self) -> Array:
        """Robot unknowns, (p,)."""
        return self.start + self.step[: len(self.start)]

    @property
    def sensor_values(self) -> Array:
        """Sensor unknowns, (s,)."""
        return self.step[len(self.start) :]

    @cached_property
    def bias_directions(self) -> Array:
        """Channel combinations with a constant offset, in measured units, (C, k) [N, N m]."""
        measured = self.average.directions / self.units.root[:, None]
        # components below this are rounding errors
        small = np.abs(measured) < 1e-9 * np.abs(measured).max(initial=0.0)
        return np.where(small, 0.0, measured)

    @cached_property
    def bias(self) -> Array:
        """Estimated constant offset of each channel, (C,) [N, N m]."""
        return np.asarray(self.bias_directions @ self.average.fit.values[self.count :])

    @property
    def bias_sigma(self) -> Array:
        """Standard deviations of the constant offsets before calibration, (C,) [N, N m]."""
        covariance = self.average.fit.covariance[self.count :, self.count :]
        return standard_deviations(
            self.bias_directions @ covariance @ self.bias_directions.T
        )

    def rows(self) -> Iterator[WhitenedRows]:
        """Yield rows with the free unknowns' columns and the solution's residuals."""
        replica_columns = self.encoders.replicas(self.values)
        sensors = self.sensor_values
        for rows in self.units.rows(self.passes, self.values, replica_columns):
            sensor_part = rows.sensors[..., : len(sensors)] @ sensors
            residual = rows.measured - self.bias[:, None] - sensor_part
            yield rows._replace(
                columns=self.units.free_columns(rows.columns),
                measured=residual,
                white=self.units.root[:, None] * residual,
            )


class ResidualSums:
    """Sums of squared residuals, relative to the mean in channels with a constant.

    The mean is used because the estimated constant may be far from it under long-memory noise.
    """

    def __init__(self, constant: NDArray[np.bool_]) -> None:
        """Start with zero sums.

        Args:
            constant: True for channels with a constant, (C,).
        """
        self._constant, self._sums = constant, np.zeros((3, len(constant)))

    def add(self, rows: WhitenedRows) -> None:
        """Add a block of consecutive rows."""
        residual, ones = rows.measured, rows.ones
        self._sums += np.stack([ones, residual * ones, residual**2 * ones]).sum(axis=2)

    def result(self) -> Array:
        """Sum of squared residuals of each channel, (C,)."""
        used, first, second = self._sums
        about = second - self._constant * first**2 / np.maximum(used, 1.0)
        return np.maximum(about, 0.0)  # rounding errors, if the residual is constant


@timed_stage("residuals and replicas of noise")
def generalized_least_squares(
    start: solvers.Fit, passes: Passes, nuisances: NuisanceColumns
) -> GlsSolution:
    """Refine a weighted solution by generalised least squares, in one pass.

    Args:
        start: Weighted solution, whose weights scale the rows.
        passes: Passes over all rows.
        nuisances: Columns of the sensor unknowns.
    """
    units, encoders = (
        whitening_of(start, nuisances, passes.plan.layout),
        _encoder_noise(passes),
    )
    products = units.products(passes, start.values, MAX_AUTOREGRESSION_ORDER, encoders)
    average = averaged_fit(
        units.free_products(products.measured),
        products.noise and units.free_products(products.noise),
        gapless=passes.plan.layout.model == "wrench",
    )
    return GlsSolution(passes, encoders, units, start.values, products, average)


@timed_stage("residuals and replicas of noise")
def bootstrap_calibrated_fit(solution: GlsSolution, names: tuple[str, ...]) -> GlsFit:
    """Calibrate the covariance by a parametric bootstrap, in one pass.

    Args:
        solution: Generalised least-squares solution.
        names: Names of the robot unknowns, (p,).
    """
    units, average, p = solution.units, solution.average, len(names)
    robot = units.basis[:p]
    residuals = ResidualSums(np.any(solution.bias_directions, axis=1))
    estimated = robot[robot.any(axis=1)]
    replicas = Bootstrap(average.fit.noise, average.directions, estimated)
    quantization = QuantizationSums(average.fit, solution.count)
    for rows in solution.rows():
        for sums in (residuals, replicas, quantization):
            sums.add(rows)
    factor, (count_covariance, share) = (
        replicas.result(average.fit_function),
        quantization.result(),
    )
    covariance = _covariance(solution, factor, count_covariance)
    return GlsFit(
        values=solution.values,
        covariance=covariance[:p, :p],
        residual_squares=residuals.result(),
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
    """Noise model, with names of parameters collinear with constants or limited by encoder noise.

    Args:
        solution: Generalised least-squares solution.
        names: Names of the robot unknowns, (p,).
        factor: Bootstrap factor on standard deviations.
        share: Fraction of the whitened residuals' sum of squares due to encoder quantisation.
    """
    average, plan, robot = solution.average, solution.passes.plan, solution.units.basis
    correction, noise = average.correction, average.fit.noise
    limited_flags = () if correction is None else correction.noise_limited(robot)
    return NoiseModel(
        order=noise.order,
        memory=tuple(float(rows) / plan.rate for rows in noise.decay_rows),
        factor=factor,
        bias=solution.bias,
        bias_sigma=factor * solution.bias_sigma,
        bias_chance=average.p_value(factor),
        bias_weight=average.weight,
        span=plan.source.samples / plan.source.rate,
        hidden=_flagged_names(
            _large_components(average.collinear_unknowns @ robot.T), names
        ),
        noise_limited=_flagged_names(limited_flags, names),
        least_counts=solution.encoders.least_counts,
        by_counts=share,
    )


def white_noise_sensor_estimate(
    start: solvers.Fit, passes: Passes, nuisances: NuisanceColumns
) -> tuple[Array, Array, Array]:
    """Sensor unknowns under white noise, with standard deviations and shares, (s,) each.

    They are accurate enough to correct a recording before the final fit. The share is sqrt(1 - R^2)
    for the regression of an unknown's column on all other columns; 1 for known unknowns.

    Args:
        start: Weighted solution of the robot unknowns.
        passes: Passes over all rows.
        nuisances: Columns of the sensor unknowns.
    """
    units, p = whitening_of(start, nuisances, passes.plan.layout), len(start.values)
    products = units.products(passes, start.values, 0).measured
    (fit,) = whitened_fits(units.free_products(products), 0)
    own = slice(p, p + nuisances.count)
    squares = np.einsum("c,cii->i", fit.noise.sigma**-2.0, products.products[0])[own]
    basis = units.basis[own]
    variance = np.einsum("si,ij,sj->s", basis, fit.covariance, basis)
    variance = np.maximum(variance, SMALLEST_POSITIVE)
    share = 1 / np.sqrt(np.maximum(squares * variance, 1.0))
    share[~basis.any(axis=1)] = 1.0  # known
    return (
        (units.fixed_values + units.basis @ fit.values)[own],
        np.sqrt(variance),
        share,
    )


def _covariance(solution: GlsSolution, factor: float, count_covariance: Array) -> Array:
    """Covariance of all unknowns, (p + s, p + s).

    It sums the contributions of noise, encoder quantisation and uncertain constraints.

    Args:
        solution: Generalised least-squares solution.
        factor: Bootstrap factor on standard deviations.
        count_covariance: Covariance of the free unknowns due to encoder quantisation, (m, m).
    """
    units, average, m = solution.units, solution.average, solution.count
    spread = factor**2 * average.fit.covariance[:m, :m] + count_covariance
    covariance = np.asarray(units.basis @ spread @ units.basis.T)
    facts = units.nuisances.constraints
    if facts is None or units.free is None:
        return covariance
    size, biases = len(units.fixed_values), average.directions.shape[1]
    products = solution.products.measured.with_constants(average.directions)
    normal = average.fit.normal(products)[: size + biases, : size + biases]
    basis = linalg.block_diag(units.free.basis, np.eye(biases))
    fixed = np.pad(units.free.right_inverse, ((0, biases), (0, 0)))
    across = basis.T @ normal
    change = fixed - basis @ solve_scaled(across @ basis, across @ fixed)
    root = units.full_map @ change[:size] @ facts.covariance_root(solution.step)
    return np.asarray(covariance + root @ root.T)


def _encoder_noise(passes: Passes) -> PositionNoise:
    """Encoder noise in the regressor columns; zero if velocities and accelerations are measured.

    Quantisation is included only where rows are filtered.
    """
    plan, survey = passes.plan, passes.surveyor.survey()
    inferred = not plan.source.senses_kinematics
    filtered = inferred and len(plan.weights) > 1
    return PositionNoise(
        plan, survey.encoder_noise * inferred, survey.encoder_count * filtered
    )


def _flagged_names(flags: Iterable[bool], names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the unknowns whose flag is set.

    Args:
        flags: Flags, one per unknown; flags beyond the last name are ignored.
        names: Names of the robot unknowns, (p,).
    """
    return tuple(name for name, flag in zip(names, flags, strict=False) if flag)


def _large_components(combinations: Array) -> NDArray[np.bool_]:
    """Mask of components above a tenth of the largest in some combination, (p + s,).

    Args:
        combinations: Components of the combinations, (k, p + s).
    """
    size = np.abs(combinations)
    # components above a tenth of the largest component
    large = size > 0.1 * size.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(large.any(axis=0))
