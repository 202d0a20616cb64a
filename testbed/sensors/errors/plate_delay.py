"""Delay of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from testbed.core.base.arrays import Array
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import StageOrder, sampling_time
from testbed.sensors.shifted_signals import at_times, reach, shifted
from testbed.sensors.systematic_error import ClockError, Coefficient


@dataclass(frozen=True)
class PlateDelay(ClockError):
    """Skew: plate samples that are older than the joints' of the same time, by a constant delay.

    Source    Two loggers started by software: one sample at a thousand a second.

    Attributes:
        delay: How late the plate is; negative if it is early [s].
    """

    kind: ClassVar[str] = "plate_delay"
    term: ClassVar[str] = "skew"
    fixed: ClassVar[tuple[Coefficient, ...]] = (Coefficient("skew", "s"),)
    stage: ClassVar[StageOrder] = StageOrder.CLOCK
    delay: float = 1e-3

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench of another time, (M, 6) [N, N m]; held before the first sample."""
        delay = float(values[0])
        return at_times(signal, time, time - delay) if delay else signal

    @classmethod
    def without(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench of the later samples, (M, 6) [N, N m]."""
        return shifted(signal, float(values[0]) / sampling_time(time))

    @classmethod
    def samples_lost(cls, values: Array, rate: float) -> int:
        """Samples at either end that a delay leaves without neighbours."""
        return reach(float(values[0]), rate)

    @classmethod
    def lateness(cls, time: Array) -> Array | float:
        """One."""
        del time
        return 1.0

    @classmethod
    def measured_columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the measured wrench in time, (rows, 6, 1)."""
        return -predicted.shown_rate[..., None]
