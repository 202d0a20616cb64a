"""Rerun recordings (.rrd): scalars of an entity are columns, and timelines are times.

A column is named by the path of the entity. A table contains the entities that were logged at the
same times.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from testbed.core.base.errors import UnknownName
from testbed.importing.foreign_table import (
    MAX_NUMBERS,
    ForeignTable,
    TablesByTopic,
    check_count,
    reading_errors_as_recording_errors,
)

AUTOMATIC_TIMELINES = ("log_time", "log_tick")
"""Timelines that Rerun adds: time of logging, and count of logged rows."""

SCALAR_COMPONENT = "Scalars:scalars"
"""Name of the component that is read: one or more numbers."""

Stamps = dict[str, NDArray[np.int64]]
"""Times by timeline, (M,) each."""


def tables(path: Path, topic: str | None) -> TablesByTopic:
    """Tables of entities logged at equal times, keyed by their first entity; largest first.

    Args:
        path: Path of the file.
        topic: Entity whose table is read; None for all tables.

    Raises:
        RecordingError: The file is damaged.
        UnknownName: There is no such entity.
    """
    with reading_errors_as_recording_errors(path):
        groups = _column_groups(path)
    selected = [each for each in groups if topic is None or topic in each[0]]
    if topic is not None and not selected:
        entities = [
            name for columns, units in groups for name in columns if name not in units
        ]
        raise UnknownName("entity", topic, entities)
    return {
        next(
            name for name in columns if name not in units
        ): ForeignTable.table_from_arrays(path, columns, units)
        for columns, units in selected
    }


def _column_groups(path: Path) -> list[tuple[dict[str, NDArray[Any]], dict[str, str]]]:
    """Groups of columns logged at equal times, times first, with the units of the times."""
    from rerun.chunk import RrdReader

    parts: dict[str, list[tuple[Stamps, NDArray[Any]]]] = {}
    units: dict[str, str] = {}
    count = 0
    with warnings.catch_warnings():
        # warning for files without a table of contents
        warnings.simplefilter("ignore")
        for chunk in RrdReader(path).stream().to_chunks():
            batch = chunk.to_record_batch()
            if chunk.is_static or SCALAR_COMPONENT not in batch.schema.names:
                continue
            stamps, values = _chunk_scalars(batch, units)
            parts.setdefault(chunk.entity_path.lstrip("/"), []).append((stamps, values))
            count += values.size + len(stamps) * len(values)
            check_count(path, "numbers", count, MAX_NUMBERS)
    columns_of_times: dict[tuple[Any, ...], dict[str, NDArray[Any]]] = {}
    for name, pieces in parts.items():
        stamps, values = _joined_chunks(pieces)
        if len(values) > 1 and values.size:
            times_key = tuple((line, times.tobytes()) for line, times in stamps.items())
            columns_of_times.setdefault(times_key, dict(stamps))[name] = values
    groups = sorted(columns_of_times.values(), key=len, reverse=True)
    return [(each, {n: units[n] for n in each if n in units}) for each in groups]


def _chunk_scalars(batch: Any, units: dict[str, str]) -> tuple[Stamps, NDArray[Any]]:
    """Times and values, (M, k), of a chunk; empty if rows differ in length.

    Args:
        batch: Chunk as a record batch.
        units: Units keyed by timeline; the units of the chunk are added.
    """
    lines = [
        f for f in batch.schema if (f.metadata or {}).get(b"rerun:kind") == b"index"
    ]
    lines = [line for line in lines if line.name not in AUTOMATIC_TIMELINES] or lines
    units |= {line.name: getattr(line.type, "unit", "") for line in lines}
    column = batch.column(SCALAR_COMPONENT)
    valid = column.is_valid().to_numpy(zero_copy_only=False)
    values, rows = (
        column.drop_null().flatten().to_numpy(zero_copy_only=False),
        int(valid.sum()),
    )
    widths = np.unique(np.diff(column.drop_null().offsets.to_numpy()))
    if len(widths) != 1:
        valid, rows, values = np.zeros_like(valid), 0, values[:0]
    stamps = {
        f.name: batch.column(f.name).cast(pa.int64()).to_numpy()[valid] for f in lines
    }
    return stamps, values.reshape(rows, len(values) // max(rows, 1))


def _joined_chunks(
    pieces: list[tuple[Stamps, NDArray[Any]]],
) -> tuple[Stamps, NDArray[Any]]:
    """Times and values of an entity's chunks, sorted by time.

    A chunk is omitted if its timelines or its number of values differ from those of the first
    chunk.
    """
    lines, width = [*pieces[0][0]], pieces[0][1].shape[1]
    same_layout = [(s, v) for s, v in pieces if [*s] == lines and v.shape[1] == width]
    stamps = {line: np.concatenate([s[line] for s, _ in same_layout]) for line in lines}
    order = np.argsort(stamps[lines[0]], kind="stable") if lines else slice(0)
    values = np.concatenate([v for _, v in same_layout])[order]
    return {line: each[order] for line, each in stamps.items()}, values
