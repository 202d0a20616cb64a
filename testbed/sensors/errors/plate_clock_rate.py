"""Rate error of the plate's clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Ge, Le

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.shifted_signals import resampled_signal
from testbed.sensors.systematic_error import ClockError, Coefficient


@dataclass(frozen=True)
class PlateClockRate(ClockError):
    """Rate error of the plate's clock: a delay that grows from time 0.

    Source    Tolerance of quartz clocks in data sheets: 50 parts in a million.

    Attributes:
        error: Relative error; the sample with time stamp t is taken at t / (1 + error).
    """

    kind: ClassVar[str] = "plate_clock_rate"
    remedy: ClassVar[str] = (
        "give plate and encoders one clock; or cut the recording and estimate each part's skew"
    )
    term: ClassVar[str] = "clock_rate"
    fixed: ClassVar[tuple[Coefficient, ...]] = (Coefficient("clock_rate", ""),)
    stage: ClassVar[StageOrder] = StageOrder.CLOCK
    estimated: ClassVar[bool] = False
    error: Annotated[float, Ge(-0.5), Le(1.0)] = 5e-5

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench at times t / (1 + error), (M, 6) [N, N m]; values are held beyond the ends."""
        rate = 1 + float(values[0])
        return resampled_signal(signal, time, time / rate) if rate != 1 else signal

    @classmethod
    def delay_derivative(cls, time: Array) -> Array | float:
        """Derivative of the delay with respect to the rate error: the time, (M,) [s]."""
        return time
