"""Recordings in Parquet: column names, units, metadata."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.recordings.recording import AXES, Recording, Truth, alike, channels

FORMAT = "testbed recording 1"
"""Name and version of the layout, kept in the file."""

ROW_GROUP = 250_000
"""Samples a row group: what a streaming reader holds at once."""

BATCH = 65_536
"""Samples read at once."""

BUFFER = 1 << 20
"""Bytes of a column that are read at once."""

_UNITS = {
    "revolute": {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
    | dict.fromkeys(("torque", "friction"), "N m"),
    "prismatic": {"position": "m", "velocity": "m/s", "acceleration": "m/s^2"}
    | dict.fromkeys(("torque", "friction"), "N"),
}


def write(recording: Recording, path: Path) -> None:
    """Write all columns, truth included, to `path`."""
    write_parts([recording], path)


def write_parts(parts: Iterable[Recording], path: Path) -> None:
    """Write parts of one recording, in the order of time, one at a time.

    Raises:
        RecordingError: There are none, or their channels differ.
    """
    writer: pq.ParquetWriter | None = None
    try:
        for part in alike(parts):
            columns = channels(part) | _truth_columns(part)
            if writer is None:
                writer = pq.ParquetWriter(
                    path,
                    _schema(part, columns),
                    compression="zstd",
                    compression_level=1,
                    use_dictionary=False,
                    use_byte_stream_split=True,
                )
            arrays = [pa.array(values) for values in columns.values()]
            writer.write_table(pa.table(arrays, schema=writer.schema), ROW_GROUP)
    finally:
        if writer is not None:
            writer.close()


def _schema(recording: Recording, columns: dict[str, Array]) -> pa.Schema:
    geometry = recording.facts.get("geometry", {})
    fields = [pa.field(k, pa.float64(), metadata={"unit": _unit(k, geometry)}) for k in columns]
    tare = None if recording.tare is None else recording.tare.tolist()
    about = {"format": FORMAT, "tare": tare, "facts": dict(recording.facts)}
    return pa.schema(fields, metadata={"testbed": json.dumps(about, sort_keys=True)})


def read(path: Path) -> Recording:
    """Read a recording; columns are found by name, others are ignored.

    Raises:
        RecordingError: The file is missing or damaged, or a channel is missing.
    """
    with _readable(path):
        file, names, about = _opened(path)
        wanted = [name for name in file.schema_arrow.names if _group(name) in _KNOWN]
        return _assemble(names, _numbers(file.read(columns=wanted), wanted), about, path)


class StoredRecording:
    """A recording that stays in its Parquet file; parts are read as they are asked for.

    Attributes:
        names: Joint names.
        samples: Number of samples.
        rate: Samples a second [Hz].
        tare: As `Recording.tare`.
        facts: As `Recording.facts`.
        senses_kinematics: Whether velocities and accelerations were sensed, both.
    """

    def __init__(self, path: str | Path) -> None:
        """Open a file; reads its ends only.

        Raises:
            RecordingError: The file is missing or damaged, or a channel is missing.
        """
        self._path = Path(path)
        with _readable(self._path):
            self._file, self.names, self._about = _opened(self._path)
            schema = self._file.schema_arrow.names
            self._wanted = [name for name in schema if _group(name) in _MEASURED]
            self.samples = self._file.metadata.num_rows
            self._restart(0)
            start = self.part(0, min(1, self.samples))
            groups = self._file.metadata.num_row_groups
            last = self._file.read_row_group(groups - 1, columns=["time"]) if groups else None
            ends = [start.time[0], last["time"][-1].as_py()] if last and self.samples else [0, 0]
        self.tare, self.facts = start.tare, start.facts
        self.senses_kinematics = start.senses_kinematics
        self.rate = (self.samples - 1) / float(ends[1] - ends[0]) if ends[1] > ends[0] else 0.0

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1; cheap where parts are asked for in their order.

        Raises:
            RecordingError: The file is damaged there.
        """
        with _readable(self._path):
            if first < self._first:
                self._restart(first)
            while self._first + sum(len(batch) for batch in self._batches) < last:
                self._batches.append(next(self._rest))
                while self._first + len(self._batches[0]) <= first:
                    self._first += len(self._batches.pop(0))
            schema = pa.schema([self._file.schema_arrow.field(name) for name in self._wanted])
            table = pa.Table.from_batches(self._batches, schema).slice(
                first - self._first, last - first
            )
            columns = _numbers(table, self._wanted)
            return _assemble(self.names, columns, self._about, self._path)

    def _restart(self, first: int) -> None:
        """Read on from the row group that holds a sample."""
        groups, start, group = self._file.metadata, 0, 0
        while (
            group + 1 < groups.num_row_groups and first >= start + groups.row_group(group).num_rows
        ):
            start += groups.row_group(group).num_rows
            group += 1
        wanted = range(group, groups.num_row_groups)
        self._first = start
        self._batches: list[pa.RecordBatch] = []
        self._rest = self._file.iter_batches(BATCH, wanted, columns=self._wanted)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except (pa.ArrowException, OSError, ValueError, TypeError, KeyError, StopIteration) as error:
        reason = " ".join(str(error).split()) or "it ends early"
        raise RecordingError(f"{path}: not a readable Parquet recording: {reason}") from None


