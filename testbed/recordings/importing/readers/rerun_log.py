"""Rerun's recordings (.rrd): numbers of an entity are columns of its path, timelines are times.

A table is all that was logged at the same times.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from testbed.errors import RecordingError, UnknownName
from testbed.recordings.importing.foreign_table import MOST_NUMBERS, ForeignTable, Tables, readable

OWN = ("log_time", "log_tick")
"""Timelines that Rerun adds: when it was told, and how many times before."""

SCALARS = "Scalars:scalars"
"""The component that is a number; it is named by its entity alone."""

Stamps = dict[str, NDArray[np.int64]]
"""Times by timeline, (M,) each."""


def read_file(path: Path, topic: str | None) -> ForeignTable:
    """Columns of an entity, and of all that was logged at the same times.

    Args:
        path: The file.
        topic: Path of the entity.

    Raises:
        RecordingError: The file is damaged.
        UnknownName: There is no such entity.
    """
    with readable(path):
        found = _tables(path)
    for columns, units in found:
        if topic in columns:
            return _table(path, columns, units)
    known = [name for columns, units in found for name in columns if name not in units]
    raise UnknownName("entity", str(topic), known)


def tables(path: Path) -> Tables:
    """What was logged at the same times, by an entity of it; the largest first.

    Args:
        path: The file.

    Raises:
        RecordingError: It is damaged.
    """
    with readable(path):
        found = _tables(path)
    return {
        next(name for name in columns if name not in units): _table(path, columns, units)
        for columns, units in found
    }


def _table(path: Path, columns: dict[str, NDArray[Any]], units: dict[str, str]) -> ForeignTable:
    shapes = {name: values.shape for name, values in columns.items()}
    return ForeignTable(path, shapes, columns.__getitem__, units)


def _tables(path: Path) -> list[tuple[dict[str, NDArray[Any]], dict[str, str]]]:
    """Columns of what was logged at the same times, times first, and the times' units."""
    from rerun.chunk import RrdReader

    parts: dict[str, list[tuple[Stamps, NDArray[Any]]]] = {}
    units: dict[str, str] = {}
    count = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files without a table of contents, which are read
        for chunk in RrdReader(path).stream().to_chunks():
            if chunk.is_static or chunk.entity_path.startswith("/__"):
                continue
            batch = chunk.to_record_batch()
            units |= _units(batch)
            for name, stamps, values in _components(chunk.entity_path.lstrip("/"), batch):
                parts.setdefault(name, []).append((stamps, values))
                count += values.size + len(stamps) * len(values)
                if count > MOST_NUMBERS:
                    raise RecordingError(f"{path}: more than {MOST_NUMBERS:.0e} numbers")
    alike: dict[tuple[Any, ...], dict[str, NDArray[Any]]] = {}
    for name, pieces in parts.items():
        stamps, values = _joined(pieces)
        if len(values) > 1:
            same = tuple((line, times.tobytes()) for line, times in stamps.items())
            alike.setdefault(same, dict(stamps))[name] = values
    found = sorted(alike.values(), key=len, reverse=True)
    return [(each, {n: units[n] for n in each if n in units}) for each in found]


def _units(batch: Any) -> dict[str, str]:
    """Units of a chunk's timelines; that of one that counts is none."""
    lines = (field for field in batch.schema if _kind(field) == b"index")
    return {field.name: getattr(field.type, "unit", "") for field in lines}


def _components(entity: str, batch: Any) -> Iterator[tuple[str, Stamps, NDArray[Any]]]:
    """Name, times and values of every component of a chunk that is numbers, (M, k) each."""
    lines = [field.name for field in batch.schema if _kind(field) == b"index"]
    own = [name for name in lines if name not in OWN] or lines
    for field in batch.schema:
        column = batch.column(field.name)
        if _kind(field) != b"data" or not pa.types.is_list(field.type):
            continue
        sent = column.is_valid().to_numpy(zero_copy_only=False)
        values, rows = column.drop_null().flatten(), int(sent.sum())
        while pa.types.is_fixed_size_list(values.type):
            values = values.flatten()
        numbers = pa.types.is_floating(values.type) or pa.types.is_integer(values.type)
        widths = np.diff(column.drop_null().offsets.to_numpy())
        if not numbers or not rows or widths.min() != widths.max() or not len(values):
            continue
        stamps = {line: batch.column(line).cast(pa.int64()).to_numpy()[sent] for line in own}
        name = entity if field.name == SCALARS else f"{entity}/{field.name}"
        yield name, stamps, values.to_numpy(zero_copy_only=False).reshape(rows, -1)


def _kind(field: Any) -> bytes:
    """What a column is for Rerun: index, data, control."""
    return bytes((field.metadata or {}).get(b"rerun:kind", b""))


def _joined(pieces: list[tuple[Stamps, NDArray[Any]]]) -> tuple[Stamps, NDArray[Any]]:
    """Chunks in one, in the order of their times; those on other timelines are left out."""
    lines = [*pieces[0][0]]
    alike = [(s, v) for s, v in pieces if [*s] == lines and v.shape[1] == pieces[0][1].shape[1]]
    stamps = {line: np.concatenate([s[line] for s, _ in alike]) for line in lines}
    order = np.argsort(stamps[lines[0]], kind="stable") if lines else slice(0)
    values = np.concatenate([v for _, v in alike])[order]
    return {line: each[order] for line, each in stamps.items()}, values
