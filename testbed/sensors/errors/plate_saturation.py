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
    """Saturation: a range too small for the motion, at whose ends channels stop.

    The range covers a share of each channel's swing in this recording, around its middle:
    amplifiers are set to zero with the robot on the plate.

    Source    A range chosen for nine tenths of the motion.

    Attributes:
        covered: Share of the swing between least and greatest value.
    """

    kind: ClassVar[str] = "plate_saturation"
    signal: ClassVar[Signal] = "wrench"
    stage: ClassVar[StageOrder] = StageOrder.RANGE
    covered: Annotated[PerChannel, Ge(0)] = 0.9

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench within the range, (M, 6) [N, N m]."""
        del time, rng
        low, high = signal.min(axis=0), signal.max(axis=0)
        cut = (1 - np.asarray(self.covered)) * (high - low) / 2
        return np.clip(signal, low + cut, high - cut)
