"""White noise of encoders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from testbed.sensors.kind_table import PerJoint, key
from testbed.sensors.sensor_error import (
    NoiseError,
    Signal,
)


@dataclass(frozen=True)
class EncoderNoise(NoiseError):
    """White noise on positions, besides that of `measurement.encoder_noise`.

    Source    Interpolation noise of encoders of the 16-bit class.

    Attributes:
        sigma: Standard deviation [rad or m].
    """

    kind: ClassVar[str] = "encoder_noise"
    signal: ClassVar[Signal] = "position"
    sigma: PerJoint = key(1e-4, "joints", least=0)
