"""Regression of a joint's reported torque on its predicted torque and its joint terms."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.noise.fits import NoiseFit, weighted_fits
from testbed.core.estimation.noise.lagged_products import (
    MAX_AUTOREGRESSION_ORDER,
    LaggedProducts,
    LaggedSums,
)
from testbed.core.estimation.noise.replicas import REPLICA_COUNT, REPLICA_SEED, Replicas
from testbed.core.estimation.noise.whitening import row_indicators
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    NormalEquations,
    scaled_inverse,
    solve_scaled,
)
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.settings import Settings
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import minimal_set, selection
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree

MIN_RELIABILITY = 0.5
"""Smallest reliability of an identifiable constant; below it most of its column may be error."""

MIN_REPLICA_COEFFICIENTS = 400
"""Smallest number of replicated coefficients per joint, for standard deviations within 4 %."""


class JointAttenuation(NamedTuple):
    """Correction for the attenuation that errors of the predicted torque cause.

    Attributes:
        slope: Derivative of the corrected values with respect to the uncorrected values, (1 + q, 1
            + q): torque constant first, then q terms.
        covariance: Covariance of the corrected values, without the first-order effect of the
            bodies' errors, (1 + q, 1 + q).
        reliability: Ratio of attenuated to true torque constant.
    """

    slope: Array
    covariance: Array
    reliability: float


def correct_attenuation(
    fit: NoiseFit, square: Array, spread: Array
) -> JointAttenuation:
    """Correct a regression for attenuation by errors in the predicted torque ([Ful87] section 1.2).

    Errors in a regressor increase its sum of squares and reduce its coefficient in proportion. The
    covariance includes the uncertainty of that increase.

    Args:
        fit: Fit to the regressor columns with errors.
        square: Normal matrix of these columns, (1 + q, 1 + q).
        spread: Product of the normal matrix and the covariance of the plate's parameters; its trace
            is the expected increase of the first column's sum of squares.
    """
    count = len(fit.values)
    # part of the sum of squares that is independent of the terms
    independent_square = 1.0 / max(
        float(scaled_inverse(square)[0, 0]), SMALLEST_POSITIVE
    )
    reliability = 1.0 - float(np.trace(spread)) / independent_square
    correction = max(reliability, MIN_RELIABILITY)
    direction = fit.covariance[:, 0] / max(
        float(fit.covariance[0, 0]), SMALLEST_POSITIVE
    )
    slope = np.eye(count) + np.outer(direction, np.eye(count)[0]) * (1 / correction - 1)
    constant = abs(float(slope[0] @ fit.values))
    constant_sigma = max(1.0, constant)
    if reliability > MIN_RELIABILITY:
        constant_sigma = (
            constant
            * np.sqrt(max(2 * np.trace(spread @ spread), 0.0))
            / independent_square
            / correction
        )
    covariance = slope @ fit.covariance @ slope.T + constant_sigma**2 * np.outer(
        direction, direction
    )
    return JointAttenuation(slope, covariance, reliability)


ROUNDING_SHARE = 1e-20
"""Squared residual of exact data over the squared torque, by rounding."""


@dataclass(frozen=True, eq=False)
class JointRegression:
    """Regression of one joint's reported torque on its predicted torque and joint terms.

    Attributes:
        joint: Joint index.
        terms: Matrix from the q coefficients to the coefficients of the t requested terms, (t, q).
        values: Torque constant (ratio of reported to true torque), then the q coefficients in terms
            of reported torque, (1 + q,).
        covariance: Covariance of the values, including errors of the bodies, (1 + q, 1 + q).
        residual: Rms residual in reported torque [N m or N].
        noise: Standard deviation of independent rows that would give the same covariance [N m or
            N].
        rows: Number of rows used in the fit.
        reliability: Ratio of attenuated to true torque constant; the attenuation, due to errors of
            the predicted torque, has been corrected, down to `MIN_RELIABILITY`.
    """

    joint: int
    terms: Array
    values: Array
    covariance: Array
    residual: float
    noise: float
    rows: int
    reliability: float = 1.0

    @property
    def true_coefficients(self) -> tuple[Array, Array]:
        """Coefficients in terms of true torque, (q,), and their covariance, (q, q)."""
        constant, terms = float(self.values[0]), self.values[1:] / self.values[0]
        jacobian = np.column_stack([-terms / constant, np.eye(len(terms)) / constant])
        return terms, jacobian @ self.covariance @ jacobian.T


@dataclass(frozen=True, eq=False)
class TorqueRegressionData:
    """Regression data of a recording's joint torques, with torques predicted from the plate.

    The joint torques have p unknowns, the plate N_r base parameters. Of the t requested joint
    terms, those that depend on other unknowns are regrouped into these.

    Attributes:
        drives: Unknowns of the joint torques.
        passes: Passes over the regressor rows.
        equations: Normal equations of all rows.
        plate_to_unknowns: Matrix from the plate's base parameters to the unknowns, (p, N_r).
        joints: Indices of the joints whose torque follows from the wrench: all joints, or those
            beyond a force sensor.
        combined: Matrix from regression coefficients (predicted torque, then requested terms) to
            unknowns, (p, 1 + t).
    """

    drives: DriveSet
    passes: Passes
    equations: NormalEquations
    plate_to_unknowns: Array
    joints: tuple[int, ...]
    combined: Array

    def columns(self, terms: Array) -> Array:
        """Matrix from the 1 + q coefficients of a regression to the unknowns, (p, 1 + q).

        Args:
            terms: Matrix from the q coefficients to the coefficients of the t requested terms, (t,
                q).
        """
        return np.asarray(self.combined @ block_diag(1.0, terms))

    def products(self, joint: int, terms: Array) -> Array:
        """Normal matrix of a joint's regression in 1 + q coefficients, (1 + q, 1 + q).

        Args:
            joint: Joint index.
            terms: Matrix from the q coefficients to the coefficients of the t requested terms, (t,
                q).
        """
        normal, _, _ = self.equations.of_channel(joint)
        columns = self.columns(terms)
        return columns.T @ normal @ columns

    def terms(self, joint: int, laws: Iterable[JointLaw] | None = None) -> Array:
        """Matrix that selects the q terms of a joint from the t requested terms, (t, q).

        Args:
            joint: Joint index.
            laws: Laws in the order of the columns; default all laws of the joint.
        """
        indices = {
            term.law: k
            for k, term in enumerate(self.drives.asked)
            if term.joint == joint
        }
        selected = indices.values() if laws is None else [indices[law] for law in laws]
        return np.eye(len(self.drives.asked))[:, list(selected)]


def torque_regression_data(
    problem: Problem, bodies: Estimate, laws: Sequence[str | JointLaw] | None = None
) -> TorqueRegressionData:
    """Collect regression data of joint torques, with torques predicted from the plate.

    Args:
        problem: Identification problem for the joint torques.
        bodies: Estimate from the plate's wrench, of this recording or another.
        laws: Laws of the joint terms; default the laws of the settings.

    Raises:
        SettingsError: The estimate is not from a plate or force sensor, or has other parameters.
    """
    if problem.tree.shafts:
        raise SettingsError(
            "joints are held against the plate one by one, and robot.coupling joins some: "
            'leave identification.drives "off"'
        )
    terms = problem.settings.words if laws is None else laws
    problem = problem.with_settings(terms=terms)
    drives = problem.drives
    assert drives is not None, "terms are those of joint torques"
    prediction_matrix = _prediction_matrix(
        problem.tree, bodies, drives, problem.settings
    )
    passes = problem.passes(
        3, load=(prediction_matrix @ bodies.values)[: problem.minimal.count]
    )
    with one_blas_thread():
        equations = problem.equations(passes)
    combined = np.column_stack([prediction_matrix @ bodies.values, drives.columns])
    joints = tuple(
        problem.tree.index(name) for name in bodies.joints[bodies.minimal.lead :]
    )
    if not joints:
        raise SettingsError(
            "no joint lies beyond the force sensor: its wrench is independent of all drives"
        )
    return TorqueRegressionData(
        drives, passes, equations, prediction_matrix, joints, combined
    )


MAX_ZERO_TORQUE = 1e-12
"""Largest rms of a torque that counts as zero [N m or N]."""


def fit_joint_regressions(
    torques: TorqueRegressionData,
    bodies: Estimate,
    term_matrices: Mapping[int, Array] | None = None,
) -> tuple[JointRegression, ...]:
    """Fit the regression of each joint's torque, assuming coloured noise.

    Args:
        torques: Regression data of the joint torques.
        bodies: Estimate from the plate's wrench.
        term_matrices: Matrix from the q coefficients to those of the t requested terms, (t, q),
            keyed by joint index; default all terms of each joint.

    Raises:
        RecordingError: The rows of a joint do not determine its coefficients.
    """
    if term_matrices is None:
        term_matrices = {joint: torques.terms(joint) for joint in torques.joints}
    for joint, terms in term_matrices.items():
        _check_rows(torques, joint, terms)
    with one_blas_thread():
        fits = _fits(
            torques,
            {joint: block_diag(1.0, terms) for joint, terms in term_matrices.items()},
        )
    return tuple(
        _corrected_regression(torques, bodies, joint, term_matrices[joint], *fit)
        for joint, fit in fits.items()
    )


def _check_rows(torques: TorqueRegressionData, joint: int, terms: Array) -> None:
    """Raise RecordingError if a joint's rows do not determine its coefficients."""
    equations = torques.equations
    name, count = equations.channels[joint], equations.used[joint]
    if not equations.squares[joint] > MAX_ZERO_TORQUE**2 * count:
        raise RecordingError(
            f"the torque of joint '{name}' is zero throughout, and shows nothing of its drive: "
            "record it, or hold the joint (--lock)"
        )
    products = torques.products(joint, terms)
    scale = np.sqrt(np.diagonal(products))
    eigenvalues = (
        np.linalg.eigvalsh(products / np.outer(scale, scale))
        if scale.all()
        else np.zeros(1)
    )
    if eigenvalues[0] <= len(scale) * np.finfo(float).eps * eigenvalues[-1]:
        raise RecordingError(
            f"{int(count)} rows of joint '{name}' do not identify its torque constant beside "
            f"{terms.shape[1]} coefficients of friction and rotor: record longer, or a richer "
            "motion of it"
        )


