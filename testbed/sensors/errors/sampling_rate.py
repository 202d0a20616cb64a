"""Error of the sampling rate."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import Signal, StageOrder
from testbed.sensors.systematic_error import Coefficient, SystematicError


class SamplingRate(SystematicError):
    """Relative error of the sampling time in the time stamps, which scales all velocities."""

    kind: ClassVar[str] = "sampling_rate"
    remedy: ClassVar[str] = "count the samples of a known time, and look for lost ones"
    term: ClassVar[str] = "sampling"
    fixed: ClassVar[tuple[Coefficient, ...]] = (Coefficient("sampling", ""),)
    signal: ClassVar[Signal] = "position"
    stage: ClassVar[StageOrder] = StageOrder.CLOCK
    estimated: ClassVar[bool] = False

    @classmethod
    def regressor_columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the residual wrench with respect to the rate error, (rows, 6, 1).

        The relative change of the velocities is the error, that of the accelerations twice the
        error.
        """
        qd, qdd = predicted.motion.qd, predicted.motion.qdd
        derivatives = (
            predicted.coordinate_derivative(j, 0.0, qd[:, j], 2 * qdd[:, j])
            for j in range(predicted.tree.n)
        )
        return predicted.filter_signals(-np.sum([*derivatives], axis=0)[..., None])
