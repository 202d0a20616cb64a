"""White noise of reported torques."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from testbed.sensors.kind_table import PerJoint, key
from testbed.sensors.sensor_error import (
    NoiseError,
    Signal,
)


@dataclass(frozen=True)
class TorqueNoise(NoiseError):
    """White noise on the reported torques, besides that of `measurement.torque_noise`.

    Source    Noise of current sensors in data sheets: 0.5 % of their range.

    Attributes:
        sigma: Standard deviation [N m or N].
    """

    kind: ClassVar[str] = "torque_noise"
    signal: ClassVar[Signal] = "torque"
    sigma: PerJoint = key(0.5, "joints", least=0)
