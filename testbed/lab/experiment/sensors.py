"""Sensors of a rig with their errors: plain frozen values, perfect by default."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from testbed.core.base.errors import SettingsError
from testbed.core.base.summary_table import Value
from testbed.core.robot.force_sensor import ForceSensor
from testbed.lab.instruments.chain import Instrument
from testbed.sensors.sensor_error import FULL_SCALE, SensorError


class Sensor(Value):
    """Sensor of a rig: base class of force plate, joint torques and encoders."""

    errors: Sequence[SensorError]

    @property
    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Keyword arguments that describe this sensor to `Instrument`, without its errors."""


@dataclass(frozen=True)
class ForcePlate(Sensor):
    """Six-axis force plate under the robot, or six-axis force sensor in the robot.

    It measures the wrench of the bedplate on the robot, (M, 6) [N, N m]: force first, along the
    bedplate's axes, with the moment about the bedplate's origin. By default it is perfect.

    Attributes:
        noise: Standard deviations of forces [N] and moments [N m].
        errors: Further errors, applied in this order, such as `PlateBias()` or `PlatePose()`
            (docs/instruments.md).
        full_scale: Largest magnitudes of Fx, Fy, Fz [N], Mx, My, Mz [N m].
        model: Name of a commercial plate, such as "ati-axia80-m20", whose noise and range replace
            those that are not given.
        mounting: Position of a force sensor in the robot; None for the plate under it.
    """

    noise: tuple[float, float] = (0.0, 0.0)
    errors: Sequence[SensorError] = ()
    full_scale: tuple[float, float, float, float, float, float] = FULL_SCALE
    model: str = ""
    mounting: ForceSensor | None = None

    def __post_init__(self) -> None:
        if np.shape(self.noise) != (2,):
            raise SettingsError(
                f"ForcePlate: noise is (force [N], moment [N m]), found {self.noise!r}"
            )

    @property
    def settings(self) -> dict[str, Any]:
        """Keyword arguments that describe this sensor to `Instrument`, without its errors."""
        force, moment = self.noise
        return {
            "plate": self.model,
            "force_noise": force,
            "moment_noise": moment,
            "full_scale": self.full_scale,
        }


@dataclass(frozen=True)
class JointTorques(Sensor):
    """Motor torques as reported by the drives, (M, n) [N m or N]; perfect by default.

    Attributes:
        noise: Standard deviation [N m or N].
        gains: Ratio of reported to true torque by joint, such as {"waist": 1.08}; default 1.
        errors: Further errors, applied in this order, such as `TorqueOffset()`
            (docs/instruments.md).
    """

    noise: float = 0.0
    gains: Mapping[str, float] = field(default_factory=dict)
    errors: Sequence[SensorError] = ()

    @property
    def settings(self) -> dict[str, Any]:
        """Keyword arguments that describe this sensor to `Instrument`, without its errors."""
        errors = {joint: gain - 1 for joint, gain in self.gains.items()}
        return {"torque_noise": self.noise, "torque_constant_error": errors}


@dataclass(frozen=True)
class Encoders(Sensor):
    """Joint positions, (M, n) [rad or m]; perfect by default.

    Attributes:
        resolution: Size of the least count [rad or m]; 0 for continuous positions.
        noise: Standard deviation [rad or m].
        kinematics: True to measure velocities and accelerations exactly, too.
        errors: Further errors, applied in this order, such as `EncoderEccentricity()`
            (docs/instruments.md).
    """

    resolution: float = 0.0
    noise: float = 0.0
    kinematics: bool = False
    errors: Sequence[SensorError] = ()

    @property
    def settings(self) -> dict[str, Any]:
        """Keyword arguments that describe this sensor to `Instrument`, without its errors."""
        return {
            "encoder_resolution": self.resolution,
            "encoder_noise": self.noise,
            "senses_kinematics": self.kinematics,
        }


def sensors_of(instrument: Instrument) -> tuple[Sensor, ...]:
    """Encoders, joint torques and force plate described by the table [measurement].

    Args:
        instrument: The table.
    """
    signals = ("position", "torque", "wrench", "tare")
    errors = {
        s: [fault for fault in instrument.fault if fault.signal == s] for s in signals
    }
    gains = {
        joint: 1 + error for joint, error in instrument.torque_constant_error.items()
    }
    return (
        Encoders(
            instrument.encoder_resolution,
            instrument.encoder_noise,
            instrument.senses_kinematics,
            errors["position"],
        ),
        JointTorques(instrument.torque_noise, gains, errors["torque"]),
        ForcePlate(
            (instrument.force_noise, instrument.moment_noise),
            errors["wrench"] + errors["tare"],
            instrument.full_scale,
        ),
    )
