"""C3D files of motion laboratories: analog channels (force plates) and points.

Columns are analog/LABEL and point/LABEL/x, y, z, with times analog/time and point/time [s]
from the rates in the file. Points that were not seen are no numbers.

Source    The C3D File Format User Guide, Motion Lab Systems
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.recordings.importing.foreign_table import (
    LENGTHS,
    MOST_NUMBERS,
    ForeignTable,
    StatedPlate,
    plain,
    readable,
)
from testbed.robot.inertia import to_rpy

BLOCK = 512
"""Bytes; all places are counted in such."""

ORDERS = {84: "<", 86: ">"}
"""Of bytes, by the kind of processor; numbers of the third kind, DEC's, are not IEEE's."""

TYPES = {-1: "S1", 1: "i1", 2: "i2", 4: "f4"}
"""Of parameters' values."""

PLATFORM = ("TYPE", "CHANNEL", "CORNERS", "ORIGIN", "CAL_MATRIX")
"""Parameters of force plates."""

CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}
"""Of force plates, by their type: with a centre of pressure; forces and moments; eight forces,
as Kistler's; forces and moments by a calibration."""

MOST_FRAMES = 65535
"""That the header can state."""

Parameters = dict[str, Any]
"""Values by GROUP:NAME: arrays of numbers, or lists of texts."""


def read_file(path: Path, topic: str | None) -> ForeignTable:
    """Columns of a C3D file.

    Args:
        path: The file.
        topic: None.

    Raises:
        RecordingError: It is damaged, or ends early.
    """
    del topic
    with readable(path):
        data = path.read_bytes()
        if len(data) < 2 * BLOCK or data[1] != 80:
            raise RecordingError(f"{path}: no C3D file")
        said, order = _parameters(data)
        points, analog, rates, missing = _frames(data, said, order)
        channels = _analog(analog, said)
        units = _units("point", said) | _units("analog", said)
        plates, made = _plates(said, channels, units)
        columns = _points(points, said, missing) | channels | made
        times = {}
        for kind, rate, count in zip(
            ("point", "analog"), rates, (len(points), len(analog)), strict=True
        ):
            if rate > 0 and count:
                times[f"{kind}/time"] = np.arange(count) / rate
    columns = {name: values for name, values in (times | columns).items() if len(values) > 1}
    shapes = {name: values.shape for name, values in columns.items()}
    units |= dict.fromkeys(times, "s")
    return ForeignTable(path, shapes, columns.__getitem__, units, plates=plates)


def _plates(
    said: Parameters, channels: dict[str, Array], units: dict[str, str]
) -> tuple[tuple[StatedPlate, ...], dict[str, Array]]:
    """Force plates, and the columns of those whose channels are no forces and moments.

    What a plate measures acts on it, along axes by its corners; z points downwards.

    Args:
        said: What the file says of itself.
        channels: By name.
        units: Of channels; those of columns that are made are added.
    """
    group = {name: said.get(f"FORCE_PLATFORM:{name}", ()) for name in PLATFORM}
    kinds = [int(kind) for kind in group["TYPE"]]
    wide = len(group["CHANNEL"]) // max(len(kinds), 1)
    names, scale = [*channels], _length(said)
    found: list[StatedPlate] = []
    made: dict[str, Array] = {}
    for k, kind in enumerate(kinds):
        own = [int(n) - 1 for n in group["CHANNEL"][wide * k : wide * k + CHANNELS.get(kind, 0)]]
        if len(own) < CHANNELS.get(kind, 1) or not all(0 <= n < len(names) for n in own):
            continue
        columns = tuple(names[n] for n in own)
        origin = np.resize(np.append(group["ORIGIN"][3 * k : 3 * k + 3], np.zeros(3))[:3], 3)
        origin = -origin if origin[2] > 0 and kind != 3 else origin  # as old files have it
        if kind != 2:
            table = np.stack([channels[name] for name in columns])
            matrix = np.reshape(group["CAL_MATRIX"][36 * k : 36 * k + 36], (6, -1), order="F")
            wrench = _wrench(kind, table, origin, matrix)
            wrench[3:] *= scale / LENGTHS["mm"]
            force = "N" if kind == 4 else units.get(columns[0], "")
            columns = tuple(
                f"analog/plate {k + 1}/{a}" for a in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
            )
            made |= dict(zip(columns, wrench, strict=True))
            moment = "Nmm" if force == "N" else force
            units |= dict(zip(columns, [force] * 3 + [moment] * 3, strict=True))
        shift = {1: np.zeros(3), 3: np.array([0, 0, -abs(origin[2])])}.get(kind, origin)
        corners = np.reshape(group["CORNERS"][12 * k : 12 * k + 12], (-1, 3)) * scale
        found.append(StatedPlate(f"plate_{k + 1}", columns, _place(corners, shift * scale)))
    return tuple(found), made


