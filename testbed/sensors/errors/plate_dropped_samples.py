"""Lost samples of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Le

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class PlateDroppedSamples(SensorError):
    """Samples that are lost in transmission and replaced by the previous sample.

    Source    A bus without retransmission: one sample in a thousand.

    Attributes:
        share: Fraction of the samples that are lost, independently at random.
    """

    kind: ClassVar[str] = "plate_dropped_samples"
    signal: ClassVar[Signal] = "wrench"
    stage: ClassVar[StageOrder] = StageOrder.LINE
    share: Annotated[float, Ge(0), Le(1)] = 1e-3

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Wrench with lost samples replaced by the previous sample, (M, 6) [N, N m]."""
        del time
        lost = rng.random(len(signal)) < self.share
        last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(signal))))
        return signal[last]
