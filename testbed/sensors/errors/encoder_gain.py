"""Gain errors of encoders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import RANDOM_SIGN, PerJoint
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import EncoderError


@dataclass(frozen=True)
class EncoderGain(EncoderError):
    """Gain error of the positions, caused for example by a wrong gear ratio or pitch.

    Source    A gear ratio entered with two digits: 1 %.

    Attributes:
        error: Relative error; 0.01 means that readings are 1 % too large.
    """

    kind: ClassVar[str] = "encoder_gain"
    remedy: ClassVar[str] = "correct the encoders' scales"
    term: ClassVar[str] = "encoder_gains"
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    estimated: ClassVar[bool] = False
    units: ClassVar[tuple[str, str]] = ("", "")
    error: Annotated[PerJoint, RANDOM_SIGN] = 0.01

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Positions multiplied by `1 + error`, (M, n) [rad or m]."""
        del time
        return (1 + values) * signal
