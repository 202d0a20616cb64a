"""Quantisation of the plate."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Le

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import FULL_SCALE, SensorError, Signal, StageOrder


@dataclass(frozen=True)
class PlateConverter(SensorError):
    """Analog-to-digital converter: rounding to whole counts within the range.

    The range extends from `-full_scale` to `full_scale` of the instrument.

    Source    12 bits, as in older data acquisition cards; 16 bits are common today.

    Attributes:
        bits: Resolution in bits, 1 to 32.
    """

    kind: ClassVar[str] = "plate_converter"
    signal: ClassVar[Signal] = "wrench"
    stage: ClassVar[StageOrder] = StageOrder.CONVERTER
    bits: Annotated[int, Ge(1), Le(32)] = 12
    full_scale: tuple[float, ...] = field(default=FULL_SCALE, repr=False)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Wrench rounded to whole counts within the range, (M, 6) [N, N m]."""
        del time, rng
        half_range = 2 ** (self.bits - 1)
        count = np.array(self.full_scale) / half_range
        result: Array = count * np.clip(
            np.round(signal / count), -half_range, half_range - 1
        )
        return result
