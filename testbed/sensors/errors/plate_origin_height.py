"""Error in the height of the plate's origin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.errors.plate_pose import PlatePose
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import Coefficient, PlateError


@dataclass(frozen=True)
class PlateOriginHeight(PlateError):
    """Height of the origin of the plate's moments above the origin of the bedplate.

    Source    Force plates output moments about a point some centimetres below their surface.

    Attributes:
        height: Height of the plate's origin above the bedplate's origin [m].
    """

    kind: ClassVar[str] = "plate_origin_height"
    term: ClassVar[str] = "height"
    fixed: ClassVar[tuple[Coefficient, ...]] = (Coefficient("height", "m"),)
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    tested: ClassVar[bool] = False  # the pose is tested instead
    height: float = 0.02

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench about the plate's origin, (M, 6) [N, N m]."""
        return PlatePose.effect(signal, time, np.pad(values, (5, 0)))
