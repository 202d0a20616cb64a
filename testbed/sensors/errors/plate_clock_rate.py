"""Rate of the plate's clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Ge, Le

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.shifted_signals import at_times
from testbed.sensors.systematic_error import ClockError, Coefficient


@dataclass(frozen=True)
class PlateClockRate(ClockError):
    """A plate with a clock of its own that runs too fast: a skew that grows from time 0.

    Source    Tolerance of quartz clocks in data sheets: 50 parts in a million.

    Attributes:
        error: Relative; the sample of time t is of t / (1 + error).
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
        """Wrench of earlier and earlier times, (M, 6) [N, N m]; held beyond its ends."""
        rate = 1 + float(values[0])
        return at_times(signal, time, time / rate) if rate != 1 else signal

    @classmethod
    def lateness(cls, time: Array) -> Array | float:
        """Time, (M,) [s]."""
        return time
