"""Time-varying sensor errors as causes of a force plate's residuals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, cause_phrase, make_diagnostic
from testbed.core.base.errors import shortened_list
from testbed.core.recordings.columns import WRENCH_COMPONENTS
from testbed.importing.check.explanation import Explanation
from testbed.importing.check.plate import (
    CROSSTALK_SHARE,
    LOG_RESIDUAL_WEIGHT,
    RESIDUAL_SHARE_FLOOR,
)
from testbed.importing.import_report import mapping_advice
from testbed.sensors.catalogue import candidate_errors
from testbed.sensors.errors.plate_delay import PlateDelay
from testbed.sensors.errors.plate_gain import PlateGain
from testbed.sensors.errors.plate_matrix import PlateMatrix
from testbed.sensors.systematic_error import (
    ClockError,
    Coefficient,
    PlateError,
    SystematicError,
)

MIN_GAIN = 6.0
"""Log-likelihood ratio from which a sensor error is reported [nats]."""

Z_THRESHOLD = 5.0
"""Normalised value from which a coefficient is reported."""


MAX_ITERATIONS = 2
"""Number of regressions per error, each with columns from the last explained wrench."""

GAIN_SIGMA = 0.3
"""Standard deviation of the channels' gains, estimated jointly: an error that grows from time 0 has
a mean."""


@dataclass(frozen=True, eq=False)
class SensorErrorFit:
    """Coefficients of one sensor error, estimated together with the robot's parameters.

    Attributes:
        error: Type of the sensor error.
        coefficients: Significant coefficients (beyond 5 standard deviations) and their values.
        unexplained: Unexplained share of each channel's variance with the error, (6,).
        gain: Log-likelihood ratio [nats].
    """

    error: type[SystematicError]
    coefficients: tuple[tuple[Coefficient, float], ...]
    unexplained: Array
    gain: float

    def explains_plate(self, best: Explanation) -> bool:
        """Test whether, with the error, the residuals of the plate are within its noise.

        They are if the unexplained share of each channel is below 0.3 % plus 3 times the noise
        share.

        Args:
            best: Explanation of the recording without the error.
        """
        return bool((self.unexplained < CROSSTALK_SHARE + 3 * best.plate.noise).all())


def likeliest_sensor_error(best: Explanation) -> SensorErrorFit | None:
    """Sensor error that best explains a plate's residuals; None if no error is likely.

    An error is likely if its gain exceeds `MIN_GAIN` and it has a significant coefficient. Errors
    that are constant in time are not tested: hypotheses on the plate cover them, or they are
    crosstalk.

    Args:
        best: Best explanation of the recording, which has a wrench.
    """
    fits = sorted(_sensor_error_fits(best), key=lambda each: -each.gain)
    return (
        fits[0] if fits and fits[0].gain > MIN_GAIN and fits[0].coefficients else None
    )


def sensor_error_diagnostic(fit: SensorErrorFit, best: Explanation) -> Diagnostic:
    """Diagnostic of a sensor error, with the corrected lines of the mapping.

    Args:
        fit: Fit of the sensor error.
        best: Explanation of the recording without the error.
    """
    shares, remaining = best.plate.unexplained, fit.unexplained
    channel = int(
        np.argmax(
            np.log((shares + RESIDUAL_SHARE_FLOOR) / (remaining + RESIDUAL_SHARE_FLOOR))
        )
    )
    lines = [
        ("errors", f'"{c.name}"', float(f"{value:.4g}"))
        for c, value in fit.coefficients
    ]
    sizes = [f"{c.name} {value:.3g} {c.unit}".rstrip() for c, value in fit.coefficients]
    return make_diagnostic(
        "plate.sensor-error",
        "the plate",
        shares[channel],
        channel=WRENCH_COMPONENTS[channel],
        causes=[fit.error.term],
        cause=cause_phrase(fit.error.term),
        size=shortened_list(sizes),
        before=f"{100 * shares[channel]:.2g} %",
        after=f"{100 * remaining[channel]:.2g} %",
        lines=mapping_advice(lines),
    )


def _sensor_error_fits(best: Explanation) -> Iterator[SensorErrorFit]:
    """Yield the fits of all time-varying sensor errors, one error at a time.

    Constant gains of the channels are fitted as well; `gain` is relative to the fit of these gains
    alone.
    """
    wrench = best.fit.plate.wrench(best.plate)
    # columns are computed from the explained wrench, not the measured one: noise on both sides
    # would bias coefficients towards zero; with gains, which the error multiplies
    initially_explained = wrench - _regression(best, np.zeros((len(wrench), 6, 0)))[3]
    before, *_ = _regression(best, _gain_columns(initially_explained))
    for error in filter(_is_time_varying, candidate_errors()):
        explained = initially_explained
        for _ in range(MAX_ITERATIONS):
            columns = _error_columns(error, best, explained)
            all_columns = np.concatenate([columns, _gain_columns(explained)], axis=2)
            after, values, sigma, residual = _regression(best, all_columns)
            explained = wrench - residual - columns @ values[:-6]
        gain = LOG_RESIDUAL_WEIGHT * float(
            np.log(
                (before + RESIDUAL_SHARE_FLOOR) / (after + RESIDUAL_SHARE_FLOOR)
            ).sum()
        )
        coefficients = error.coefficients(best.fit.prior.tree)
        pairs = zip(coefficients, values.tolist(), Z_THRESHOLD * sigma, strict=False)
        significant = [
            (each, value) for each, value, threshold in pairs if abs(value) > threshold
        ]
        yield SensorErrorFit(error, tuple(significant), after, gain)


def _gain_columns(wrench: Array) -> Array:
    """Regressor columns of the channels' gains, (T, 6, 6), for the explained wrench, (T, 6)."""
    return GAIN_SIGMA * PlateGain.derivative(wrench, np.zeros(len(wrench)), np.zeros(6))


def _regression(best: Explanation, columns: Array) -> tuple[Array, Array, Array, Array]:
    """Regression of the wrench on robot parameters and additional columns.

    Args:
        best: Explanation of the recording.
        columns: Additional columns, (T, 6, k), at T instants.

    Returns:
        Unexplained shares of the channels, (6,), values and standard deviations of the columns'
        coefficients, (k,), and residual, (T, 6).
    """
    evidence, plate = best.fit.plate, best.plate
    variance = np.maximum(evidence.wrench(plate).var(axis=0), 1e-12)
    for _ in range(2):  # sigmas are of the residual with the columns
        residual, values, sigma = evidence.residual(plate, columns)
        plate = replace(plate, unexplained=residual.var(axis=0) / variance)
    return plate.unexplained, values, sigma, residual


def _is_time_varying(error: type[SystematicError]) -> bool:
    """Test whether an error of a force plate varies with time."""
    if issubclass(error, ClockError):
        return error is not PlateDelay
    return issubclass(error, PlateError) and error.term not in PlateMatrix.contains


def _error_columns(
    error: type[SystematicError], best: Explanation, wrench: Array
) -> Array:
    """Derivatives of a wrench, (T, 6), with respect to a sensor error's coefficients, (T, 6, k).

    Time is measured from the middle of the recording.
    """
    time = best.fit.instants.motion.t
    time = time - time.mean()
    if issubclass(error, ClockError):
        rate = best.fit.instants.wrench_rate @ best.plate.map.T
        lateness = np.broadcast_to(error.delay_derivative(time), len(time))
        return np.asarray(-(rate * lateness[:, None])[..., None])
    return error.derivative(wrench, time, error.neutral(best.fit.prior.tree))
