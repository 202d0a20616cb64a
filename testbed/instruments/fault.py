"""A fault: a stage that an experiment file can ask for, and the keys of its table.

A fault is one frozen dataclass: `kind`, `signal` and `place` as class variables, a field a
key with default and bounds, its formula in `apply`. What a key's value may be is checked
here for all of them.

A single number where a fault has one for every joint, axis or channel is the size; the
signs (of errors) and the phases (of waves) are then drawn from the fault's own stream. A
list gives each its own, sign included; in a table by joint name those left out have zero,
or the default where zero makes no sense, as for a period.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields, replace
from enum import IntEnum
from typing import Any, ClassVar, Literal, Self, TypeAlias

import numpy as np

from testbed.arrays import Array
from testbed.errors import SettingsError, UnknownName
from testbed.instruments.fault_keys import COUNTS, Key

Signal = Literal["position", "torque", "wrench", "tare"]
"""What a fault spoils; the tare is what the plate shows at rest without the robot."""

PerJoint: TypeAlias = float | tuple[float, ...] | Mapping[str, float]
"""One for all joints, one a joint in their order, or by name."""
PerAxis: TypeAlias = float | tuple[float, ...]
"""One for x, y and z, or three."""
PerChannel: TypeAlias = float | tuple[float, ...]
"""One for all channels of the plate, or six: Fx, Fy, Fz, Mx, My, Mz."""
Matrix: TypeAlias = tuple[tuple[float, ...], ...]

FULL_SCALE = (500.0, 500.0, 1000.0, 200.0, 200.0, 100.0)
"""Largest values that the plate's channels can show [N, N m]: a plate for loads of 100 kg."""


class Place(IntEnum):
    """Where in a chain a stage acts, whatever the order in the file."""

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


@dataclass(frozen=True, eq=False)
class Rig:
    """What faults are installed on.

    Attributes:
        names: Joint names.
        full_scale: Of the plate's channels, (6,) [N, N m].
        position: True joint positions, (M, n) [rad or m]; None before there are any.
    """

    names: tuple[str, ...]
    full_scale: tuple[float, ...] = FULL_SCALE
    position: Array | None = None


class Fault(ABC):
    """One imperfection that an experiment file can ask for."""

    kind: ClassVar[str]
    """Its name in files, and of its random stream."""
    signal: ClassVar[Signal]
    place: ClassVar[Place]

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __post_init__(self) -> None:
        for name, wanted in self.known_keys().items():
            value = getattr(self, name)
            if value is not None or _default(self, name) is not None:
                object.__setattr__(self, name, wanted.checked(value, f"{self.kind}: {name}"))

    def __eq__(self, other: object) -> bool:
        """Faults are the same if their tables are, whatever they are installed on."""
        return isinstance(other, Fault) and self.table() == other.table()

    def __hash__(self) -> int:
        return hash(self.kind)

    @abstractmethod
    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """What the fault makes of a signal.

        Args:
            signal: (M, k), in the signal's unit.
            time: (M,) [s].
            rng: The fault's own random numbers.
        """

    @classmethod
    def known_keys(cls) -> dict[str, Key]:
        """What may be said in the fault's table, besides `kind`."""
        return {f.name: f.metadata["key"] for f in fields(cls) if "key" in f.metadata}

    def table(self) -> dict[str, Any]:
        """The fault as an experiment file says it, every default written out."""
        values = {name: _plain(getattr(self, name)) for name in self.known_keys()}
        return {"kind": self.kind} | {k: v for k, v in values.items() if v is not None}

    @property
    def by_joint(self) -> dict[str, Mapping[str, float]]:
        """The values that are tables by joint name."""
        values = {name: getattr(self, name) for name in self.known_keys()}
        return {name: value for name, value in values.items() if isinstance(value, Mapping)}

    def on(self, rig: Rig) -> Self:
        """The same fault on a robot and a plate: a value a joint, in their order.

        Args:
            rig: What it is installed on.

        Raises:
            SettingsError: It speaks of a joint that is not there, or not of all.
        """
        found: dict[str, Any] = {
            f.name: getattr(rig, f.name) for f in fields(self) if f.metadata.get("rig")
        }
        for name, wanted in self.known_keys().items():
            value = getattr(self, name)
            if wanted.members == "joints":
                found[name] = self._by_joint(name, value, rig.names)
        return replace(self, **found)

    def check_rate(self, rate: float) -> None:
        """Whether the fault can be at a rate.

        Args:
            rate: Samples a second [Hz].

        Raises:
            SettingsError: It cannot.
        """
        del rate  # most can be at any

    def drawn(self, rig: Rig, rng: np.random.Generator) -> Self:
        """The same fault with the signs and phases that chance gives it.

        Args:
            rig: What it is installed on.
            rng: The fault's own random numbers, for this use.
        """
        found: dict[str, Any] = {}
        for name, wanted in self.known_keys().items():
            value, count = getattr(self, name), COUNTS.get(wanted.members, len(rig.names))
            if wanted.drawn == "sign" and isinstance(value, float):
                found[name] = tuple((value * rng.choice([-1.0, 1.0], count)).tolist())
            elif wanted.drawn == "phase" and value is None:
                found[name] = tuple(rng.uniform(0, 2 * np.pi, count).tolist())
        return replace(self, **found)

    def _by_joint(self, name: str, value: Any, names: tuple[str, ...]) -> Any:
        if isinstance(value, Mapping):
            for joint in value:
                if joint not in names:
                    raise SettingsError(f"{self.kind}: {UnknownName('joint', joint, names)}")
            wanted = self.known_keys()[name]
            other = _default(self, name) if wanted.positive else 0.0
            return tuple(value.get(joint, other) for joint in names)
        if isinstance(value, tuple) and len(value) != len(names):
            raise SettingsError(
                f"{self.kind}: {name} has {len(value)} numbers for {len(names)} joints "
                f"({', '.join(names)})"
            )
        return value


def _default(fault: Fault, name: str) -> Any:
    default = type(fault).__dataclass_fields__[name].default
    return None if default is MISSING else default


def _plain(value: Any) -> Any:
    """A value as TOML takes it."""
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return dict(value) if isinstance(value, Mapping) else value


def each_channel(force: PerAxis, moment: PerAxis) -> Array:
    """Forces' and moments' values, channel by channel, (6,) [N, N m]."""
    three = [np.broadcast_to(np.asarray(part, dtype=float), 3) for part in (force, moment)]
    return np.concatenate(three)


def each_joint(value: PerJoint) -> Array:
    """Values that multiply or add to joint columns: () or (n,)."""
    return np.asarray(value, dtype=float)
