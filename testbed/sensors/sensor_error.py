"""Base classes of sensor errors: stages of the measuring chain from true signals to recording.

A sensor error is a frozen dataclass in a module of `testbed/sensors/errors`. It has the class
variables `kind`, `signal` and `stage`, one field with default and bounds per key, and its formula
in `apply`. An error with coefficients that can be estimated and corrected is a `SystematicError`.

For a key with one number per joint, axis or channel, a single number is a magnitude: signs of
errors and phases of waves are drawn from the random stream of the error. A list gives all values
with their signs. In a table keyed by joint name, omitted joints have zero, or the default value if
zero is not allowed, as for a period.

The random stream depends on the kind and the seed, so that adding, removing or changing one error
leaves the noise of the other errors exactly the same. Several errors of one kind in a chain have
separate streams, numbered in their order; a new error should therefore be added last.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from enum import IntEnum
from typing import Any, ClassVar, Literal, Self

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import (
    MEMBER_COUNTS,
    KindTable,
    PerAxis,
    PerJoint,
    joint_array,
)

Signal = Literal["position", "torque", "wrench", "tare"]
"""Signals that can have errors; the tare is the wrench of the plate at rest without robot."""

FULL_SCALE = (500.0, 500.0, 1000.0, 200.0, 200.0, 100.0)
"""Full scale of the plate's channels [N, N m], for a plate with a load capacity of 100 kg."""


class StageOrder(IntEnum):
    """Order of the stages in a measuring chain, independent of the order in files."""

    SENSOR = 0
    """Mechanics, calibration and amplifiers: linear, before any noise."""
    FILTER = 1
    CLOCK = 2
    NOISE = 3
    """Added noise and offsets."""
    RANGE = 4
    """Saturation."""
    CONVERTER = 5
    """Quantisation to whole counts."""
    LINE = 6
    """Transmission of the samples to the file."""


class SensorError(KindTable):
    """Base class of sensor errors."""

    signal: ClassVar[Signal]
    stage: ClassVar[StageOrder]

    @abstractmethod
    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Apply the error to a signal.

        Args:
            signal: Signal before the error, (M, k), in the signal's unit.
            time: Times of the samples, (M,) [s].
            rng: Random stream of the error.
        """

    def for_robot(
        self, names: tuple[str, ...], full_scale: tuple[float, ...] = FULL_SCALE
    ) -> Self:
        """Copy of the error for a robot and plate, with per-joint values in order.

        Args:
            names: Joint names.
            full_scale: Full scale of each channel of the plate, (6,) [N, N m].

        Raises:
            SettingsError: A joint is unknown, or values of some joints are missing.
        """
        changes: dict[str, Any] = self.joint_values(names)
        if hasattr(self, "full_scale"):
            changes["full_scale"] = full_scale
        return replace(self, **changes)

    def check_rate(self, rate: float) -> None:
        """Check that the error can be simulated at a sampling rate.

        Args:
            rate: Sampling rate [Hz].

        Raises:
            SettingsError: The error cannot be simulated at this rate.
        """
        del rate  # no limit for most errors

    def with_random_values(self, joints: int, rng: np.random.Generator) -> Self:
        """Copy of the error with random signs and phases where only a magnitude is given.

        For keys with a random sign, a single number becomes a list of numbers with random signs.
        For keys with a random phase, an omitted value becomes a list of phases between 0 and 2 pi.

        Args:
            joints: Number of joints.
            rng: Random stream of the error for this draw.
        """
        changes: dict[str, Any] = {}
        for name, key in self.known_keys().items():
            value, count = getattr(self, name), MEMBER_COUNTS.get(key.members, joints)
            if key.sample == "sign" and isinstance(value, float):
                changes[name] = tuple((value * rng.choice([-1.0, 1.0], count)).tolist())
            elif key.sample == "phase" and value is None:
                changes[name] = tuple(rng.uniform(0, 2 * np.pi, count).tolist())
        return replace(self, **changes)


class NoiseError(SensorError):
    """White noise with one standard deviation `sigma` per joint."""

    stage: ClassVar[StageOrder] = StageOrder.NOISE
    sigma: PerJoint

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Signal with white noise added, (M, n)."""
        del time
        return signal + joint_array(self.sigma) * rng.normal(size=signal.shape)


class AddedWrench(SensorError):
    """Random or periodic error of the plate's channels: amplitudes times a time pattern."""

    signal: ClassVar[Signal] = "wrench"
    stage: ClassVar[StageOrder] = StageOrder.NOISE
    force: PerAxis
    moment: PerAxis

    @abstractmethod
    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Time pattern of the error with unit amplitude in each channel, (M, 6) or (M, 1).

        Args:
            signal: Wrench before the error, (M, 6) [N, N m].
            time: Times of the samples, (M,) [s].
            rng: Random stream of the error.
        """

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Wrench with the error, (M, 6) [N, N m]."""
        return signal + channel_values(self.force, self.moment) * self.pattern(
            signal, time, rng
        )


def channel_values(force: PerAxis, moment: PerAxis) -> Array:
    """Values of the plate's six channels, (6,), from values for forces and moments.

    Args:
        force: One number for x, y and z, or three numbers.
        moment: One number for x, y and z, or three numbers.
    """
    return np.concatenate(
        [np.broadcast_to(np.asarray(each), 3) for each in (force, moment)]
    )


def sampling_time(time: Array) -> float:
    """Time between two samples [s].

    Args:
        time: Uniform times of the samples, (M,) [s].
    """
    return float((time[-1] - time[0]) / (len(time) - 1))
