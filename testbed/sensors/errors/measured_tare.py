"""Tare by a measurement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Le

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class MeasuredTare(SensorError):
    """A tare that is measured, not known: the mean of the plate at rest without the robot.

    The plate has the errors that it has in the recording (the same bias, the same crosstalk)
    and other noise. Its zero drifts and wanders in between.

    Source    Practice: five seconds, a minute before the robot is mounted and moves.

    Attributes:
        seconds: How long it is measured [s].
        before: How long before the recording that ends [s].
    """

    kind: ClassVar[str] = "measured_tare"
    signal: ClassVar[Signal] = "tare"
    stage: ClassVar[StageOrder] = StageOrder.LINE
    seconds: Annotated[float, Gt(0), Le(60)] = 5.0
    before: Annotated[float, Ge(0)] = 60.0

    def instants(self, rate: float) -> Array:
        """When it is measured, with the recording's first sample at 0 [s].

        Args:
            rate: Samples a second [Hz].
        """
        samples = max(2, round(self.seconds * rate))
        return (np.arange(samples) - samples) / rate - self.before

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The mean, in every row, of what the plate shows at rest, (M, 6) [N, N m]."""
        del time, rng
        return np.broadcast_to(signal.mean(axis=0), signal.shape)
