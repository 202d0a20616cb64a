"""Constant offset of reported torques."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import RANDOM_SIGN, PerJoint, joint_array
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class TorqueOffset(SensorError):
    """Constant offset of the reported torques.

    Source    Zero error of Hall-effect current sensors in data sheets: 0.5 to 1 % of their
        range, for joints with a torque range of 100 N m.

    Attributes:
        error: Offset [N m or N].
    """

    kind: ClassVar[str] = "torque_offset"
    signal: ClassVar[Signal] = "torque"
    stage: ClassVar[StageOrder] = StageOrder.NOISE
    error: Annotated[PerJoint, RANDOM_SIGN] = 1.0

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Torques plus the offsets, (M, n) [N m or N]."""
        del time, rng
        return signal + joint_array(self.error)
