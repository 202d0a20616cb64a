"""White noise of reported torques."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Ge

from testbed.sensors.kind_table import PerJoint
from testbed.sensors.sensor_error import NoiseError, Signal


@dataclass(frozen=True)
class TorqueNoise(NoiseError):
    """White noise on the reported torques, in addition to `measurement.torque_noise`.

    Source    Noise of current sensors in data sheets: 0.5 % of their range.

    Attributes:
        sigma: Standard deviation [N m or N].
    """

    kind: ClassVar[str] = "torque_noise"
    signal: ClassVar[Signal] = "torque"
    sigma: Annotated[PerJoint, Ge(0)] = 0.5
