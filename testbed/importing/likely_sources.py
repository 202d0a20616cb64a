"""Tables of foreign files with parsed column names and likely clocks."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed.core.base.arrays import Array
from testbed.importing.column_names import (
    ColumnGroup,
    ColumnName,
    is_signal_word,
    parse_column_name,
)
from testbed.importing.foreign_table import JOINT_QUANTITIES, ForeignTable
from testbed.importing.known_layouts import layout_of_logger
from testbed.importing.likely_clock import LikelyClock, find_clock
from testbed.importing.readers import read_tables


@dataclass(frozen=True, eq=False)
class LikelySource:
    """Table of a foreign file, with likely signals and clock.

    Attributes:
        name: Name of the source in the mapping.
        file: Path of the file.
        topic: Topic in a bag; None for other files.
        table: Columns of the file.
        columns: Parsed column names without the time column.
        clock: Likely clock.
        logger: Name of the logger if its column layout is known; otherwise empty.
    """

    name: str
    file: Path
    topic: str | None
    table: ForeignTable
    columns: tuple[ColumnName, ...]
    clock: LikelyClock
    logger: str = ""

    def group_values(self, group: ColumnGroup) -> Array:
        """Values of a group's columns in the units of the file, (M, n).

        Args:
            group: Columns of the table.
        """
        return self.table.matrix([each.name for each in group.columns])


def find_sources(paths: Sequence[Path]) -> list[LikelySource]:
    """Tables of foreign files, with likely clocks and with signals according to column names.

    Args:
        paths: Files; in a bag, each topic that contains numbers is a separate table.

    Raises:
        RecordingError: A file cannot be read.
        UnknownName: A file has an unknown extension.
    """
    sources: list[LikelySource] = []
    stems: list[str] = []
    for path in paths:
        stem = (
            re.sub(r"\W+", "_", path.name.partition(".")[0], flags=re.ASCII).strip("_")
            or "log"
        )
        name = f"{stem}_{len(stems)}" if stem in stems else stem
        stems.append(stem)
        sources += _file_sources(path, name if len(paths) > 1 else "")
    return [_with_signal_of_file_name(each) for each in sources]


def _with_signal_of_file_name(source: LikelySource) -> LikelySource:
    """Source whose columns get the signal that the file name states, for example torque.csv.

    The source is unchanged if any column name states a signal. Columns with a unit or wrench
    component are unchanged.
    """
    kind = parse_column_name(source.file.name.partition(".")[0]).kind
    has_signals = any(
        is_signal_word(word) for column in source.columns for word in column.words
    )
    if kind not in JOINT_QUANTITIES or has_signals:
        return source
    columns = (
        replace(each, kind=kind)
        if each.unit is None and each.wrench_component is None
        else each
        for each in source.columns
    )
    return replace(source, columns=tuple(columns))


def _file_sources(path: Path, name: str) -> Iterator[LikelySource]:
    """Yield sources of a file: a separate table for each topic and number of samples.

    Unreadable topics are omitted; if all topics are unreadable, the first error is raised.
    """
    entries = read_tables(path)
    readable_tables = {
        topic: each for topic, each in entries.items() if isinstance(each, ForeignTable)
    }
    for error in entries.values():
        if not readable_tables and isinstance(error, Exception):
            raise error
    for number, (topic, table) in enumerate(readable_tables.items()):
        prefix = f"{name}_topic{number}".strip("_") if topic else name or "log"
        counts = dict.fromkeys(map(max, table.shapes.values()))
        for k, count in enumerate(counts):  # columns with other sampling times
            shapes = {each: s for each, s in table.shapes.items() if max(s) == count}
            part = replace(table, shapes=shapes)
            yield _likely_source(
                f"{prefix}_{k + 1}" if k else prefix, path, topic or None, part
            )


def _likely_source(
    name: str, path: Path, topic: str | None, table: ForeignTable
) -> LikelySource:
    """Source of a table, with the likely clock and parsed names of other columns.

    A column whose name states a signal is omitted if it contains no finite number.
    """
    layout = layout_of_logger(table.columns)
    clock = find_clock(table, layout)
    names = [each for each in table.columns if each != clock.column]
    columns = tuple(parse_column_name(each, table.unit(each)) for each in names)
    columns = layout.interpret_columns(columns) if layout else columns
    numeric_columns = [
        c
        for c in columns
        if not c.kind or np.isfinite(table.column_values([c.name])[c.name]).any()
    ]
    logger = layout.logger if layout else ""
    return LikelySource(name, path, topic, table, tuple(numeric_columns), clock, logger)
