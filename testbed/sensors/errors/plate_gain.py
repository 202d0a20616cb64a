"""Gain errors of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import RANDOM_SIGN, PerChannel
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import (
    Coefficient,
    PlateError,
    channel_coefficients,
)


@dataclass(frozen=True)
class PlateGain(PlateError):
    """Gain errors of the plate's channels.

    Source    Accuracy of force plates and six-axis sensors in data sheets: 0.5 %.

    Attributes:
        error: Relative error; 0.005 means that readings are 0.5 % too large.
    """

    kind: ClassVar[str] = "plate_gain"
    remedy: ClassVar[str] = "calibrate the plate"
    term: ClassVar[str] = "gains"
    fixed: ClassVar[tuple[Coefficient, ...]] = channel_coefficients("gains", [""] * 6)
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    error: Annotated[PerChannel, RANDOM_SIGN] = 0.005

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Channels multiplied by `1 + error`, (M, 6) [N, N m]."""
        del time
        return (1 + values) * signal
