"""Information matrix of the base parameters for a motion: criteria, derivatives, prediction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.codec import schema_with_properties
from testbed.core.parameters.minimal_set import selection
from testbed.core.parameters.rules import Signal
from testbed.core.parameters.symbols import parameter_scale
from testbed.motion.fourier import Fourier
from testbed.motion.samples import MIN_RELATIVE_SCALE, KernelForces, SampledRows

Criterion: TypeAlias = Callable[[Array], tuple[float, Array]]
"""Function that maps a covariance C, (N, N), to a value and its derivative with respect to C,
(N, N)."""

CriterionName = Literal["a", "d", "e"]


NORM_ORDER = 8
"""Order of the norm that approximates the largest eigenvalue smoothly."""


def a_optimal(covariance: Array) -> tuple[float, Array]:
    """A-optimality: log of the mean variance, and derivative with respect to the covariance."""
    count, trace = len(covariance), float(np.trace(covariance))
    return float(np.log(trace / count)), np.eye(count) / trace


def d_optimal(covariance: Array) -> tuple[float, Array]:
    """D-optimality: mean log eigenvalue of the covariance, and derivative."""
    count = len(covariance)
    log_determinant = float(np.linalg.slogdet(covariance)[1])
    return log_determinant / count, np.linalg.inv(covariance) / count


def e_optimal(covariance: Array) -> tuple[float, Array]:
    """E-optimality: log of the largest eigenvalue, smoothed, and derivative.

    The largest eigenvalue is approximated by the power mean of order NORM_ORDER of all eigenvalues.
    The derivative is taken with respect to the covariance.
    """
    values, axes = eigh(covariance)
    share = np.maximum(values, 0.0) / values[-1]
    total = float(np.sum(share**NORM_ORDER))
    value = float(np.log(values[-1]) + np.log(total / len(values)) / NORM_ORDER)
    return value, (axes * (share ** (NORM_ORDER - 1) / (total * values[-1]))) @ axes.T


CRITERIA: dict[CriterionName, Criterion] = {
    "a": a_optimal,
    "d": d_optimal,
    "e": e_optimal,
}
"""Optimality criteria, keyed by name."""


Instrument = Literal["plate", "joints", "both"]
"""Instrument whose regressor rows are used: bedplate (wrench), joints (torques), or both."""


SIGN_SMOOTHING_SPEED = 0.05
"""Speed scale of tanh(qd / scale) in place of sign(qd) in dry friction [rad/s or m/s]."""


@dataclass(frozen=True, eq=False)
class RegressorRows:
    """Regressor rows of one signal for the unknowns of the design.

    The U unknowns are the N base parameters, relative to their scales. With joint torques, n dry
    and n viscous friction coefficients are added.

    Attributes:
        model: Signal of the rows.
        slots: Range of the slots of each channel (regressor entries of `SampledRows`).
        lead: Matrix of each channel that maps its s slots to the U columns of the unknowns, (s, U).
        weights: Inverse noise variance of each channel, (channels,).
        friction: Index of the first dry friction coefficient among the unknowns; the viscous
            coefficients follow. None for the plate, which does not measure friction.
    """

    model: Signal
    slots: tuple[slice, ...]
    lead: tuple[Array, ...]
    weights: Array
    friction: int | None

    def rows(self, samples: KernelForces) -> list[Array]:
        """Regressor rows of each channel for all unknowns at G instants, (G, U) each."""
        slots, speeds = samples.slots[self.model][:, 0], samples.motion.qd
        rows = [
            slots[channel_slots].T @ lead
            for channel_slots, lead in zip(self.slots, self.lead, strict=True)
        ]
        if self.friction is not None:
            n = len(rows)
            for joint, phi in enumerate(rows):
                qd, column = speeds[:, joint], self.friction + joint
                phi[:, column], phi[:, column + n] = (
                    np.tanh(qd / SIGN_SMOOTHING_SPEED),
                    qd,
                )
        return rows


@dataclass(frozen=True, eq=False)
class DesignObjective:
    """Objective of a design: parameters to identify, rows, prior and criterion.

    Unknowns are those of `RegressorRows`.

    Attributes:
        names: Names of the base parameters, which are the first unknowns; friction coefficients are
            nuisance parameters.
        scale: Scale of each parameter for relative errors, (N,).
        parts: Rows of each used signal.
        prior: Prior information on all unknowns, (U, U), on the scale of one measurement per
            instant.
        criterion: Name of the optimality criterion.
    """

    names: tuple[str, ...]
    scale: Array
    parts: tuple[RegressorRows, ...]
    prior: Array
    criterion: CriterionName = "a"

    def matrix(
        self,
        samples: KernelForces,
        counted: NDArray[np.bool_] | None = None,
        harmonics: int | None = None,
    ) -> Array:
        """Information matrix of one measurement per instant without the prior, (U, U).

        Args:
            samples: Samples of the motion; samples of one period if `harmonics` is given.
            counted: True where the torque row of a joint is used, (G, n); default all rows.
            harmonics: Number of harmonics to which the plate's rows are low-pass filtered; default
                no filter.
        """
        total = np.zeros_like(self.prior)
        for part in self.parts:
            for channel, phi in enumerate(part.rows(samples)):
                if part.friction is not None and counted is not None:
                    phi = counted[:, [channel]] * phi
                elif part.friction is None and harmonics is not None:
                    spectrum = np.fft.rfft(phi, axis=0)
                    spectrum[harmonics + 1 :] = 0
                    phi = np.fft.irfft(spectrum, len(phi), axis=0)
                total += part.weights[channel] * (phi.T @ phi)
        return total

    def value(self, samples: KernelForces) -> float:
        """Value of the criterion; infinite if an unknown is not identifiable."""
        covariance = self.covariance(self.matrix(samples) + self.prior)
        return np.inf if covariance is None else CRITERIA[self.criterion](covariance)[0]

    def slopes(self, samples: KernelForces) -> Array:
        """Derivatives of the criterion with respect to q, qd, qdd at every instant, (3 n, G).

        All unknowns must be identifiable, and `samples` must have a stencil.
        """
        covariance = _scaled_inverse(self.matrix(samples) + self.prior)
        assert covariance is not None
        assert samples.stencil is not None
        count = len(self.scale)
        by_covariance = CRITERIA[self.criterion](covariance[:count, :count])[1]
        by_information = (
            covariance[:, :count] @ by_covariance @ covariance[:count]
        )  # times -1
        n = samples.motion.q.shape[1]
        total = np.zeros((3 * n, samples.motion.samples))
        for part in self.parts:
            slots = samples.slots[part.model]
            slot_slopes = np.zeros(slots.shape[::2])
            for c, phi in enumerate(part.rows(samples)):
                row_slopes = -2 * part.weights[c] * (by_information @ phi.T)  # (U, G)
                slot_slopes[part.slots[c]] += part.lead[c] @ row_slopes
                if part.friction is not None:
                    dry_slopes, viscous_slopes = (
                        row_slopes[part.friction + c],
                        row_slopes[part.friction + n + c],
                    )
                    sign = np.tanh(samples.motion.qd[:, c] / SIGN_SMOOTHING_SPEED)
                    total[n + c] += dry_slopes * (1 - sign**2) / SIGN_SMOOTHING_SPEED
                    total[n + c] += viscous_slopes
            total += samples.stencil.weights @ np.einsum(
                "sg,seg->eg", slot_slopes, slots
            )
        return total

    def covariance(self, information: Array) -> Array | None:
        """Covariance of the relative errors of the base parameters, (N, N).

        The covariance is marginal, as friction coefficients are also estimated. The result is None
        if an unknown is not identifiable.

        Args:
            information: Information matrix of all unknowns, (U, U).
        """
        inverse = _scaled_inverse(information)
        count = len(self.scale)
        return None if inverse is None else inverse[:count, :count]


def information_of(
    rows: Mapping[Signal, SampledRows],
    instrument: Instrument,
    plate_noise: Array,
    torque_noise: Array,
    criterion: CriterionName = "a",
    prior: Array | None = None,
) -> DesignObjective:
    """Build the design objective from sampled rows, noise and prior.

    Args:
        rows: Sampled rows of the signals in `signals_of_instrument(instrument)`.
        instrument: Instrument whose rows are used.
        plate_noise: Standard deviation of the plate's channels, (6,) [N, N m].
        torque_noise: Standard deviation of the joint torques, (n,) [N m or N].
        criterion: Name of the optimality criterion.
        prior: Prior covariance of the absolute base parameters, (N, N); None for no prior.
    """
    main_rows = rows["torque" if instrument == "joints" else "wrench"]
    scale = parameter_scale(
        main_rows.delta, main_rows.minimal.units, MIN_RELATIVE_SCALE
    )
    count = len(scale)
    unknowns = count if instrument == "plate" else count + 2 * len(torque_noise)
    parts = []
    for model in signals_of_instrument(instrument):
        sampled, is_torque = rows[model], model == "torque"
        selection_matrix = np.zeros((sampled.minimal.count, unknowns))
        selection_matrix[:, :count] = scale * (
            np.eye(count)
            if sampled is main_rows
            else selection(sampled.minimal, main_rows.minimal)
        )
        slots, bases = zip(*sampled.channels(), strict=True)
        leads = tuple(basis @ selection_matrix for basis in bases)
        weights = (torque_noise if is_torque else plate_noise) ** -2.0
        parts.append(
            RegressorRows(model, slots, leads, weights, count if is_torque else None)
        )
    prior_information = np.zeros((unknowns, unknowns))
    if prior is not None:
        prior_information[:count, :count] = np.linalg.inv(prior) * np.outer(
            scale, scale
        )
    return DesignObjective(
        main_rows.minimal.names, scale, tuple(parts), prior_information, criterion
    )


def signals_of_instrument(instrument: Instrument) -> tuple[Signal, ...]:
    """Signals of an instrument: "wrench" of the plate, "torque" of joints, or both."""
    if instrument == "both":
        return "wrench", "torque"
    return ("wrench" if instrument == "plate" else "torque",)


def _scaled_inverse(matrix: Array) -> Array | None:
    """Inverse of a matrix after scaling to unit diagonal; None unless positive definite."""
    scale = np.sqrt(np.diag(matrix))
    if not (np.isfinite(matrix).all() and (scale > 0).all()):
        return None
    try:
        inverse_root = np.linalg.inv(
            np.linalg.cholesky(matrix / np.outer(scale, scale))
        )
    except np.linalg.LinAlgError:
        return None
    return np.asarray(inverse_root.T @ inverse_root / np.outer(scale, scale))


SAMPLES_PER_HARMONIC = 24
"""Samples of a period per harmonic; rows contain harmonics of up to four times the order of the
motion's harmonics."""