def _opened(path: Path) -> tuple[pq.ParquetFile, tuple[str, ...], dict[str, Any]]:
    """The file, its joints, and its own metadata."""
    if not path.is_file():
        raise RecordingError(f"there is no recording '{path}'")
    file = pq.ParquetFile(path, pre_buffer=False, buffer_size=BUFFER)
    schema = file.schema_arrow
    about = _checked(json.loads((schema.metadata or {}).get(b"testbed", b"{}")))
    return file, _joint_names(schema.names, path), about


def _numbers(table: pa.Table, wanted: list[str]) -> dict[str, Array]:
    return {name: table[name].to_numpy().astype(np.float64) for name in wanted}


def is_parquet(path: Path) -> bool:
    """Whether the file begins as Parquet files do."""
    with path.open("rb") as stream:
        return stream.read(4) == b"PAR1"


def _checked(about: Any) -> dict[str, Any]:
    """The file's own metadata, of the layout this version knows.

    Raises:
        ValueError: They are of another layout.
    """
    if not isinstance(about, dict) or about.get("format", FORMAT) != FORMAT:
        raise ValueError(f"its metadata are not of the layout '{FORMAT}'")
    tare, facts = about.get("tare"), about.get("facts", {})
    numbers = isinstance(tare, list) and len(tare) == 6
    if tare is not None and not (numbers and all(isinstance(x, int | float) for x in tare)):
        raise ValueError("its 'tare' is not six numbers")
    gravity = facts.get("gravity", [0.0] * 3) if isinstance(facts, dict) else []
    vector = isinstance(gravity, list) and len(gravity) == 3
    if not (vector and all(isinstance(x, int | float) for x in gravity)):
        raise ValueError("its 'facts' are not a table, or their 'gravity' is not three numbers")
    if not isinstance(facts, dict) or not isinstance(facts.get("geometry", {}), dict):
        raise ValueError("its 'facts' are not a table")
    if not all(isinstance(joint, dict) for joint in facts.get("geometry", {}).values()):
        raise ValueError("its 'geometry' is not a table by joint")
    return about


_TRUE = ("position", "velocity", "acceleration", "torque", "friction")
_MEASURED = {"time", "wrench", *_TRUE} - {"friction"}
_KNOWN = _MEASURED | {f"truth/{g}" for g in (*_TRUE, "wrench")}


def _assemble(
    names: tuple[str, ...], columns: dict[str, Array], about: dict[str, Any], path: Path
) -> Recording:
    def group(prefix: str, members: tuple[str, ...], needed: bool) -> Array | None:
        keys = [f"{prefix}/{member}" for member in members]
        missing = [key for key in keys if key not in columns]
        if missing and (needed or len(missing) < len(keys)):
            raise RecordingError(f"{path}: channel '{missing[0]}' is missing")
        return None if missing else np.stack([columns[key] for key in keys], axis=1)

    if "time" not in columns:
        raise RecordingError(f"{path}: channel 'time' is missing")
    true = {g: group(f"truth/{g}", names, False) for g in _TRUE}
    true["wrench"] = group("truth/wrench", AXES, False)
    whole = {name: values for name, values in true.items() if values is not None}
    return Recording(
        names=names,
        time=columns["time"],
        position=_present(group("position", names, True)),
        torque=_present(group("torque", names, True)),
        wrench=_present(group("wrench", AXES, True)),
        velocity=group("velocity", names, False),
        acceleration=group("acceleration", names, False),
        tare=None if about.get("tare") is None else np.array(about["tare"], dtype=float),
        truth=Truth(**whole) if len(whole) == len(true) else None,
        facts=about.get("facts", {}),
    )


def _present(values: Array | None) -> Array:
    assert values is not None  # `group` raises for a needed channel
    return values


def _joint_names(columns: list[str], path: Path) -> tuple[str, ...]:
    names = tuple(c.split("/", 1)[1] for c in columns if c.startswith("position/"))
    if not names:
        raise RecordingError(f"{path}: there is no channel 'position/JOINT'")
    return names


def _group(column: str) -> str:
    """truth/position/elbow -> truth/position; position/elbow -> position; time -> time."""
    parts = column.split("/")
    return "/".join(parts[:2]) if parts[0] == "truth" else parts[0]


def _truth_columns(recording: Recording) -> dict[str, Array]:
    truth = recording.truth
    if truth is None:
        return {}
    columns = {
        f"truth/{group}/{name}": getattr(truth, group)[:, k]
        for group in _TRUE
        for k, name in enumerate(recording.names)
    }
    return columns | {f"truth/wrench/{axis}": truth.wrench[:, k] for k, axis in enumerate(AXES)}


def _unit(column: str, geometry: dict[str, Any]) -> str:
    *_, group, member = ("", *column.removeprefix("truth/").split("/", 1))
    if column == "time":
        return "s"
    if group == "wrench":
        return "N" if member.startswith("F") else "N m"
    kind = geometry.get(member, {}).get("kind", "revolute")
    return _UNITS[kind][group]
