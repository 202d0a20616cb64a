"""Sensor error: a stage of the measuring chain between the truth and the recording.

One error is one frozen dataclass in a module of `testbed/sensors/errors`: `kind`, `signal` and
`stage` as class variables, a field for each key with default and bounds, its formula in `apply`.
An error with coefficients, which can be estimated and taken back, is a `SystematicError`.

A single number where an error has one for every joint, axis or channel is a size; signs (of errors)
and phases (of waves) are then drawn from the error's own stream. A list gives each its own value,
sign included; in a table by joint name those left out have zero, or the default where zero makes no
sense, as for a period.

Random numbers come from a stream of the kind and the seed, so that adding, removing or changing one
error leaves the noise of all others as it was, to the bit. Several of one kind in a chain have a
stream each, numbered in their order: one more goes last.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from enum import IntEnum
from typing import Any, ClassVar, Literal, Self

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import COUNTS, KindTable, PerAxis, PerJoint, each_joint

Signal = Literal["position", "torque", "wrench", "tare"]
"""Signals that have errors; the tare is the wrench of the plate at rest without the robot."""

FULL_SCALE = (500.0, 500.0, 1000.0, 200.0, 200.0, 100.0)
"""Largest values that the plate's channels can show [N, N m]: a plate for loads of 100 kg."""


class StageOrder(IntEnum):
    """Order of the stages of a measuring chain, whatever the order in the file."""

    SENSOR = 0
    """Mechanics, calibration and amplifiers: linear, before any noise."""
    FILTER = 1
    CLOCK = 2
    NOISE = 3
    """Whatever is added."""
    RANGE = 4
    """Signals that grow no further."""
    CONVERTER = 5
    """Signals in whole counts."""
    LINE = 6
    """Samples on their way to the file."""


class SensorError(KindTable):
    """Imperfection of a sensor, one value of its kind."""

    signal: ClassVar[Signal]
    stage: ClassVar[StageOrder]

    @abstractmethod
    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Signal with the error.

        Args:
            signal: (M, k), in the signal's unit.
            time: (M,) [s].
            rng: The error's own random numbers.
        """

    def on(
        self, names: tuple[str, ...], full_scale: tuple[float, ...] = FULL_SCALE
    ) -> Self:
        """Copy of the error for a robot and a plate: a value a joint, in their order.

        Args:
            names: Joint names.
            full_scale: Of the plate's channels, (6,) [N, N m].

        Raises:
            SettingsError: It names a joint that is not there, or not of all.
        """
        found: dict[str, Any] = self.of_joints(names)
        if hasattr(self, "full_scale"):
            found["full_scale"] = full_scale
        return replace(self, **found)

    def check_rate(self, rate: float) -> None:
        """Check that the error can be simulated at a rate.

        Args:
            rate: Samples a second [Hz].

        Raises:
            SettingsError: It cannot.
        """
        del rate  # most can be at any

    def sample(self, joints: int, rng: np.random.Generator) -> Self:
        """Copy of the error with random signs and phases where a size alone is given.

        Args:
            joints: Number of joints.
            rng: The error's own random numbers, for this use.
        """
        found: dict[str, Any] = {}
        for name, wanted in self.known_keys().items():
            value, count = getattr(self, name), COUNTS.get(wanted.members, joints)
            if wanted.sample == "sign" and isinstance(value, float):
                found[name] = tuple((value * rng.choice([-1.0, 1.0], count)).tolist())
            elif wanted.sample == "phase" and value is None:
                found[name] = tuple(rng.uniform(0, 2 * np.pi, count).tolist())
        return replace(self, **found)


class NoiseError(SensorError):
    """White noise of standard deviation `sigma`, joint by joint."""

    stage: ClassVar[StageOrder] = StageOrder.NOISE
    sigma: PerJoint

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Signal with noise, (M, n)."""
        del time
        return signal + each_joint(self.sigma) * rng.normal(size=signal.shape)


class AddedWrench(SensorError):
    """Random or periodic error of the plate's channels: their sizes times a pattern over time."""

    signal: ClassVar[Signal] = "wrench"
    stage: ClassVar[StageOrder] = StageOrder.NOISE
    force: PerAxis
    moment: PerAxis

    @abstractmethod
    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Error of channels of size one, (M, 6) or (M, 1).

        Args:
            signal: Wrench before the error, (M, 6) [N, N m].
            time: (M,) [s].
            rng: The error's own random numbers.
        """

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Wrench with the error, (M, 6) [N, N m]."""
        return signal + channels(self.force, self.moment) * self.pattern(
            signal, time, rng
        )


def channels(force: PerAxis, moment: PerAxis) -> Array:
    """Values of the plate's channels, (6,), of those of forces and of moments.

    Args:
        force: One for x, y and z, or three.
        moment: Likewise.
    """
    return np.concatenate(
        [np.broadcast_to(np.asarray(each), 3) for each in (force, moment)]
    )


def sampling_time(time: Array) -> float:
    """Time between two samples [s].

    Args:
        time: Uniform, (M,) [s].
    """
    return float((time[-1] - time[0]) / (len(time) - 1))
