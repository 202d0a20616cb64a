"""Recordings in Parquet: column names, units, metadata."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.measurement.recording import AXES, Recording, Truth, channels

FORMAT = "testbed recording 1"
"""Name and version of the layout, kept in the file."""

ROW_GROUP = 250_000
"""Samples a row group: what a streaming reader holds at once."""

_UNITS = {
    "revolute": {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
    | dict.fromkeys(("torque", "friction"), "N m"),
    "prismatic": {"position": "m", "velocity": "m/s", "acceleration": "m/s^2"}
    | dict.fromkeys(("torque", "friction"), "N"),
}


def write(recording: Recording, path: Path) -> None:
    """Write all columns, truth included, to `path`."""
    columns = channels(recording) | _truth_columns(recording)
    geometry = recording.facts.get("geometry", {})
    fields = [pa.field(k, pa.float64(), metadata={"unit": _unit(k, geometry)}) for k in columns]
    about = {"format": FORMAT, "tare": recording.tare.tolist(), "facts": dict(recording.facts)}
    schema = pa.schema(fields, metadata={"testbed": json.dumps(about, sort_keys=True)})
    table = pa.table([pa.array(values) for values in columns.values()], schema=schema)
    pq.write_table(
        table,
        path,
        compression="zstd",
        compression_level=1,
        use_dictionary=False,
        use_byte_stream_split=True,
        row_group_size=ROW_GROUP,
    )


def read(path: Path) -> Recording:
    """Read a recording; columns are found by name, others are ignored.

    Raises:
        RecordingError: The file is missing or damaged, or a channel is missing.
    """
    if not path.is_file():
        raise RecordingError(f"there is no recording '{path}'")
    try:
        file = pq.ParquetFile(path, pre_buffer=False)
        schema = file.schema_arrow
        about = json.loads((schema.metadata or {}).get(b"testbed", b"{}"))
        names = _joint_names(schema.names, path)
        wanted = [name for name in schema.names if _group(name) in _KNOWN]
        table = file.read(columns=wanted)
        columns = {name: table[name].to_numpy().astype(np.float64) for name in wanted}
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise RecordingError(f"{path}: not a readable Parquet recording: {reason}") from None
    return _assemble(names, columns, about, path)


_TRUE = ("position", "velocity", "acceleration", "torque", "friction")
_KNOWN = {"time", "wrench", *_TRUE, *(f"truth/{g}" for g in (*_TRUE, "wrench"))} - {"friction"}


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
        tare=np.array(about.get("tare", np.zeros(6))),
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
    if member == "time":
        return "s"
    if group == "wrench":
        return "N" if member.startswith("F") else "N m"
    kind = geometry.get(member, {}).get("kind", "revolute")
    return _UNITS[kind][group]