def _corrected_regression(
    torques: TorqueRegressionData,
    bodies: Estimate,
    joint: int,
    terms: Array,
    fit: NoiseFit,
    squares: float,
) -> JointRegression:
    """Regression of a joint, corrected for errors of the plate's estimate.

    Args:
        torques: Regression data of the joint torques.
        bodies: Estimate from the plate's wrench.
        joint: Joint index.
        terms: Matrix from the q coefficients to the coefficients of the t requested terms, (t, q).
        fit: Uncorrected fit.
        squares: Sum of squared residuals.
    """
    normal, _, _ = torques.equations.of_channel(joint)
    products, rows = torques.products(joint, terms), int(torques.equations.used[joint])
    error_products = (
        torques.plate_to_unknowns.T
        @ normal
        @ torques.plate_to_unknowns
        @ bodies.covariance
    )
    correction = correct_attenuation(fit, products, error_products)
    values = correction.slope @ fit.values
    cross_products = torques.columns(terms).T @ normal @ torques.plate_to_unknowns
    sensitivity = -values[0] * correction.slope @ solve_scaled(products, cross_products)
    residual = float(np.sqrt(squares / max(rows, 1)))
    white_variances = np.diagonal(scaled_inverse(products))
    noise = float(np.sqrt(np.mean(np.diagonal(fit.covariance) / white_variances)))
    return JointRegression(
        joint=joint,
        terms=terms,
        values=values,
        covariance=correction.covariance
        + sensitivity @ bodies.covariance @ sensitivity.T,
        residual=residual,
        noise=max(noise, residual),
        rows=rows,
        reliability=correction.reliability,
    )


