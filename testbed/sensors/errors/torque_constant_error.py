"""Wrong torque constants."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import SIGN, PerJoint, each_joint
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class TorqueConstantError(SensorError):
    """Torques reported with wrong torque constants.

    Source    Tolerances of motors' torque constants in data sheets: 5 to 10 %.

    Attributes:
        error: Relative: 0.08 reports 8 % too much.
    """

    kind: ClassVar[str] = "torque_constant_error"
    signal: ClassVar[Signal] = "torque"
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    error: Annotated[PerJoint, SIGN] = 0.05

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Torques on wrong scales, (M, n) [N m or N]."""
        del time, rng
        return (1 + each_joint(self.error)) * signal
