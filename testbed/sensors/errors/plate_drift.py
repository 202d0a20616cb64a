"""Linear drift of the plate's zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.recordings.columns import WRENCH_UNITS
from testbed.sensors.kind_table import RANDOM_SIGN, PerAxis
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import (
    Coefficient,
    PlateError,
    channel_coefficients,
)


@dataclass(frozen=True)
class PlateDrift(PlateError):
    """Zero error that grows linearly with time, starting from zero at time 0.

    Source    Five times the drift of charge amplifiers in data sheets (0.01 N/s), for an amplifier
        during warm-up.

    Attributes:
        force: Drift of the forces [N/s].
        moment: Drift of the moments [N m/s].
    """

    kind: ClassVar[str] = "plate_drift"
    term: ClassVar[str] = "slope"
    fixed: ClassVar[tuple[Coefficient, ...]] = channel_coefficients(
        "slope", [f"{unit}/s" for unit in WRENCH_UNITS]
    )
    stage: ClassVar[StageOrder] = StageOrder.NOISE
    tested: ClassVar[bool] = False  # slow noise has nearly the same effect
    of_one_recording: ClassVar[bool] = True
    added: ClassVar[bool] = True
    force: Annotated[PerAxis, RANDOM_SIGN] = 0.05
    moment: Annotated[PerAxis, RANDOM_SIGN] = 0.01

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench with `time * drift` added, (M, 6) [N, N m]."""
        return signal + time[:, None] * values

    @classmethod
    def derivative(cls, signal: Array, time: Array, neutral: Array) -> Array:
        """Derivative with respect to the drifts, `time * identity`, (M, 6, 6) [s]."""
        del signal, neutral
        return time[:, None, None] * np.eye(6)
