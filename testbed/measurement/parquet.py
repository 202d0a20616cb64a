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
    tare = None if recording.tare is None else recording.tare.tolist()
    about = {"format": FORMAT, "tare": tare, "facts": dict(recording.facts)}
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
        about = _checked(json.loads((schema.metadata or {}).get(b"testbed", b"{}")))
        names = _joint_names(schema.names, path)
        wanted = [name for name in schema.names if _group(name) in _KNOWN]
        table = file.read(columns=wanted)
        columns = {name: table[name].to_numpy().astype(np.float64) for name in wanted}
    except (pa.ArrowException, OSError, ValueError, TypeError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise RecordingError(f"{path}: not a readable Parquet recording: {reason}") from None
    return _assemble(names, columns, about, path)


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
