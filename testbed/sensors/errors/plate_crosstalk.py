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

OFF_DIAGONAL = np.flatnonzero(~np.eye(6, dtype=np.bool_))
"""Indices of the off-diagonal elements (the crosstalk) in a row-major (6, 6) matrix."""


@dataclass(frozen=True)
class PlateCrosstalk(PlateError):
    """Crosstalk between channels, in proportion to their full scales.

    With D = diag(full scale), the reading of a wrench W is (1 + D X D^-1) W. The off-diagonal
    elements of X are drawn between -size and size, unless X is given by `matrix`.

    Source    Crosstalk of six-component plates and sensors in data sheets: 1 to 2 % of full
        scale.

    Attributes:
        size: Largest element of X, relative to full scale.
        matrix: Matrix X as six rows of six numbers, one row per reading; its diagonal contains gain
            errors.
    """

    kind: ClassVar[str] = "plate_crosstalk"
    remedy: ClassVar[str] = "calibrate the plate"
    term: ClassVar[str] = "crosstalk"
    fixed: ClassVar[tuple[Coefficient, ...]] = tuple(
        Coefficient(SENSITIVITIES[k].name, "") for k in OFF_DIAGONAL
    )
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    estimated: ClassVar[bool] = False
    estimated_as: ClassVar[str] = "matrix"
    contains: ClassVar[tuple[str, ...]] = ("pose",)
    size: Annotated[float, Ge(0), Le(1)] = 0.01
    matrix: Matrix | None = None
    full_scale: tuple[float, ...] = field(default=FULL_SCALE, repr=False)

    def with_random_values(self, joints: int, rng: np.random.Generator) -> Self:
        """Copy of the error with a random matrix if no matrix is given."""
        if self.matrix is not None:
            return self
        matrix = self.size * rng.uniform(-1, 1, (6, 6)) * (1 - np.eye(6))
        return replace(self, matrix=matrix.tolist())

    @property
    def values(self) -> Array:
        """Sensitivities of each channel to the loads of other channels, (30,)."""
        return np.asarray(self._mixing_matrix.ravel()[OFF_DIAGONAL])

    @property
    def _mixing_matrix(self) -> Array:
        """Mixing matrix D X D^-1, (6, 6)."""
        scale = np.array(self.full_scale)
        mixing = (
            self.size * (1 - np.eye(6))
            if self.matrix is None
            else np.array(self.matrix)
        )
        return np.asarray(mixing * scale[:, None] / scale)

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench with crosstalk added, (M, 6) [N, N m]."""
        del time
        mixing = np.zeros(36)
        mixing[OFF_DIAGONAL] = values
        return signal + signal @ mixing.reshape(6, 6).T

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Wrench with crosstalk and the matrix's gain errors added, (M, 6) [N, N m]."""
        del time, rng
        return signal + signal @ self._mixing_matrix.T

    @classmethod
    def derivative(cls, signal: Array, time: Array, neutral: Array) -> Array:
        """Derivative with respect to the sensitivities to other channels' loads, (M, 6, 30)."""
        return np.asarray(
            PlateMatrix.derivative(signal, time, neutral)[..., OFF_DIAGONAL]
        )
