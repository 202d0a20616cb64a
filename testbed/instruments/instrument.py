"""The instrument: encoders, drives and plate, each with its imperfections, seeded.

Every channel draws from a stream of its own, so that switching one imperfection off
leaves the noise of the others as it was.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.recordings.recording import Recording, Truth


@dataclass(frozen=True)
class Instrument:
    """How well things are measured; by default perfectly.

    Attributes:
        encoder_resolution: Least count of the encoders; 0 for none [rad or m].
        encoder_noise: Standard deviation of position noise [rad or m].
        torque_noise: Standard deviation of the reported motor torque [N m or N].
        torque_constant_error: Relative error of the drives' torque constants by joint
            name: 0.08 reports 8 % too much.
        force_noise: Standard deviation of the plate's forces [N].
        moment_noise: Standard deviation of the plate's moments [N m].
        senses_kinematics: Whether velocities and accelerations are sensed, exactly.
    """

    encoder_resolution: float = 0.0
    encoder_noise: float = 0.0
    torque_noise: float = 0.0
    torque_constant_error: Mapping[str, float] = field(default_factory=dict)
    force_noise: float = 0.0
    moment_noise: float = 0.0
    senses_kinematics: bool = False

    @property
    def plate_noise(self) -> Array:
        """Standard deviation of the plate's channels, (6,) [N, N m]."""
        return np.repeat([self.force_noise, self.moment_noise], 3)


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
    streams = np.random.SeedSequence(seed).spawn(3)
    encoders, drives, plate = (np.random.default_rng(stream) for stream in streams)
    position = truth.position + instrument.encoder_noise * encoders.normal(
        size=truth.position.shape
    )
    if instrument.encoder_resolution:
        count = instrument.encoder_resolution
        position = count * np.round(position / count)
    gain = np.array([1 + instrument.torque_constant_error.get(name, 0.0) for name in names])
    noise = instrument.torque_noise * drives.normal(size=truth.torque.shape)
    senses = instrument.senses_kinematics
    return Recording(
        names=names,
        time=time,
        position=position,
        torque=gain * truth.torque + noise,
        wrench=truth.wrench + instrument.plate_noise * plate.normal(size=truth.wrench.shape),
        velocity=truth.velocity if senses else None,
        acceleration=truth.acceleration if senses else None,
        tare=tare,
        truth=truth,
        facts=facts,
    )