@dataclass(frozen=True, eq=False)
class SignalProcessing:
    """Parameters of the estimator's signal processing for a recording.

    Attributes:
        rate: Sampling rate [Hz].
        duration: Duration of the recording after filtering [s].
        band: Cut-off frequency of the rows [Hz]; infinite for no low-pass filter.
        min_speed: Joint speed at or below which rows of a joint are not used [rad/s or m/s].
        guard_time: Time before and after samples at or below `min_speed` in which rows are not used
            [s].
    """

    rate: float
    duration: float
    band: float
    min_speed: float
    guard_time: float

    @property
    def samples(self) -> float:
        """Number of samples after filtering."""
        return self.rate * self.duration


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted precision of the base parameters for a motion.

    Attributes:
        names: Names of the base parameters.
        sigma: Standard deviation of each parameter, (N,) [kg, kg m, kg m^2].
        relative: Ratios of the standard deviations to the values, (N,); small values are raised to
            MIN_RELATIVE_SCALE times the largest value of the same unit. Infinite if not
            identifiable.
        condition: Condition number of the weighted regressor for relative parameters.
    """

    names: tuple[str, ...]
    sigma: Array
    relative: Array
    condition: float

    __get_pydantic_core_schema__ = schema_with_properties("rms")

    @property
    def rms(self) -> float:
        """Rms of the relative standard deviations."""
        return float(np.sqrt(np.mean(self.relative**2)))


def predict(
    information: DesignObjective,
    rows: Mapping[Signal, SampledRows],
    motion: Fourier,
    pipeline: SignalProcessing,
) -> Prediction:
    """Predict standard deviations of the base parameters under white noise.

    All standard deviations are infinite if an unknown is not identifiable.

    Args:
        information: Design objective; its prior information is divided by the number of samples.
        rows: Sampled rows of the used signals.
        motion: Periodic motion, repeated over the recording.
        pipeline: Signal processing of the estimator.
    """
    count = max(SAMPLES_PER_HARMONIC * motion.harmonics, 200)
    samples = KernelForces(motion.at(motion.instants(count)), rows, None)
    counted = is_counted(motion, count, pipeline)
    harmonics = (
        int(pipeline.band * motion.period) if np.isfinite(pipeline.band) else count
    )
    matrix = information.matrix(samples, counted=counted, harmonics=harmonics)
    matrix = (matrix / count + information.prior) * pipeline.samples
    covariance = information.covariance(matrix)
    if covariance is None:
        relative, condition = np.full(len(information.scale), np.inf), np.inf
    else:
        relative = np.sqrt(np.diag(covariance))
        condition = float(np.sqrt(np.linalg.cond(covariance)))
    return Prediction(
        information.names, relative * information.scale, relative, condition
    )


def is_counted(
    motion: Fourier, count: int, pipeline: SignalProcessing
) -> NDArray[np.bool_]:
    """True where rows of a joint are used, at the samples of a period, (count, n).

    A row is used if the joint is faster than `min_speed` from `guard_time` before the sample to
    `guard_time` after the sample.

    Args:
        motion: Periodic motion.
        count: Number of samples of a period.
        pipeline: Signal processing of the estimator.
    """
    is_fast = np.abs(motion.derivative(motion.instants(count), 1)) > pipeline.min_speed
    width = 2 * round(pipeline.guard_time * count / motion.period) + 1
    return np.asarray(minimum_filter1d(is_fast, width, axis=0, mode="wrap"))
