"""Delays of encoders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import SIGN, PerJoint
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.shifted_signals import at_times
from testbed.sensors.systematic_error import EncoderError


@dataclass(frozen=True)
class EncoderDelay(EncoderError):
    """Positions that are older than the plate's samples of the same time, joint by joint.

    Delays that are alike of all joints are those of a plate that is early.

    Source    A bus that polls its drives in turn, each a millisecond.

    Attributes:
        delay: How late a position is; negative if it is early [s].
    """

    kind: ClassVar[str] = "encoder_delay"
    remedy: ClassVar[str] = "read all encoders at one instant"
    term: ClassVar[str] = "encoder_delays"
    stage: ClassVar[StageOrder] = StageOrder.CLOCK
    estimated: ClassVar[bool] = False
    contains: ClassVar[tuple[str, ...]] = ("skew",)
    units: ClassVar[tuple[str, str]] = ("s", "s")
    delay: Annotated[PerJoint, SIGN] = 1e-3

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Positions of other times, (M, n) [rad or m]; held before the first sample."""
        delays = np.broadcast_to(values, signal.shape[1])
        late = [
            at_times(q, time, time - delay)
            for q, delay in zip(signal.T, delays, strict=True)
        ]
        return np.stack(late, axis=1)

    @classmethod
    def columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the wrench in time by each joint's motion, (rows, 6, n)."""
        each = [predicted.passing(j) for j in range(predicted.tree.n)]
        return np.concatenate(each, axis=2)
