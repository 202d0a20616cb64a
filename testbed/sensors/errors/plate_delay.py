"""Delay of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from testbed.core.base.arrays import Array
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import StageOrder, sampling_time
from testbed.sensors.shifted_signals import (
    edge_samples,
    resampled_signal,
    shifted_signal,
)
from testbed.sensors.systematic_error import ClockError, Coefficient


@dataclass(frozen=True)
class PlateDelay(ClockError):
    """Constant delay (skew) of the plate's samples relative to the joints' samples.

    Source    Two loggers that are started by software: one sample at 1000 samples per second.

    Attributes:
        delay: Delay of the plate; negative if the plate is early [s].
    """

    kind: ClassVar[str] = "plate_delay"
    term: ClassVar[str] = "skew"
    fixed: ClassVar[tuple[Coefficient, ...]] = (Coefficient("skew", "s"),)
    stage: ClassVar[StageOrder] = StageOrder.CLOCK
    delay: float = 1e-3

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Delayed wrench, (M, 6) [N, N m]; the first value is held before the first sample."""
        delay = float(values[0])
        return resampled_signal(signal, time, time - delay) if delay else signal

    @classmethod
    def corrected_signal(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench advanced by the delay, (M, 6) [N, N m]."""
        return shifted_signal(signal, float(values[0]) / sampling_time(time))

    @classmethod
    def lost_sample_count(cls, values: Array, rate: float) -> int:
        """Number of samples at each end that lack neighbours for the correction of the delay."""
        return edge_samples(float(values[0]), rate)

    @classmethod
    def delay_derivative(cls, time: Array) -> Array | float:
        """Derivative of the delay with respect to its coefficient, which is 1."""
        del time
        return 1.0

    @classmethod
    def columns_from_measured(cls, predicted: PredictedWrench) -> Array:
        """Negative time derivative of the measured wrench, (rows, 6, 1)."""
        return -predicted.measured_wrench_rate[..., None]