def _wrench(kind: int, channels: Array, origin: Array, matrix: Array) -> Array:
    """Force and moment of a plate, (6, M), its moment in N and the file's unit of length.

    Args:
        kind: 1 with a centre of pressure, 3 with eight forces, 4 with a calibration.
        channels: (6 or 8, M).
        origin: Of the sensors, (3,).
        matrix: Of a calibration, (6, 6).
    """
    if kind == 1:
        x, y, z, px, py, turn = channels
        return np.stack([x, y, z, py * z, -px * z, turn + px * y - py * x])
    if kind == 4:
        found: Array = matrix @ channels
        return found
    x12, x34, y14, y23, z1, z2, z3, z4 = channels
    a, b, _ = origin
    moments = (b * (z1 + z2 - z3 - z4), a * (z2 + z3 - z1 - z4), b * (x34 - x12) + a * (y14 - y23))
    return np.stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4, *moments])


def _place(corners: Array, origin: Array) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """A sensor's place by the corners of its plate, in the quadrants ++, -+, --, +- of its axes.

    Args:
        corners: In the laboratory's frame, (4, 3) [m].
        origin: From the sensor to the centre of the surface, along its axes, (3,) [m].
    """
    if len(corners) != 4 or not np.isfinite(corners).all():
        return None
    x = corners[0] + corners[3] - corners[1] - corners[2]
    z = np.cross(x, corners[0] + corners[1] - corners[2] - corners[3])
    if not (x.any() and z.any()):
        return None
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    turn = np.column_stack([x, np.cross(z, x), z])
    place = corners.mean(axis=0) - turn @ origin
    return tuple(np.round(place, 7).tolist()), tuple(np.round(to_rpy(turn), 7).tolist())


def _length(said: Parameters) -> float:
    """The file's unit of length [m]; most files' is a millimetre."""
    unit = plain(next(iter(_texts("point", "UNITS", said)), "mm"))
    return LENGTHS.get(unit, LENGTHS["mm"])


def _parameters(data: bytes) -> tuple[Parameters, str]:
    """What the file says of itself, and the order of its bytes."""
    place = (data[0] - 1) * BLOCK
    order = ORDERS.get(data[place + 3])
    if order is None:
        raise RecordingError("numbers of an old processor's kind; convert the file")
    place += 4
    groups: dict[int, str] = {}
    found: dict[tuple[int, str], Any] = {}
    while True:
        length, group = struct.unpack_from("bb", data, place)
        length, here = abs(length), place + 2 + abs(length)
        if length == 0:
            break
        name = data[place + 2 : here].decode("latin-1").strip().upper()
        (step,) = struct.unpack_from(order + "H", data, here)
        if group < 0:
            groups[-group] = name
        else:
            found[group, name] = _value(data, here + 2, order)
        if step == 0:
            break
        place = here + step  # always ahead
    return {f"{groups.get(g, g)}:{name}": value for (g, name), value in found.items()}, order


def _value(data: bytes, place: int, order: str) -> Any:
    """A parameter's value: numbers in a row, or texts."""
    kind, count = struct.unpack_from("bB", data, place)
    shape = tuple(data[place + 2 : place + 2 + count])
    size = int(np.prod(shape)) if shape else 1
    values = np.frombuffer(data, order + TYPES[kind], size, place + 2 + count)
    if kind != -1:
        return values
    width = shape[0] if shape else 1
    text = values.tobytes().decode("latin-1")
    return [text[k : k + width].strip() for k in range(0, size, width)] if width else []


