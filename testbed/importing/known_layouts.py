"""Columns of loggers that many people have, by name: what names alone leave open is known of them.

A table; to add a logger, add a line.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from testbed.importing.column_names import ColumnName
from testbed.importing.foreign_table import KINDS, Kind

K = r"[\[_.]?\d+\]?"
"""What stands for the joint, at the end of a name."""


@dataclass(frozen=True)
class LoggerLayout:
    """Column names of one logger; each is a regular expression of a whole name.

    Attributes:
        logger: Whose they are.
        signals: Of each kind the columns and their unit.
        mark: A column by which the logger is known, too.
        beside: Columns that look like the joints' or a plate's and are neither.
        time: The column of times, or of seconds and of nanoseconds; none if a word says it.
        unit: Of the times.
        rate: Of a logger without times [Hz].
    """

    logger: str
    signals: Mapping[Kind, tuple[str, str]]
    mark: str = ".*"
    beside: str = ""
    time: tuple[str, ...] = ()
    unit: str | None = None
    rate: float = 0.0

    def fits(self, columns: Sequence[str]) -> bool:
        """Whether a table is of this logger."""
        wanted = (self.mark, *(pattern for pattern, _ in self.signals.values()))
        return all(any(re.fullmatch(each, name) for name in columns) for each in wanted)

    def times(self, columns: Sequence[str]) -> list[str]:
        """Columns of times, all of them or none."""
        found = [next((c for c in columns if re.fullmatch(t, c)), "") for t in self.time]
        return found if all(found) else []

    def read(self, columns: Sequence[ColumnName]) -> tuple[ColumnName, ...]:
        """Columns with what is known of them in place of what their names say.

        Args:
            columns: By their names.
        """
        return tuple(self._of(column) for column in columns)

    def _of(self, column: ColumnName) -> ColumnName:
        for kind, (pattern, unit) in self.signals.items():
            if re.fullmatch(pattern, column.name):
                words = (kind, re.findall(r"\d+", column.name)[-1])
                unit = column.unit or unit
                return ColumnName(column.name, "".join(words), words, unit, kind, None)
        other = column.kind in KINDS or re.fullmatch(self.beside, column.name)
        return replace(column, kind=None, role=None) if other else column


DROID = r"observation/robot_state/"
FRANKA = r"(?:(?:robot_)?state[._])?"
IIWA = r"_LBR_iiwa_\w+"
UR: Mapping[Kind, tuple[str, str]] = {
    "position": (f"actual_q{K}", "rad"),
    "velocity": (f"actual_qd{K}", "rad/s"),
}

LAYOUTS: tuple[LoggerLayout, ...] = (
    LoggerLayout(
        "libfranka",
        {
            "position": (f"{FRANKA}q{K}", "rad"),
            "velocity": (f"{FRANKA}dq{K}", "rad/s"),
            "torque": (f"{FRANKA}tau_J{K}", "N m"),
        },
        beside=f".*_F_ext_hat_K{K}",
        time=("time|duration",),
    ),
    *(
        LoggerLayout(
            "UR's RTDE", {**UR, "torque": torque}, beside=f"(?:actual_TCP_|ft_raw_|tcp_).*{K}"
        )
        for torque in ((f"actual_current_as_torque{K}", "N m"), (f"actual_current{K}", "A"))
    ),
    LoggerLayout(
        "DROID",
        {
            "position": (f"{DROID}joint_positions{K}", "rad"),
            "velocity": (f"{DROID}joint_velocities{K}", "rad/s"),
            "torque": (f"{DROID}motor_torques_measured{K}", "N m"),
        },
        beside=r"observation/camera_.*",
        time=("observation/timestamp/robot_state/read_start",),
        unit="ms",
    ),
    LoggerLayout(
        "ALOHA",
        {
            "position": (f"observations/qpos{K}", "rad"),
            "velocity": (f"observations/qvel{K}", "rad/s"),
            "torque": (f"observations/effort{K}", "mA"),
        },
        rate=50.0,
    ),
    LoggerLayout(
        "KUKA's iiwa",
        {"position": (f"axisQMsr{IIWA}{K}", "rad"), "torque": (f"axisTauMsr{IIWA}{K}", "N m")},
        time=("ZeitInSec", "ZeitInNanoSec"),
    ),
    LoggerLayout(
        "Kinova's Gen3",
        {
            "position": (r"Position\d", "rad"),
            "velocity": (r"Velocity\d", "rad/s"),
            "torque": (r"Torque\d", "N m"),
        },
        mark=r"TorqueSm\d",
    ),
)
"""In the order of trying."""


def layout_of(columns: Sequence[str]) -> LoggerLayout | None:
    """The logger that names columns like these; None if it is none of `LAYOUTS`.

    Args:
        columns: Names of a table.
    """
    return next((each for each in LAYOUTS if each.fits(columns)), None)
