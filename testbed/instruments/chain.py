"""The whole instrument: encoders, drives and plate, each a chain of stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np

from testbed.arrays import Array
from testbed.errors import SettingsError
from testbed.instruments.drives import TorqueConstantError, TorqueNoise
from testbed.instruments.encoders import EncoderNoise, EncoderResolution
from testbed.instruments.plate import PlateNoise
from testbed.instruments.stage import Stage, applied
from testbed.recordings.recording import Recording, Truth

Signal = Literal["position", "torque", "wrench"]
_PLATE = ("force_noise", "moment_noise")


@dataclass(frozen=True)
class Instrument:
    """How samples are taken and how well; by default perfectly. The table [measurement].

    Attributes:
        rate: Samples a second; also the controller's rate [Hz].
        averaged: Each sample is the mean over its steps, else its first instant.
        senses_kinematics: Velocities and accelerations are sensed exactly.
        encoder_resolution: Least count of the encoders; 0 for none [rad or m].
        encoder_noise: Standard deviation of position noise [rad or m].
        torque_noise: Standard deviation of the reported motor torque [N m or N].
        torque_constant_error: Relative error of the drives' torque constants by joint
            name: 0.08 reports 8 % too much.
        force_noise: Standard deviation of the plate's forces [N].
        moment_noise: Standard deviation of the plate's moments [N m].
    """

    rate: float = 1000.0
    averaged: bool = True
    senses_kinematics: bool = False
    encoder_resolution: float = 0.0
    encoder_noise: float = 0.0
    torque_noise: float = 0.0
    torque_constant_error: Mapping[str, float] = field(default_factory=dict)
    force_noise: float = 0.0
    moment_noise: float = 0.0

    __pydantic_config__: ClassVar = {"extra": "forbid", "strict": True, "allow_inf_nan": False}

    def __post_init__(self) -> None:
        if not 0 < self.rate < np.inf:
            raise SettingsError(f"rate is a positive frequency [Hz], found {self.rate}")
        for name in ("encoder_resolution", "encoder_noise", "torque_noise", *_PLATE):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise SettingsError(f"{name} cannot be negative or infinite, found {value}")
        for joint, error in self.torque_constant_error.items():
            if not np.isfinite(error):
                raise SettingsError(f"torque_constant_error of '{joint}' is no number: {error}")

    @property
    def plate_noise(self) -> Array:
        """Standard deviation of the plate's channels, (6,) [N, N m]."""
        return np.repeat([self.force_noise, self.moment_noise], 3)

    def stages(self, names: tuple[str, ...]) -> dict[Signal, tuple[Stage, ...]]:
        """What happens to each signal, in order.

        Args:
            names: Joint names.
        """
        encoders: list[Stage] = [EncoderNoise(self.encoder_noise)]
        if self.encoder_resolution:
            encoders.append(EncoderResolution(self.encoder_resolution))
        errors = tuple(self.torque_constant_error.get(name, 0.0) for name in names)
        return {
            "position": tuple(encoders),
            "torque": (TorqueConstantError(errors), TorqueNoise(self.torque_noise)),
            "wrench": (PlateNoise(self.force_noise, self.moment_noise),),
        }


def measure(
    instrument: Instrument,
    names: tuple[str, ...],
    time: Array,
    truth: Truth,
    tare: Array,
    facts: Mapping[str, Any],
    seed: int,
) -> Recording:
    """What the instrument shows of what happened.

    Args:
        instrument: The instrument.
        names: Joint names.
        time: (M,) [s].
        truth: What happens.
        tare: Known static wrench of the pedestal, (6,) [N, N m].
        facts: Kept with the recording.
        seed: Of the noise.
    """
    senses = instrument.senses_kinematics
    exact = Recording(
        names=names,
        time=time,
        position=truth.position,
        torque=truth.torque,
        wrench=truth.wrench,
        velocity=truth.velocity if senses else None,
        acceleration=truth.acceleration if senses else None,
        tare=tare,
        truth=truth,
        facts=facts,
    )
    seen: dict[str, Any] = {
        signal: applied(stages, exact.measured(signal), time, seed)
        for signal, stages in instrument.stages(names).items()
    }
    return replace(exact, **seen)
