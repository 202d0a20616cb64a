"""Column layouts of known loggers: signals and units that the names alone do not state.

To add a logger, add a table to `loggers.toml`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from testbed.importing.column_names import ColumnName
from testbed.importing.foreign_table import JOINT_QUANTITIES
from testbed.importing.vocabulary import read_table

JOINT_NUMBER = r"[\[_.]?\d+\]?"
"""Regular expression of the joint's number at the end of a column name."""


@dataclass(frozen=True)
class LoggerLayout:
    """Column names of one logger; each is a regular expression of a whole name.

    Attributes:
        logger: Name of the logger.
        signals: Columns and unit by signal.
        mark: Another column by which the logger is recognised.
        beside: Columns that seem to belong to joints or a plate but do not.
        time: Column of times, or columns of seconds and nanoseconds; empty if names decide.
        unit: Unit of the times.
        rate: Sampling rate of a logger without times [Hz].
    """

    logger: str
    signals: Mapping[str, tuple[str, str]]
    mark: str = ".*"
    beside: str = ""
    time: Sequence[str] = ()
    unit: str | None = None
    rate: float = 0.0

    def matches_columns(self, columns: Sequence[str]) -> bool:
        """Test whether a table has the columns of this logger.

        Args:
            columns: Column names of the table.
        """
        patterns = (self.mark, *(pattern for pattern, _ in self.signals.values()))
        return all(
            any(re.fullmatch(each, name) for name in columns) for each in patterns
        )

    def time_columns(self, columns: Sequence[str]) -> list[str]:
        """Columns of times in a table; empty unless all are there.

        Args:
            columns: Column names of the table.
        """
        names = [
            next((c for c in columns if re.fullmatch(t, c)), "") for t in self.time
        ]
        return names if all(names) else []

    def interpret_columns(
        self, columns: Sequence[ColumnName]
    ) -> tuple[ColumnName, ...]:
        """Columns with the signals and units of this logger.

        Args:
            columns: Columns with the signals and units that their names state.
        """
        return tuple(self._interpreted_column(column) for column in columns)

    def _interpreted_column(self, column: ColumnName) -> ColumnName:
        """Column with the signal and unit of this logger; without a signal if irrelevant."""
        for kind, (pattern, unit) in self.signals.items():
            if re.fullmatch(pattern, column.name):
                words = (kind, re.findall(r"\d+", column.name)[-1])
                unit = column.unit or unit
                return ColumnName(column.name, "".join(words), words, unit, kind, None)
        irrelevant = column.kind in JOINT_QUANTITIES or re.fullmatch(
            self.beside, column.name
        )
        return (
            replace(column, kind=None, wrench_component=None) if irrelevant else column
        )


def _layout(table: dict[str, Any]) -> LoggerLayout:
    """Layout from a table of `loggers.toml`; {K} in its patterns stands for the joint's number."""
    signals = {
        kind: (pattern.replace("{K}", JOINT_NUMBER), unit)
        for kind, (pattern, unit) in table["signals"].items()
    }
    beside = table.get("beside", "").replace("{K}", JOINT_NUMBER)
    return LoggerLayout(**{**table, "signals": signals, "beside": beside})


LAYOUTS = tuple(map(_layout, read_table("loggers")["loggers"]))
"""Layouts of known loggers in the order of trying."""


def layout_of_logger(columns: Sequence[str]) -> LoggerLayout | None:
    """Layout of the logger that names columns in this way; None if unknown.

    Args:
        columns: Column names of a table.
    """
    return next((each for each in LAYOUTS if each.matches_columns(columns)), None)
