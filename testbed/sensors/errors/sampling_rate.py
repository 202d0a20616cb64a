"""Wrong sampling rate."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import Signal, StageOrder
from testbed.sensors.systematic_error import Coefficient, SystematicError


class SamplingRate(SystematicError):
    """Time between samples that is not what their stamps say: velocities are too large."""

    kind: ClassVar[str] = "sampling_rate"
    remedy: ClassVar[str] = "count the samples of a known time, and look for lost ones"
    term: ClassVar[str] = "sampling"
    fixed: ClassVar[tuple[Coefficient, ...]] = (Coefficient("sampling", ""),)
    signal: ClassVar[Signal] = "position"
    stage: ClassVar[StageOrder] = StageOrder.CLOCK
    estimated: ClassVar[bool] = False

    @classmethod
    def columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the wrench by velocities and twice the accelerations, (rows, 6, 1)."""
        qd, qdd = predicted.motion.qd, predicted.motion.qdd
        each = (
            predicted.along(j, 0.0, qd[:, j], 2 * qdd[:, j])
            for j in range(predicted.tree.n)
        )
        return predicted.rows(-np.sum([*each], axis=0)[..., None])
