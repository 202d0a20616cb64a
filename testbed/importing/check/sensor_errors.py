"""Sensor errors that change in time, as causes of what no reading of a plate explains."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose, phrase
from testbed.core.base.errors import few
from testbed.core.recordings.columns import AXES
from testbed.importing.check.explanation import Explanation
from testbed.importing.check.plate import MIXED, TINY, WEIGHT
from testbed.importing.import_report import in_mapping
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

LIKELY = 6.0
"""Log-likelihood ratio from which a sensor error is named [nats]."""

CLEAR = 5.0
"""Sigmas from which a coefficient is written."""


ROUNDS = 2
"""Regressions for an error, each at the wrench that the last has explained."""

GAIN = 0.3
"""Sigma of the channels' gains, which are free beside: an error from time 0 on has a mean."""


@dataclass(frozen=True, eq=False)
class SensorErrorFit:
    """Coefficients of one sensor error, fitted beside the robot's parameters.

    Attributes:
        error: The sensor error.
        coefficients: Those that are clear, and their values.
        unexplained: Part of each channel's variance with the error, (6,).
        gain: Log-likelihood ratio [nats].
    """

    error: type[SystematicError]
    coefficients: tuple[tuple[Coefficient, float], ...]
    unexplained: Array
    gain: float

    def explains(self, best: Explanation) -> bool:
        """Check whether nothing odd is left of the plate, noise aside.

        Args:
            best: Explanation of the recording without the error.
        """
        return bool((self.unexplained < MIXED + 3 * best.plate.noise).all())


def sensor_error(best: Explanation) -> SensorErrorFit | None:
    """Sensor error that explains a plate best beside its reading; None where none is likely.

    Errors that do not change in time are readings of the plate, or crosstalk.

    Args:
        best: Explanation of the recording; with a wrench.
    """
    fits = sorted(_fits(best), key=lambda each: -each.gain)
    return fits[0] if fits and fits[0].gain > LIKELY and fits[0].coefficients else None


def diagnostic(fit: SensorErrorFit, best: Explanation) -> Diagnostic:
    """Diagnostic of a sensor error, with the lines of the mapping.

    Args:
        fit: The sensor error.
        best: Explanation of the recording without it.
    """
    shares, left = best.plate.unexplained, fit.unexplained
    channel = int(np.argmax(np.log((shares + TINY) / (left + TINY))))
    lines = [
        ("errors", f'"{c.name}"', float(f"{value:.4g}"))
        for c, value in fit.coefficients
    ]
    sizes = [f"{c.name} {value:.3g} {c.unit}".rstrip() for c, value in fit.coefficients]
    return diagnose(
        "plate.sensor-error",
        "the plate",
        shares[channel],
        channel=AXES[channel],
        causes=[fit.error.term],
        cause=phrase(fit.error.term),
        size=few(sizes),
        before=f"{100 * shares[channel]:.2g} %",
        after=f"{100 * left[channel]:.2g} %",
        lines=in_mapping(lines),
    )


def _fits(best: Explanation) -> Iterator[SensorErrorFit]:
    """Fits of all sensor errors that change in time."""
    wrench = best.fit.plate.wrench(best.plate)
    # columns are of the explained wrench, not the measured one: noise on both sides would make
    # coefficients too small; of the one with its gains, which the error multiplies
    plain = wrench - _regression(best, np.zeros((len(wrench), 6, 0)))[3]
    before, *_ = _regression(best, _gains(plain))
    for error in filter(_changes, candidate_errors()):
        explained = plain
        for _ in range(ROUNDS):
            columns = _columns(error, best, explained)
            every = np.concatenate([columns, _gains(explained)], axis=2)
            after, values, sigma, left = _regression(best, every)
            explained = wrench - left - columns @ values[:-6]
        gain = WEIGHT * float(np.log((before + TINY) / (after + TINY)).sum())
        coefficients = error.coefficients(best.fit.prior.tree)
        pairs = zip(coefficients, values.tolist(), CLEAR * sigma, strict=False)
        clear = [(each, value) for each, value, least in pairs if abs(value) > least]
        yield SensorErrorFit(error, tuple(clear), after, gain)


def _gains(wrench: Array) -> Array:
    """Columns of the channels' gains, (T, 6, 6)."""
    return GAIN * PlateGain.derivative(wrench, np.zeros(len(wrench)), np.zeros(6))


def _regression(best: Explanation, columns: Array) -> tuple[Array, Array, Array, Array]:
    """Unexplained parts of the channels, (6,), values and sigmas of columns, (k,), residual."""
    evidence, plate = best.fit.plate, best.plate
    variance = np.maximum(evidence.wrench(plate).var(axis=0), 1e-12)
    for _ in range(2):  # sigmas are of the residual with the columns
        residual, values, sigma = evidence.residual(plate, columns)
        plate = replace(plate, unexplained=residual.var(axis=0) / variance)
    return plate.unexplained, values, sigma, residual


def _changes(error: type[SystematicError]) -> bool:
    """Whether an error of a plate changes in time."""
    if issubclass(error, ClockError):
        return error is not PlateDelay
    return issubclass(error, PlateError) and error.term not in PlateMatrix.contains


def _columns(error: type[SystematicError], best: Explanation, wrench: Array) -> Array:
    """Derivative of a wrench, (T, 6), by coefficients, (T, 6, k); time is from its middle on."""
    time = best.fit.instants.motion.t
    time = time - time.mean()
    if issubclass(error, ClockError):
        rate = best.fit.instants.wrench_rate @ best.plate.map.T
        late = np.broadcast_to(error.lateness(time), len(time))
        return np.asarray(-(rate * late[:, None])[..., None])
    return error.derivative(wrench, time, error.neutral(best.fit.prior.tree))
