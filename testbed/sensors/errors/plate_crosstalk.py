"""Crosstalk of the plate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Self

import numpy as np
from annotated_types import Ge, Le

from testbed.core.base.arrays import Array
from testbed.sensors.errors.plate_matrix import SENSITIVITIES, PlateMatrix
from testbed.sensors.kind_table import Matrix
from testbed.sensors.sensor_error import FULL_SCALE, StageOrder
from testbed.sensors.systematic_error import Coefficient, PlateError

MIXED = np.flatnonzero(~np.eye(6, dtype=np.bool_))
"""Sensitivities of a channel to the load of another."""


@dataclass(frozen=True)
class PlateCrosstalk(PlateError):
    """Channels that show some of the others' loads, in proportion to their full scales.

    With D = diag(full scale) shown is (1 + D X D^-1) W. The off-diagonal entries of X are drawn
    between -size and size, unless `matrix` says what X is.

    Source    Crosstalk of six-component plates and sensors in data sheets: 1 to 2 % of full
        scale.

    Attributes:
        size: Largest entry, relative to full scale.
        matrix: X, six lists of six numbers: row by row, the channel that shows it; its diagonal
            are errors of the gains.
    """

    kind: ClassVar[str] = "plate_crosstalk"
    remedy: ClassVar[str] = "calibrate the plate"
    term: ClassVar[str] = "crosstalk"
    fixed: ClassVar[tuple[Coefficient, ...]] = tuple(
        Coefficient(SENSITIVITIES[k].name, "") for k in MIXED
    )
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    estimated: ClassVar[bool] = False
    estimated_as: ClassVar[str] = "matrix"
    contains: ClassVar[tuple[str, ...]] = ("pose",)
    size: Annotated[float, Ge(0), Le(1)] = 0.01
    matrix: Matrix | None = None
    full_scale: tuple[float, ...] = field(default=FULL_SCALE, repr=False)

    def sample(self, joints: int, rng: np.random.Generator) -> Self:
        """Copy of the error with a random matrix where none is given."""
        if self.matrix is not None:
            return self
        mixed = self.size * rng.uniform(-1, 1, (6, 6)) * (1 - np.eye(6))
        return replace(self, matrix=mixed.tolist())

    @property
    def values(self) -> Array:
        """Sensitivities of a channel to the load of another, (30,)."""
        return np.asarray(self._mixing.ravel()[MIXED])

    @property
    def _mixing(self) -> Array:
        """D X D^-1, (6, 6)."""
        scale = np.array(self.full_scale)
        mixing = (
            self.size * (1 - np.eye(6))
            if self.matrix is None
            else np.array(self.matrix)
        )
        return np.asarray(mixing * scale[:, None] / scale)

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench with some of every channel in every other, (M, 6) [N, N m]."""
        del time
        mixing = np.zeros(36)
        mixing[MIXED] = values
        return signal + signal @ mixing.reshape(6, 6).T

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Wrench with the matrix's part added, its diagonal too, (M, 6) [N, N m]."""
        del time, rng
        return signal + signal @ self._mixing.T

    @classmethod
    def derivative(cls, signal: Array, time: Array, neutral: Array) -> Array:
        """Each channel in each other one, (M, 6, 30)."""
        return np.asarray(PlateMatrix.derivative(signal, time, neutral)[..., MIXED])
