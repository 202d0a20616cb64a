"""Delay of encoders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import RANDOM_SIGN, PerJoint
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.shifted_signals import resampled_signal
from testbed.sensors.systematic_error import EncoderError


@dataclass(frozen=True)
class EncoderDelay(EncoderError):
    """Delay of the positions relative to the plate's samples, with one value per joint.

    Equal delays of all joints are equivalent to plate samples that are early.

    Source    A bus that polls its drives one after the other, at intervals of a millisecond.

    Attributes:
        delay: Delay of the positions; negative if they are early [s].
    """

    kind: ClassVar[str] = "encoder_delay"
    remedy: ClassVar[str] = "read all encoders at one instant"
    term: ClassVar[str] = "encoder_delays"
    stage: ClassVar[StageOrder] = StageOrder.CLOCK
    estimated: ClassVar[bool] = False
    contains: ClassVar[tuple[str, ...]] = ("skew",)
    units: ClassVar[tuple[str, str]] = ("s", "s")
    delay: Annotated[PerJoint, RANDOM_SIGN] = 1e-3

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Delayed positions, (M, n) [rad or m]; the first value is held before the first sample."""
        delays = np.broadcast_to(values, signal.shape[1])
        delayed = [
            resampled_signal(q, time, time - delay)
            for q, delay in zip(signal.T, delays, strict=True)
        ]
        return np.stack(delayed, axis=1)

    @classmethod
    def regressor_columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the residual wrench with respect to each joint's delay, (rows, 6, n).

        The result is the time derivative of the wrench due to the motion of the joint alone.
        """
        joint_columns = [
            predicted.joint_time_derivative(j) for j in range(predicted.tree.n)
        ]
        return np.concatenate(joint_columns, axis=2)
