"""Saturation of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import PerChannel
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class PlateSaturation(SensorError):
    """Saturation: channels clipped to a range smaller than the motion's range.

    The range is a fraction of each channel's range in this recording, centred on the middle of that
    range, because amplifiers are set to zero with the robot on the plate.

    Source    A range that was chosen for nine tenths of the range of the motion.

    Attributes:
        covered: Fraction of the range between smallest and largest value.
    """

    kind: ClassVar[str] = "plate_saturation"
    signal: ClassVar[Signal] = "wrench"
    stage: ClassVar[StageOrder] = StageOrder.RANGE
    covered: Annotated[PerChannel, Ge(0)] = 0.9

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Wrench clipped to the range, (M, 6) [N, N m]."""
        del time, rng
        low, high = signal.min(axis=0), signal.max(axis=0)
        margin = (1 - np.asarray(self.covered)) * (high - low) / 2
        return np.clip(signal, low + margin, high - margin)
