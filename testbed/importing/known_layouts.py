"""Column layouts of known loggers: signals and units that column names alone do not state.

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
    """Column names of a known logger, as regular expressions of whole names.

    Attributes:
        logger: Name of the logger.
        signals: Regular expression for the joints' columns, and their unit, keyed by signal.
        mark: Regular expression for another column that identifies the logger.
        beside: Regular expression for columns whose names resemble a signal of joints or plate, but
            which hold other quantities.
        time: Regular expression for the time column, or for the columns of seconds and of
            nanoseconds; empty if the time column is chosen by its name.
        unit: Unit of the times.
        rate: Sampling rate of a logger that records no times [Hz].
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

        The expressions of `mark` and of all signals must match at least one column each.

        Args:
            columns: Column names of the table.
        """
        patterns = (self.mark, *(pattern for pattern, _ in self.signals.values()))
        return all(
            any(re.fullmatch(each, name) for name in columns) for each in patterns
        )

    def time_columns(self, columns: Sequence[str]) -> list[str]:
        """Columns of a table that match the expressions of `time`.

        The list is empty unless every expression matches a column.

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
        """Column with the signal and unit that this logger assigns to the column's name.

        Any other column loses its signal if that is a joint quantity, or if `beside` matches the
        name.
        """
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
    """Layout from a table of `loggers.toml`; {K} in a pattern stands for the joint's number."""
    signals = {
        kind: (pattern.replace("{K}", JOINT_NUMBER), unit)
        for kind, (pattern, unit) in table["signals"].items()
    }
    beside = table.get("beside", "").replace("{K}", JOINT_NUMBER)
    return LoggerLayout(**{**table, "signals": signals, "beside": beside})


LAYOUTS = tuple(map(_layout, read_table("loggers")["loggers"]))
"""Layouts of known loggers in the order of trying."""


def layout_of_logger(columns: Sequence[str]) -> LoggerLayout | None:
    """First layout of `LAYOUTS` that matches a table's columns; None if no layout matches.

    Args:
        columns: Column names of a table.
    """
    return next((each for each in LAYOUTS if each.matches_columns(columns)), None)
