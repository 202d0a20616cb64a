"""The columns of a recording: their names, their units, and what is known beside them.

A file format knows nothing of robots: it yields columns and metadata (`Table`), and the
rest of this room makes a recording of them.

Columns   time, position/JOINT, velocity/JOINT, acceleration/JOINT, torque/JOINT, wrench/Fx
          ... wrench/Mz, base/x ... base/qz; in simulated recordings truth/..., which no
          estimator reads
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from testbed.arrays import Array

AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
"""The plate's channels."""

PLATE_UNITS = ("N", "N", "N", "N m", "N m", "N m")
"""Theirs."""

JOINT_SIGNALS = ("position", "velocity", "acceleration", "torque")
"""What is measured joint by joint."""

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Of a base that moves: position [m] and quaternion of its frame on the ground."""

SIGNALS = ("time", *JOINT_SIGNALS, "wrench", "base")
"""What is measured."""

TRUE_SIGNALS = ("position", "velocity", "acceleration", "torque", "friction", "wrench")
"""What a simulation knows besides."""

UNITS = {
    "revolute": {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
    | dict.fromkeys(("torque", "friction"), "N m"),
    "prismatic": {"position": "m", "velocity": "m/s", "acceleration": "m/s^2"}
    | dict.fromkeys(("torque", "friction"), "N"),
}
"""Of what is measured at a joint, by the joint's kind."""


class Table(Protocol):
    """Columns of equal length that stay in their file, and what the file says of them."""

    @property
    def columns(self) -> Sequence[str]:
        """Names of all columns."""

    @property
    def samples(self) -> int:
        """Number of rows."""

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What the file says besides, unchecked: `tare`, `facts`."""

    def read(self, columns: Sequence[str], first: int, last: int) -> dict[str, Array]:
        """Rows `first` to `last` - 1 of some columns, (last - first,) each.

        Raises:
            RecordingError: The file is damaged there, or a column holds no numbers.
        """


def axis_unit(axis: str) -> str:
    """Of one of the plate's channels: N or N m."""
    return "N" if axis.startswith("F") else "N m"


def unit_of(column: str, kinds: Mapping[str, str]) -> str:
    """Unit of a column.

    Args:
        column: Its name.
        kinds: Of the joints, by name; a joint that is not there is taken as revolute.
    """
    if column == "time":
        return "s"
    signal, _, member = column.removeprefix("truth/").partition("/")
    if signal == "wrench":
        return axis_unit(member)
    if signal == "base":
        return "1" if member.startswith("q") else "m"
    return UNITS[kinds.get(member, "revolute")][signal]


def signal_of(column: str) -> str:
    """truth/position/elbow -> truth/position; position/elbow -> position; time -> time."""
    parts = column.split("/")
    return "/".join(parts[:2]) if parts[0] == "truth" else parts[0]


def members_of(signal: str, joints: tuple[str, ...]) -> tuple[str, ...]:
    """What a signal's columns are of: the plate's channels, a pose's numbers, or joints.

    Args:
        signal: Of `SIGNALS`, those of the truth too.
        joints: Their names.
    """
    return {"wrench": AXES, "base": POSE}.get(signal.removeprefix("truth/"), joints)


def joints_in(columns: Sequence[str]) -> tuple[str, ...]:
    """Joint names: those that have a position."""
    return tuple(c.split("/", 1)[1] for c in columns if c.startswith("position/"))
