"""Rerun's recordings (.rrd): scalars of an entity are columns of its path, timelines are times.

A table is all that was logged at the same times.
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
    MOST_NUMBERS,
    ForeignTable,
    Tables,
    check_count,
    readable,
)

OWN = ("log_time", "log_tick")
"""Timelines that Rerun adds: when something was logged, and how much before it."""

SCALARS = "Scalars:scalars"
"""The component that is read: numbers, one or several."""

Stamps = dict[str, NDArray[np.int64]]
"""Times by timeline, (M,) each."""


def tables(path: Path, topic: str | None) -> Tables:
    """What was logged at the same times, by an entity of it; the largest first.

    Args:
        path: The file.
        topic: An entity whose table alone is wanted; None for all.

    Raises:
        RecordingError: It is damaged.
        UnknownName: There is no such entity.
    """
    with readable(path):
        found = _tables(path)
    wanted = [each for each in found if topic is None or topic in each[0]]
    if topic is not None and not wanted:
        known = [
            name for columns, units in found for name in columns if name not in units
        ]
        raise UnknownName("entity", topic, known)
    return {
        next(name for name in columns if name not in units): ForeignTable.of(
            path, columns, units
        )
        for columns, units in wanted
    }


def _tables(path: Path) -> list[tuple[dict[str, NDArray[Any]], dict[str, str]]]:
    """Columns of what was logged at the same times, times first, and the times' units."""
    from rerun.chunk import RrdReader

    parts: dict[str, list[tuple[Stamps, NDArray[Any]]]] = {}
    units: dict[str, str] = {}
    count = 0
    with warnings.catch_warnings():
        # of files without a table of contents, which are read
        warnings.simplefilter("ignore")
        for chunk in RrdReader(path).stream().to_chunks():
            batch = chunk.to_record_batch()
            if chunk.is_static or SCALARS not in batch.schema.names:
                continue
            stamps, values = _scalars(batch, units)
            parts.setdefault(chunk.entity_path.lstrip("/"), []).append((stamps, values))
            count += values.size + len(stamps) * len(values)
            check_count(path, "numbers", count, MOST_NUMBERS)
    alike: dict[tuple[Any, ...], dict[str, NDArray[Any]]] = {}
    for name, pieces in parts.items():
        stamps, values = _joined(pieces)
        if len(values) > 1 and values.size:
            same = tuple((line, times.tobytes()) for line, times in stamps.items())
            alike.setdefault(same, dict(stamps))[name] = values
    found = sorted(alike.values(), key=len, reverse=True)
    return [(each, {n: units[n] for n in each if n in units}) for each in found]


def _scalars(batch: Any, units: dict[str, str]) -> tuple[Stamps, NDArray[Any]]:
    """Times and values, (M, k), of a chunk; none where rows differ in length."""
    lines = [
        f for f in batch.schema if (f.metadata or {}).get(b"rerun:kind") == b"index"
    ]
    lines = [line for line in lines if line.name not in OWN] or lines
    units |= {line.name: getattr(line.type, "unit", "") for line in lines}
    column = batch.column(SCALARS)
    sent = column.is_valid().to_numpy(zero_copy_only=False)
    values, rows = (
        column.drop_null().flatten().to_numpy(zero_copy_only=False),
        int(sent.sum()),
    )
    widths = np.unique(np.diff(column.drop_null().offsets.to_numpy()))
    if len(widths) != 1:
        sent, rows, values = np.zeros_like(sent), 0, values[:0]
    stamps = {
        f.name: batch.column(f.name).cast(pa.int64()).to_numpy()[sent] for f in lines
    }
    return stamps, values.reshape(rows, len(values) // max(rows, 1))


def _joined(pieces: list[tuple[Stamps, NDArray[Any]]]) -> tuple[Stamps, NDArray[Any]]:
    """Chunks in one, in the order of their times; those on other timelines are left out."""
    lines, width = [*pieces[0][0]], pieces[0][1].shape[1]
    alike = [(s, v) for s, v in pieces if [*s] == lines and v.shape[1] == width]
    stamps = {line: np.concatenate([s[line] for s, _ in alike]) for line in lines}
    order = np.argsort(stamps[lines[0]], kind="stable") if lines else slice(0)
    values = np.concatenate([v for _, v in alike])[order]
    return {line: each[order] for line, each in stamps.items()}, values
