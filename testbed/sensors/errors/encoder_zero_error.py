"""Zero errors of encoders."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import RANDOM_SIGN, PerJoint
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import EncoderError


@dataclass(frozen=True)
class EncoderZeroError(EncoderError):
    """Zero error of the positions: a constant offset.

    Source    An arm aligned visually with engraved zero marks: 0.2 degrees.

    Attributes:
        error: Offset of the reading [rad or m].
    """

    kind: ClassVar[str] = "encoder_zero_error"
    term: ClassVar[str] = "joint_zeros"
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    unfolded: ClassVar[bool] = True
    units: ClassVar[tuple[str, str]] = ("rad", "m")
    error: Annotated[PerJoint, RANDOM_SIGN] = 3.5e-3

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Positions plus the offsets, (M, n) [rad or m]."""
        del time
        return signal + values

    @classmethod
    def coordinate_errors(
        cls, q: Array, qd: Array, qdd: Array
    ) -> Iterable[tuple[Any, Any, Any]]:
        """Derivatives with respect to the offset: 1 for the position, 0 for its derivatives."""
        del q, qd, qdd
        return ((1.0, 0.0, 0.0),)