def _prediction_matrix(
    tree: Tree, bodies: Estimate, drives: DriveSet, settings: Settings
) -> Array:
    """Matrix from N_r plate parameters to p joint-torque unknowns, (p, N_r).

    Rows of joint terms are zero. A SettingsError is raised if the estimate has other parameters.
    """
    if bodies.minimal.of_sensor:
        if not {*bodies.joints} <= {*tree.names} or bodies.minimal.subtracted_sensors:
            raise SettingsError(
                "drives are held against the wrench of all that a force sensor carries, of the "
                "same robot"
            )
        # of the bodies beyond the sensor
        theta = np.zeros((tree.n, 10, bodies.minimal.count))
        theta[[tree.index(name) for name in bodies.joints]] = (
            bodies.minimal.lift.reshape(-1, 10, bodies.minimal.count)
        )
        matrix = np.zeros((drives.count, bodies.minimal.count))
        matrix[: drives.minimal.count] = drives.minimal.matrix @ theta.reshape(
            10 * tree.n, -1
        )
        return matrix
    wrench_set = minimal_set(tree, "wrench", zeros=settings.zeros)
    if bodies.method != "wrench" or bodies.names != wrench_set.names:
        raise SettingsError(
            "drives are held against the plate's estimate, of the same robot, gravity and zeros"
        )
    matrix = np.zeros((drives.count, wrench_set.count))
    matrix[: drives.minimal.count] = selection(drives.minimal, wrench_set)
    return matrix


