"""Random walk of the plate's zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import PerAxis
from testbed.sensors.sensor_error import AddedWrench


@dataclass(frozen=True)
class PlateRandomWalk(AddedWrench):
    """Random walk of the plate's zero, starting from zero at time 0.

    Source    Our own choice: after one second, as large as a drift of 0.05 N/s.

    Attributes:
        force: Standard deviation of the forces after one second [N/sqrt(s)].
        moment: Standard deviation of the moments after one second [N m/sqrt(s)].
    """

    kind: ClassVar[str] = "plate_random_walk"
    force: Annotated[PerAxis, Ge(0)] = 0.05
    moment: Annotated[PerAxis, Ge(0)] = 0.01

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Random walk of unit variance per second, (M, 6) [sqrt(s)]."""
        step_sigma = np.sqrt(np.append(abs(time[0]), np.diff(time)))
        return np.cumsum(step_sigma[:, None] * rng.normal(size=signal.shape), axis=0)
