"""A fault: a stage of an instrument that an experiment file can ask for.

What happens to a signal on its way from the truth to the recording is a chain of faults, in order.
A fault is one frozen dataclass: `kind`, `signal` and `place` as class variables, a field a key with
default and bounds, its formula in `apply`, in the module of the device that has it.

A single number where a fault has one for every joint, axis or channel is the size; the
signs (of errors) and the phases (of waves) are then drawn from the fault's own stream. A
list gives each its own, sign included; in a table by joint name those left out have zero,
or the default where zero makes no sense, as for a period.

Random numbers come from a stream of the kind and the seed, so that adding, removing or changing a
fault leaves the noise of all others as it was, to the bit. Several of one kind in a chain have a
stream each, numbered in their order: one more goes last.
"""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from enum import IntEnum
from typing import Any, ClassVar, Literal, Self, TypeAlias

import numpy as np

from testbed.core.base.arrays import Array
from testbed.lab.kind_table import COUNTS, KindTable, PerJoint, each_joint

Signal = Literal["position", "torque", "wrench", "tare"]
"""What a fault spoils; the tare is what the plate shows at rest without the robot."""

PerAxis: TypeAlias = float | tuple[float, ...]
"""One for x, y and z, or three."""
PerChannel: TypeAlias = float | tuple[float, ...]
"""One for all channels of the plate, or six: Fx, Fy, Fz, Mx, My, Mz."""
Matrix: TypeAlias = tuple[tuple[float, ...], ...]

_FIRST_STREAMS = {"encoder_noise": 0, "torque_noise": 1, "plate_noise": 2}
"""Streams of the kinds that were there before kinds had names; their noise stays the same."""

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


class Fault(KindTable):
    """One imperfection that an experiment file can ask for."""

    signal: ClassVar[Signal]
    place: ClassVar[StageOrder]

    @abstractmethod
    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """What the fault makes of a signal.

        Args:
            signal: (M, k), in the signal's unit.
            time: (M,) [s].
            rng: The fault's own random numbers.
        """

    def on(self, names: tuple[str, ...], full_scale: tuple[float, ...] = FULL_SCALE) -> Self:
        """The same fault on a robot and a plate: a value a joint, in their order.

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
        """Whether the fault can be at a rate.

        Args:
            rate: Samples a second [Hz].

        Raises:
            SettingsError: It cannot.
        """
        del rate  # most can be at any

    def sample(self, joints: int, rng: np.random.Generator) -> Self:
        """The same fault with the signs and phases that chance gives it.

        Args:
            joints: Number of joints.
            rng: The fault's own random numbers, for this use.
        """
        found: dict[str, Any] = {}
        for name, wanted in self.known_keys().items():
            value, count = getattr(self, name), COUNTS.get(wanted.members, joints)
            if wanted.sample == "sign" and isinstance(value, float):
                found[name] = tuple((value * rng.choice([-1.0, 1.0], count)).tolist())
            elif wanted.sample == "phase" and value is None:
                found[name] = tuple(rng.uniform(0, 2 * np.pi, count).tolist())
        return replace(self, **found)


class GainFault(Fault):
    """Signal on a wrong scale, by a relative `error` of each joint or channel."""

    error: PerJoint

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Signal times one plus the error, (M, k)."""
        del time, rng
        return (1 + each_joint(self.error)) * signal


class EncoderFault(Fault):
    """Fault of joint positions, (M, n) [rad or m]."""

    signal: ClassVar[Signal] = "position"


class TorqueFault(Fault):
    """Fault of reported joint torques, (M, n) [N m or N]."""

    signal: ClassVar[Signal] = "torque"


class PlateFault(Fault):
    """Fault of a plate's wrench, (M, 6) [N, N m]."""

    signal: ClassVar[Signal] = "wrench"


def stream(kind: str, seed: int, number: int = 0, use: str = "") -> np.random.Generator:
    """Random numbers of a fault.

    Args:
        kind: Of the fault.
        seed: Of the recording.
        number: Of the fault among those of its kind in its chain.
        use: What the numbers are for; by default the noise of a recording.
    """

    def code(word: str) -> int:
        return int.from_bytes(hashlib.sha256(word.encode()).digest()[:4], "big")

    key = [_FIRST_STREAMS.get(kind, code(kind))]
    if number or use:
        key += [number, code(use)]
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))


def number_kinds(chain: Iterable[Fault]) -> Iterator[tuple[Fault, int]]:
    """Faults, each with its number among those of its kind."""
    seen: Counter[str] = Counter()
    for fault in chain:
        yield fault, seen[fault.kind]
        seen[fault.kind] += 1


def apply_chain(
    chain: Iterable[Fault], signal: Array, time: Array, seed: int, use: str = ""
) -> Array:
    """A signal through a chain of faults, in their order.

    Args:
        chain: What the instrument does to it.
        signal: (M, k).
        time: (M,) [s].
        seed: Of the recording.
        use: What is measured, where it is not a recording's signal: it has noise of its own.
    """
    for fault, number in number_kinds(chain):
        signal = fault.apply(signal, time, stream(fault.kind, seed, number, use))
    return signal
