"""Errors of torque constants."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import RANDOM_SIGN, PerJoint, joint_array
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class TorqueConstantError(SensorError):
    """Gain error of the reported torques, caused by wrong torque constants.

    Source    Tolerances of the torque constants of motors in data sheets: 5 to 10 %.

    Attributes:
        error: Relative error; 0.08 means that reported torques are 8 % too large.
    """

    kind: ClassVar[str] = "torque_constant_error"
    signal: ClassVar[Signal] = "torque"
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    error: Annotated[PerJoint, RANDOM_SIGN] = 0.05

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Torques multiplied by `1 + error`, (M, n) [N m or N]."""
        del time, rng
        return (1 + joint_array(self.error)) * signal
