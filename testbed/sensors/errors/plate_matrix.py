"""Sensitivity matrix of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt

from testbed.core.base.arrays import Array
from testbed.core.recordings.columns import AXES
from testbed.sensors.kind_table import Matrix
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import Coefficient, PlateError

SENSITIVITIES = tuple(
    Coefficient(f"gain/{shown}", "", 1.0)
    if shown == load
    else Coefficient(
        f"crosstalk/{shown}/{load}",
        {"FM": "1/m", "MF": "m"}.get(f"{shown[0]}{load[0]}", ""),
    )
    for shown in AXES
    for load in AXES
)
"""Row by row: `gain/Fz` is the reading of Fz for a unit of that force, `crosstalk/Fx/Fz` that of
Fx for a unit of Fz."""


@dataclass(frozen=True)
class PlateMatrix(PlateError):
    """Readings that are a matrix times the wrench: all gains and crosstalk.

    Source    The calibration matrix of six-component sensors.

    Attributes:
        gain: Of all channels, where no matrix is given.
        matrix: Six lists of six numbers: row by row, the channel that shows it.
    """

    kind: ClassVar[str] = "plate_matrix"
    term: ClassVar[str] = "matrix"
    fixed: ClassVar[tuple[Coefficient, ...]] = SENSITIVITIES
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    tested: ClassVar[bool] = False  # its parts are: gains, crosstalk, pose
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
        """Matrix times the wrench, (M, 6) [N, N m]."""
        del time
        return signal @ values.reshape(6, 6).T

    @classmethod
    def derivative(cls, signal: Array, time: Array, neutral: Array) -> Array:
        """Each channel in each row of the matrix, (M, 6, 36)."""
        del time, neutral
        columns = np.zeros((len(signal), 6, 6, 6))
        columns[:, range(6), range(6)] = signal[:, None]
        return columns.reshape(-1, 6, 36)

    @classmethod
    def measured_columns(cls, predicted: PredictedWrench) -> Array:
        """Columns of the predicted wrench: those of the measured one have the unknown mixture."""
        return cls.columns(predicted)

    @classmethod
    def without(cls, signal: Array, time: Array, values: Array) -> Array:
        """Inverse matrix times the reading, (M, 6) [N, N m]."""
        del time
        return np.asarray(signal @ cls.unmixing(values).T)

    @classmethod
    def unmixing(cls, values: Array) -> Array:
        """Inverse of the matrix, (6, 6)."""
        return np.asarray(np.linalg.inv(values.reshape(6, 6)))