def _frames(
    data: bytes, said: Parameters, order: str
) -> tuple[Array, Array, tuple[float, float], NDArray[np.bool_]]:
    """Points (M, P, 3), analog (m, C), both rates [Hz], and which points are missing (M, P)."""
    count, per_frame, first, last = struct.unpack_from(order + "4H", data, 2)
    scale, begin, samples, rate = struct.unpack_from(order + "fHHf", data, 12)
    frames = last - first + 1
    if last == MOST_FRAMES and "POINT:FRAMES" in said:
        frames = int(np.float64(said["POINT:FRAMES"][0]) % 2**16) or frames
        ends = [said.get(f"TRIAL:ACTUAL_{end}_FIELD") for end in ("START", "END")]
        numbers = [end.view(order + "u2") for end in ends if end is not None]
        if len(numbers) == 2:
            low, high = (int(end[0]) + 65536 * int(end[1]) for end in numbers)
            frames = high - low + 1
    width = 4 * count + per_frame
    if frames < 1 or width < 1 or frames * width > MOST_NUMBERS or per_frame % max(samples, 1):
        raise ValueError("its header makes no sense")
    kind = order + ("f4" if scale < 0 else "i2")
    table = np.frombuffer(data, kind, frames * width, (begin - 1) * BLOCK)
    table = table.reshape(frames, width).astype(np.float64)
    points = table[:, : 4 * count].reshape(frames, count, 4)
    analog = table[:, 4 * count :]
    if scale > 0 and any("UNSIGNED" in word.upper() for word in said.get("ANALOG:FORMAT", [])):
        analog = analog % 2**16
    channels = per_frame // max(samples, 1)
    analog = analog.reshape(frames * max(samples, 1), channels) if channels else np.empty((0, 0))
    size = 1.0 if scale < 0 else scale
    return points[..., :3] * size, analog, (rate, rate * samples), points[..., 3] < 0


def _points(points: Array, said: Parameters, missing: NDArray[np.bool_]) -> dict[str, Array]:
    labels = _labels("point", said, points.shape[1])
    seen = np.where(missing[..., None], np.nan, points)
    return {
        f"point/{label}/{axis}": seen[:, k, a]
        for k, label in enumerate(labels)
        for a, axis in enumerate("xyz")
    }


def _analog(analog: Array, said: Parameters) -> dict[str, Array]:
    channels = analog.shape[1]
    scale, zero = (
        np.resize(np.append(np.asarray(said.get(f"ANALOG:{what}", []), float), rest), channels)
        for what, rest in (("SCALE", 1.0), ("OFFSET", 0.0))
    )
    scale = scale * float(np.append(said.get("ANALOG:GEN_SCALE", []), 1.0)[0])
    labels = _labels("analog", said, channels)
    return {
        f"analog/{label}": (analog[:, k] - zero[k]) * scale[k] for k, label in enumerate(labels)
    }


def _labels(kind: str, said: Parameters, count: int) -> list[str]:
    """A name for each channel or point, each once."""
    given = _texts(kind, "LABELS", said)
    names: list[str] = []
    for k in range(count):
        name = given[k] if k < len(given) and given[k] else str(k)
        names.append(name if name not in names else f"{name} ({k})")
    return names


def _units(kind: str, said: Parameters) -> dict[str, str]:
    """What the file says of units, by column."""
    given = _texts(kind, "UNITS", said)
    labels = _texts(kind, "LABELS", said)
    if kind == "point":
        axes = [f"point/{label}/{axis}" for label in labels for axis in "xyz"]
        return dict.fromkeys(axes, given[0]) if given else {}
    return {f"analog/{label}": unit for label, unit in zip(labels, given, strict=False) if unit}


def _texts(kind: str, what: str, said: Parameters) -> list[str]:
    """A list of texts, which goes on under LABELS2, LABELS3 where there are many."""
    found: list[str] = []
    for more in ("", "2", "3", "4"):
        found += list(said.get(f"{kind.upper()}:{what}{more}", []))
    return found
