"""White noise of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import PerAxis
from testbed.sensors.sensor_error import AddedWrench


@dataclass(frozen=True)
class PlateNoise(AddedWrench):
    """White noise on the plate's channels, in addition to `measurement.force_noise`.

    Source    Our own choice: the noise in experiments/table6.toml, for a plate with a range of
        1 kN.

    Attributes:
        force: Standard deviation of the forces [N].
        moment: Standard deviation of the moments [N m].
    """

    kind: ClassVar[str] = "plate_noise"
    force: Annotated[PerAxis, Ge(0)] = 0.5
    moment: Annotated[PerAxis, Ge(0)] = 0.1

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """White noise of unit variance, (M, 6)."""
        del time
        return rng.normal(size=signal.shape)