def _fits(
    torques: TorqueRegressionData, column_matrices: Mapping[int, Array]
) -> dict[int, tuple[NoiseFit, float]]:
    """Fit of each joint's regression with sum of squared residuals, keyed by joint index.

    The covariance is scaled by replicas of the coloured noise (parametric bootstrap).

    Args:
        torques: Regression data of the joint torques.
        column_matrices: Matrix from regression coefficients to `torques.combined`, keyed by joint
            index.
    """
    sums = {joint: LaggedSums(MAX_AUTOREGRESSION_ORDER) for joint in column_matrices}
    for joint, block in _row_blocks(torques, column_matrices):
        sums[joint].add(block)
    initial_fits = {
        joint: _scaled_fit(replica.lagged_products()) for joint, replica in sums.items()
    }
    replicas = {
        joint: [
            Replicas(fit.noise, REPLICA_SEED + k)
            for k in range(
                math.ceil(MIN_REPLICA_COEFFICIENTS / REPLICA_COUNT / len(fit.values))
            )
        ]
        for joint, (fit, _, _) in initial_fits.items()
    }
    for joint, block in _row_blocks(torques, column_matrices):
        for replica in replicas[joint]:
            replica.add(block[..., :-2] / initial_fits[joint][2], block[..., -1])
    fits = {}
    for joint, (fit, products, scale) in initial_fits.items():
        identity = np.eye(len(fit.values))
        factor = float(
            np.mean(
                [
                    replica.normalised_squares(weighted_fits, identity)
                    for replica in replicas[joint]
                ]
            )
        )
        squares = _squared_residual(products.products[0, 0], fit.values) * scale**2
        fits[joint] = (
            replace(fit, covariance=max(1.0, factor) * fit.covariance),
            squares,
        )
    return fits


def _row_blocks(
    torques: TorqueRegressionData, column_matrices: Mapping[int, Array]
) -> Iterator[tuple[int, Array]]:
    """Yield joint index and k rows: columns, torque, indicator of rows in use, (1, k, ...).

    Args:
        torques: Regression data of the joint torques.
        column_matrices: Matrix from regression coefficients to `torques.combined`, keyed by joint
            index.
    """
    for columns, measured in torques.passes.rows(torques.combined):
        is_counted = row_indicators(columns, measured)
        for joint, matrix in column_matrices.items():
            torque_and_indicator = np.stack(
                [measured[joint], is_counted[joint]], axis=1
            )
            blocks = [columns[joint] @ matrix, torque_and_indicator]
            yield joint, np.concatenate(blocks, axis=1)[None]


def _scaled_fit(products: LaggedProducts) -> tuple[NoiseFit, LaggedProducts, float]:
    """Fit under coloured noise, with products of rows scaled by the rms residual.

    The rms residual of ordinary least squares is returned, too.

    Args:
        products: Products of columns, torque and indicator of the unscaled rows.
    """
    squares = products.products[0, 0]
    columns = len(squares) - 2
    values = solve_scaled(squares[:columns, :columns], squares[:columns, columns])
    count, squared_torque = (
        max(float(squares[columns + 1, columns + 1]), 1.0),
        float(squares[columns, columns]),
    )
    scale = float(
        np.sqrt(
            max(
                _squared_residual(squares, values),
                ROUNDING_SHARE * squared_torque,
                SMALLEST_POSITIVE,
            )
            / count
        )
    )
    scaled = products.combine_columns(np.diag([*np.full(columns + 1, 1 / scale), 1.0]))
    return weighted_fits(scaled)[0], scaled, scale


def _squared_residual(products: Array, values: Array) -> float:
    """Sum of squared residuals, computed from products of columns and measurement.

    Negative values due to rounding become 0.

    Args:
        products: Products of columns and measurement, (q, q) at least.
        values: Coefficients of the columns.
    """
    count, combination = len(values), np.append(-values, 1.0)
    squared_residual = np.einsum(
        "ij,i,j->", products[: count + 1, : count + 1], combination, combination
    )
    return max(float(squared_residual), 0.0)  # negative by rounding
