"""White noise of encoders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Ge

from testbed.sensors.kind_table import PerJoint
from testbed.sensors.sensor_error import NoiseError, Signal


@dataclass(frozen=True)
class EncoderNoise(NoiseError):
    """White noise on the positions, in addition to `measurement.encoder_noise`.

    Source    Interpolation noise of encoders with a resolution of about 16 bits.

    Attributes:
        sigma: Standard deviation [rad or m].
    """

    kind: ClassVar[str] = "encoder_noise"
    signal: ClassVar[Signal] = "position"
    sigma: Annotated[PerJoint, Ge(0)] = 1e-4
