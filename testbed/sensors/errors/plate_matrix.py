"""Sensitivity matrix of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt

from testbed.core.base.arrays import Array
from testbed.core.recordings.columns import WRENCH_COMPONENTS
from testbed.sensors.kind_table import Matrix
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import Coefficient, PlateError

SENSITIVITIES = tuple(
    Coefficient(f"gain/{reading}", "", 1.0)
    if reading == load
    else Coefficient(
        f"crosstalk/{reading}/{load}",
        {"FM": "1/m", "MF": "m"}.get(f"{reading[0]}{load[0]}", ""),
    )
    for reading in WRENCH_COMPONENTS
    for load in WRENCH_COMPONENTS
)
"""Coefficients row by row: `gain/Fz` is the reading of channel Fz per unit of the force Fz, and
`crosstalk/Fx/Fz` is the reading of channel Fx per unit of the force Fz."""


@dataclass(frozen=True)
class PlateMatrix(PlateError):
    """Sensitivity matrix of the plate, with gains and crosstalk: `reading = matrix @ wrench`.

    Source    Calibration matrix of six-component sensors.

    Attributes:
        gain: Gain of all channels, used if no matrix is given.
        matrix: Six rows of six numbers, one row per reading.
    """

    kind: ClassVar[str] = "plate_matrix"
    term: ClassVar[str] = "matrix"
    fixed: ClassVar[tuple[Coefficient, ...]] = SENSITIVITIES
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    tested: ClassVar[bool] = False  # gains, crosstalk and pose are tested instead
    contains: ClassVar[tuple[str, ...]] = ("gains", "crosstalk", "pose", "height")
    jointly: ClassVar[bool] = True
    added: ClassVar[bool] = True
    gain: Annotated[float, Gt(0)] = 1.01
    matrix: Matrix | None = None

    @property
    def values(self) -> Array:
        """Sensitivities, (36,)."""
        return np.ravel(self.gain * np.eye(6) if self.matrix is None else self.matrix)

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Product of the sensitivity matrix and the wrench, (M, 6) [N, N m]."""
        del time
        return signal @ values.reshape(6, 6).T

    @classmethod
    def derivative(cls, signal: Array, time: Array, neutral: Array) -> Array:
        """Derivative of the reading with respect to the matrix, row by row, (M, 6, 36)."""
        del time, neutral
        columns = np.zeros((len(signal), 6, 6, 6))
        columns[:, range(6), range(6)] = signal[:, None]
        return columns.reshape(-1, 6, 36)

    @classmethod
    def columns_from_measured(cls, predicted: PredictedWrench) -> Array:
        """Columns from the predicted wrench, because the measured channels are mixed."""
        return cls.regressor_columns(predicted)

    @classmethod
    def corrected_signal(cls, signal: Array, time: Array, values: Array) -> Array:
        """Product of the inverse sensitivity matrix and the reading, (M, 6) [N, N m]."""
        del time
        return np.asarray(signal @ cls.unmixing_matrix(values).T)

    @classmethod
    def unmixing_matrix(cls, values: Array) -> Array:
        """Inverse of the sensitivity matrix, (6, 6)."""
        return np.asarray(np.linalg.inv(values.reshape(6, 6)))
