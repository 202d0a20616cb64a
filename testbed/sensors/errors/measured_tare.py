"""Tare from a measurement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Le

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class MeasuredTare(SensorError):
    """Measured tare: mean wrench of the plate at rest, without the robot.

    The plate has the same systematic errors (bias, crosstalk) as in the recording, but different
    noise. Its zero drifts and wanders between the tare measurement and the recording.

    Source    Common practice: five seconds, one minute before the robot is mounted and moves.

    Attributes:
        seconds: Duration of the measurement [s].
        before: Time from the end of the measurement to the start of the recording [s].
    """

    kind: ClassVar[str] = "measured_tare"
    signal: ClassVar[Signal] = "tare"
    stage: ClassVar[StageOrder] = StageOrder.LINE
    seconds: Annotated[float, Gt(0), Le(60)] = 5.0
    before: Annotated[float, Ge(0)] = 60.0

    def instants(self, rate: float) -> Array:
        """Instants of the tare measurement, relative to the recording's first sample [s].

        Args:
            rate: Sampling rate [Hz].
        """
        samples = max(2, round(self.seconds * rate))
        return (np.arange(samples) - samples) / rate - self.before

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Mean of the plate's readings at rest, repeated in every row, (M, 6) [N, N m]."""
        del time, rng
        return np.broadcast_to(signal.mean(axis=0), signal.shape)
