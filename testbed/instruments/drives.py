"""What drives do to the motor torques that they report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.arrays import Array
from testbed.instruments.fault import Fault, Place, Signal
from testbed.kind_table import PerJoint, each_joint, hidden, key


@dataclass(frozen=True)
class TorqueConstantError(Fault):
    """Torques reported with wrong torque constants.

    Source    Tolerances of motors' torque constants in data sheets: 5 to 10 %.

    Attributes:
        error: Relative: 0.08 reports 8 % too much.
    """

    kind: ClassVar[str] = "torque_constant_error"
    signal: ClassVar[Signal] = "torque"
    place: ClassVar[Place] = Place.SENSOR
    error: PerJoint = key(0.05, "joints", "sign")

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Torques as they are reported, (M, n) [N m or N]."""
        del time, rng
        reported: Array = (1 + each_joint(self.error)) * signal
        return reported


@dataclass(frozen=True, eq=False)
class TorqueRipple(Fault):
    """Ripple: torque constants that change periodically with the position.

    Reported is torque (1 + amplitude sin(2 pi q / period + phase)), q the true position. A
    sliding joint has the period of its screw's lead.

    Source    [TS96]: gears of the harmonic kind wave twice a turn of their input; ratio 100,
        2 % of the torque.

    Attributes:
        amplitude: Relative.
        period: Of the wave [rad or m].
        phase: Of the wave at q = 0; drawn if left out [rad].
    """

    kind: ClassVar[str] = "torque_ripple"
    signal: ClassVar[Signal] = "torque"
    place: ClassVar[Place] = Place.SENSOR
    amplitude: PerJoint = key(0.02, "joints")
    period: PerJoint = key(np.pi / 100, "joints", positive=True)
    phase: PerJoint | None = key(None, "joints", "phase")
    position: Array | None = hidden(None)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Torques as they are reported, (M, n) [N m or N]; of a fault that is on a rig."""
        del time, rng
        if self.position is None:
            raise ValueError("torque_ripple acts where positions are known: put it on a Rig")
        turn = 2 * np.pi * self.position / each_joint(self.period) + each_joint(self.phase or 0.0)
        reported: Array = (1 + each_joint(self.amplitude) * np.sin(turn)) * signal
        return reported


@dataclass(frozen=True)
class TorqueOffset(Fault):
    """A constant error of the reported torques.

    Source    Zero error of Hall-effect current sensors in data sheets: 0.5 to 1 % of their
        range, of joints of 100 N m.

    Attributes:
        error: What is reported too much [N m or N].
    """

    kind: ClassVar[str] = "torque_offset"
    signal: ClassVar[Signal] = "torque"
    place: ClassVar[Place] = Place.NOISE
    error: PerJoint = key(1.0, "joints", "sign")

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Torques with the offset, (M, n) [N m or N]."""
        del time, rng
        shifted: Array = signal + each_joint(self.error)
        return shifted


@dataclass(frozen=True)
class TorqueNoise(Fault):
    """White noise on the reported torques, besides that of `measurement.torque_noise`.

    Source    Noise of current sensors in data sheets: 0.5 % of their range.

    Attributes:
        sigma: Standard deviation [N m or N].
    """

    kind: ClassVar[str] = "torque_noise"
    signal: ClassVar[Signal] = "torque"
    place: ClassVar[Place] = Place.NOISE
    sigma: PerJoint = key(0.5, "joints", least=0)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Torques with noise, (M, n) [N m or N]."""
        del time
        noisy: Array = signal + each_joint(self.sigma) * rng.normal(size=signal.shape)
        return noisy


FAULTS: tuple[type[Fault], ...] = (TorqueConstantError, TorqueRipple, TorqueOffset, TorqueNoise)
"""All of this device."""
