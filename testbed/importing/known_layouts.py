"""Columns of loggers that many people have, by name: what names alone leave open is known of them.

To add a logger, add a table to `loggers.toml`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from testbed.importing.column_names import ColumnName
from testbed.importing.foreign_table import KINDS
from testbed.importing.vocabulary import read_table

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
    signals: Mapping[str, tuple[str, str]]
    mark: str = ".*"
    beside: str = ""
    time: Sequence[str] = ()
    unit: str | None = None
    rate: float = 0.0

    def fits(self, columns: Sequence[str]) -> bool:
        """Whether a table is of this logger."""
        wanted = (self.mark, *(pattern for pattern, _ in self.signals.values()))
        return all(any(re.fullmatch(each, name) for name in columns) for each in wanted)

    def times(self, columns: Sequence[str]) -> list[str]:
        """Columns of times, all of them or none."""
        found = [
            next((c for c in columns if re.fullmatch(t, c)), "") for t in self.time
        ]
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


def _layout(table: dict[str, Any]) -> LoggerLayout:
    """Layout of a table of `loggers.toml`, in whose patterns {K} stands for the joint."""
    signals = {
        kind: (each.replace("{K}", K), u)
        for kind, (each, u) in table["signals"].items()
    }
    beside = table.get("beside", "").replace("{K}", K)
    return LoggerLayout(**{**table, "signals": signals, "beside": beside})


LAYOUTS = tuple(map(_layout, read_table("loggers")["loggers"]))
"""In the order of trying."""


def layout_of(columns: Sequence[str]) -> LoggerLayout | None:
    """The logger that names columns like these; None if it is none of `LAYOUTS`.

    Args:
        columns: Names of a table.
    """
    return next((each for each in LAYOUTS if each.fits(columns)), None)
