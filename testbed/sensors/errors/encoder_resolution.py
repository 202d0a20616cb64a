"""Resolution of encoders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import PerJoint, joint_array
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class EncoderResolution(SensorError):
    """Quantisation of positions: rounding to the nearest count.

    Source    16 bits per turn: 9.6e-5 rad.

    Attributes:
        count: Least count; 0 for no rounding [rad or m].
    """

    kind: ClassVar[str] = "encoder_resolution"
    signal: ClassVar[Signal] = "position"
    stage: ClassVar[StageOrder] = StageOrder.CONVERTER
    count: Annotated[PerJoint, Ge(0)] = 1e-4

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Positions rounded to whole counts, (M, n) [rad or m]."""
        del time, rng
        count = joint_array(self.count)
        step = np.where(count > 0, count, 1.0)
        return np.where(count > 0, step * np.round(signal / step), signal)
