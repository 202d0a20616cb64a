"""Scales of joint torques from recordings without and with a payload of known mass.

A drive reports k times its joint's torque. The equations of motion express the torques of all
joints by the same inertial parameters, up to one common scale, which the known mass determines.
Gauss-Newton on the normal equations of both recordings; covariance from the residuals as coloured
noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from testbed.applications.payload.payload import (
    SINGULAR_VALUE_TOLERANCE,
    SPACE_TOLERANCE,
    payload_influence,
)
from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.estimation.noise.fits import weighted_fits
from testbed.core.estimation.noise.lagged_products import (
    MAX_AUTOREGRESSION_ORDER,
    LaggedSums,
)
from testbed.core.estimation.noise.replicas import Replicas
from testbed.core.estimation.noise.whitening import row_indicators
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    NormalEquations,
    inverse_and_solution,
)
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.selection.term_choice import with_chosen_terms
from testbed.core.estimation.settings import DEFAULTS, Settings, values_with_sigmas
from testbed.core.recordings.source import RecordingLike
from testbed.core.robot.tree import Tree

ITERATIONS = 10
"""Number of Gauss-Newton steps, from scales of one."""

MASS_NAME = "payload/mass"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class TorqueScales(Gaussian):
    """Ratios of reported to true torque for each joint, with uncertainty.

    Reported torques are divided by these scales.

    Attributes:
        known: Value and standard deviation of the payload's known parameters, by name.
    """

    known: Mapping[str, tuple[float, float]]


class _LinearRecording(NamedTuple):
    """Normal equations of a recording whose p unknowns are `lead @ v + fixed`.

    The vector v has m elements, the common unknowns of both recordings (`_linear_recording`).

    Attributes:
        passes: Passes over the recording's regressor rows.
        equations: Normal equations of the rows.
        lead: Matrix from the common unknowns v to the recording's unknowns, (p, m).
        fixed: Contribution of the known mass to the recording's unknowns, (p,).
    """

    passes: Passes
    equations: NormalEquations
    lead: Array
    fixed: Array

    def weights(self, x: Array, scales: Array) -> Array:
        """Reciprocal mean square residual of each channel, (n,).

        Args:
            x: Unknowns of the recording, (p,).
            scales: Torque scales, (n,).
        """
        squared_residuals = []
        for j, scale in enumerate(scales):
            normal, right, square = self.equations.of_channel(j)
            squared_residual = float(
                square - 2 * scale * (right @ x) + scale**2 * (x @ normal @ x)
            )
            squared_residuals.append(
                max(squared_residual, 1e-12 * square, SMALLEST_POSITIVE)
            )
        return np.maximum(self.equations.used, 1.0) / squared_residuals


def torque_scales(
    tree: Tree,
    unloaded: RecordingLike,
    loaded: RecordingLike,
    known: Mapping[str, float | Sequence[float]],
    joint: str | None = None,
    *,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    threads: int | None = None,
    progress: Progress = ignore_progress,
) -> TorqueScales:
    """Estimate scales of joint torques from recordings without and with a known payload.

    If joint terms are selected from the data, the recording without payload is used. The standard
    deviation of the mass is included as a common relative error of all scales.

    Args:
        tree: The robot without the payload; its inertias are not used.
        unloaded: Recording without the payload, as for `identify`; with torques.
        loaded: Recording with the payload, along any other motion.
        known: Value, or value and standard deviation, of "payload/mass" [kg].
        joint: Name of the joint that moves the carrying link; default the last.
        gravity: Gravity, (3,) [m/s^2], bedplate frame; default as for `identify`.
        settings: Signal processing, and joint terms, whose coefficients are estimated separately
            for each recording; sensor-error terms (nuisances) and known values are ignored.
        threads: Number of threads; default one per processor.
        progress: Called with the numbers of processed samples and of all samples.

    Raises:
        RecordingError: A recording cannot be used.
        SettingsError: The mass is not given or does not determine the scale, or the settings have
            known zeros.
        UnknownName: A quantity other than the mass is given, or the robot has no such joint.
    """
    known_values = values_with_sigmas(known)
    for name in known_values.keys() - {MASS_NAME}:
        raise UnknownName("known fact", name, (MASS_NAME,))
    mass, mass_sigma = known_values.get(MASS_NAME, (0.0, 0.0))
    if mass <= 0:
        raise SettingsError(
            f"of the payload its mass has to be known, in kg: --known {MASS_NAME}=1.5"
        )
    settings = replace(settings, nuisances=(), known={})
    if settings.zeros:
        raise SettingsError(
            "a payload breaks the symmetry of links: calibrate without known zeros"
        )
    recordings = []
    with one_blas_thread():
        for index, recording in enumerate((unloaded, loaded)):
            problem, _ = with_chosen_terms(
                Problem.from_recording(
                    tree,
                    recording,
                    "torque",
                    settings,
                    gravity=gravity,
                    threads=threads,
                    progress=progress,
                )
            )
            settings = replace(settings, terms=problem.settings.terms)
            recordings.append(
                _linear_recording(problem, joint or tree.names[-1], mass, index)
            )
        values, v = _gauss_newton(recordings)
        covariance = _covariance(recordings, values, v)
    # all other unknowns are proportional to the mass
    covariance += (mass_sigma / mass) ** 2 * np.outer(values, values)
    return TorqueScales(
        names=tree.names,
        units=("",) * tree.n,
        values=values,
        covariance=covariance,
        known=known_values,
    )


def _linear_recording(
    problem: Problem, joint: str, mass: float, number: int
) -> _LinearRecording:
    """Express the normal equations of a recording in the common unknowns v.

    v contains the base parameters, the joint terms of both recordings, and the identifiable
    combinations of the payload's parameters other than its mass.

    Args:
        problem: Identification problem of the recording.
        joint: Name of the joint that moves the carrying link.
        mass: Known mass of the payload [kg].
        number: 0 for the recording without the payload, 1 for the recording with it.

    Raises:
        SettingsError: The effect of the mass on the torques is collinear with the effect of the
            payload's other parameters.
    """
    minimal = problem.minimal
    influence = payload_influence(problem.tree, minimal, joint)
    left_vectors, singular_values, _ = np.linalg.svd(
        influence[:, 1:], full_matrices=False
    )
    payload_axes = left_vectors[
        :, singular_values > SINGULAR_VALUE_TOLERANCE * singular_values[0]
    ]
    fixed = mass * influence[:, 0]
    if np.linalg.norm(
        fixed - payload_axes @ (payload_axes.T @ fixed)
    ) <= SPACE_TOLERANCE * np.linalg.norm(fixed):
        raise SettingsError(
            "the mass of the payload does not change the torques beside its unknown centre: let "
            "joints turn it against gravity"
        )
    passes = problem.passes(3)
    equations = problem.equations(passes)
    is_own_term = np.zeros((2, len(equations.unknowns) - minimal.count))
    is_own_term[number] = 1.0
    term_columns = np.hstack([np.diag(diagonal) for diagonal in is_own_term])
    lead = block_diag(np.eye(minimal.count), term_columns)
    payload_columns = number * np.column_stack([fixed, payload_axes])
    payload_columns = np.pad(payload_columns, ((0, len(term_columns)), (0, 0)))
    return _LinearRecording(
        passes,
        equations,
        np.hstack([lead, payload_columns[:, 1:]]),
        payload_columns[:, 0],
    )


def _gauss_newton(recordings: Sequence[_LinearRecording]) -> tuple[Array, Array]:
    """Torque scales, (n,), and common unknowns v, (m,), by Gauss-Newton iteration.

    The first of `ITERATIONS` steps solves for v alone, with scales of 1.
    """
    n, m = len(recordings[0].equations.channels), recordings[0].lead.shape[1]
    unknowns = np.append(np.ones(n), np.zeros(m))
    for step in range(ITERATIONS):
        free = slice(
            n if step == 0 else 0, None
        )  # the first step solves for v with scales of one
        matrix, vector = _normal_equations(recordings, unknowns[:n], unknowns[n:])
        unknowns[free] += inverse_and_solution(matrix[free, free], vector[free])[1]
    return unknowns[:n], unknowns[n:]


def _normal_equations(
    recordings: Sequence[_LinearRecording], scales: Array, v: Array
) -> tuple[Array, Array]:
    """Normal matrix J' W J, (n + m, n + m), and vector J' W r, (n + m,).

    J is the Jacobian of the linearised problem with respect to the n scales and the m elements of
    v, and r is the residual. W weights each channel by its reciprocal mean square residual.

    Args:
        recordings: The recordings without and with the payload.
        scales: Torque scales, (n,).
        v: Common unknowns, (m,).
    """
    size = len(scales) + len(v)
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    for recording in recordings:
        x = recording.lead @ v + recording.fixed
        for j, (scale, weight) in enumerate(
            zip(scales, recording.weights(x, scales), strict=True)
        ):
            normal, right, _ = recording.equations.of_channel(j)
            rows = np.hstack(
                [np.outer(x, np.eye(len(scales))[j]), scale * recording.lead]
            )
            matrix += weight * rows.T @ normal @ rows
            vector += weight * rows.T @ (right - scale * normal @ x)
    return matrix, vector


def _covariance(
    recordings: Sequence[_LinearRecording], scales: Array, v: Array
) -> Array:
    """Covariance of the torque scales, (n, n), under coloured noise.

    It is that of generalised least squares on the linearised rows of both recordings with
    autoregressive noise. It is enlarged by a factor determined from simulated replicas of the noise
    (parametric bootstrap).

    Args:
        recordings: The recordings without and with the payload.
        scales: Torque scales, (n,).
        v: Common unknowns, (m,).
    """
    sums, n = LaggedSums(MAX_AUTOREGRESSION_ORDER), len(scales)
    for recording in recordings:
        sums.end_sequence()
        for rows in _weighted_jacobian(recording, scales, v):
            sums.add(rows)
    products = sums.lagged_products()
    (fit,) = weighted_fits(products)
    replicas = Replicas(fit.noise)
    for recording in recordings:
        replicas.end_sequence()
        for rows in _weighted_jacobian(recording, scales, v):
            replicas.add(rows[..., :-2], rows[..., -1])
    squares = replicas.normalised_squares(weighted_fits, np.eye(products.unknowns))
    return max(1.0, float(squares.mean())) * fit.covariance[:n, :n]


def _weighted_jacobian(
    recording: _LinearRecording, scales: Array, v: Array
) -> Iterator[Array]:
    """Yield blocks of the Jacobian and residuals, in units of noise.

    Blocks have k rows for each of the C channels, (C, k, n + m + 2). The columns are the n scales,
    the m elements of v, the residual, and an indicator that is 1 for rows in use.

    Args:
        recording: One of the two recordings.
        scales: Torque scales, (n,).
        v: Common unknowns, (m,).
    """
    x, factors = recording.lead @ v + recording.fixed, scales[:, None, None]
    root = np.sqrt(recording.weights(x, scales))[:, None, None]
    for columns, measured in recording.passes.rows(np.eye(len(x))):
        torque = (columns @ x)[..., None]
        by_scale = torque * np.eye(len(scales))[:, None]
        rows = [
            by_scale,
            factors * columns @ recording.lead,
            measured[..., None] - factors * torque,
        ]
        is_counted = row_indicators(columns, measured)[..., None]
        yield np.concatenate([*(root * block for block in rows), is_counted], axis=2)
