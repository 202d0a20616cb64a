"""C3D files of motion laboratories: analog channels (force plates) and points.

Columns are analog/LABEL and point/LABEL/x, y, z, with times analog/time and point/time [s]
from the rates in the file. Points that were not seen are no numbers.

Source    The C3D File Format User Guide, Motion Lab Systems
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import (
    LENGTHS,
    MOST_COLUMNS,
    MOST_NUMBERS,
    ForeignTable,
    StatedPlate,
    check_count,
    each_once,
    plain,
    readable,
)

BLOCK = 512
"""Bytes; all places are counted in such."""

ORDERS = {84: "<", 86: ">"}
"""Of bytes, by the kind of processor; numbers of the third kind, DEC's, are not IEEE's."""

TYPES = {-1: "S1", 1: "i1", 2: "i2", 4: "f4"}
"""Of parameters' values."""

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
        check_count(path, "columns", 3 * points.shape[1] + analog.shape[1], MOST_COLUMNS)
        channels = _analog(analog, said)
        columns = _points(points, said, missing) | channels
        plates = []
        with suppress(KeyError, ValueError, IndexError):  # parameters that are not all there
            plates = [*_plates(said, [*channels])]
        times = {}
        for kind, rate, count in zip(
            ("analog", "point"), rates, (len(analog), len(points)), strict=True
        ):
            if rate > 0 and count:
                times[f"{kind}/time"] = np.arange(count) / rate
    columns = {name: values for name, values in (times | columns).items() if len(values) > 1}
    shapes = {name: values.shape for name, values in columns.items()}
    units = dict.fromkeys(times, "s") | _units("point", said) | _units("analog", said)
    return ForeignTable(path, shapes, columns.__getitem__, units, plates=plates)


def _plates(said: Parameters, channels: Sequence[str]) -> Iterator[StatedPlate]:
    """Force plates of six forces and moments (types 2 and 4) or of eight forces (type 3).

    What they measure acts on the plate, along axes that are by its corners; z is downwards.

    Args:
        said: What the file says of itself.
        channels: Names of columns.
    """
    unit = plain(next(iter(_texts("point", "UNITS", said)), "mm"))
    scale = LENGTHS.get(unit, LENGTHS["mm"])
    kinds = said.get("FORCE_PLATFORM:TYPE", ())
    group = {
        name: np.reshape(said[f"FORCE_PLATFORM:{name}"], (len(kinds), -1))
        for name in ("CHANNEL", "CORNERS", "ORIGIN", "CAL_MATRIX")
        if len(said.get(f"FORCE_PLATFORM:{name}", ())) >= len(kinds) > 0
    }
    for k, kind in enumerate(kinds):
        if kind not in (2, 3, 4):
            continue
        corners = group["CORNERS"][k].reshape(4, 3) * scale
        origin = group["ORIGIN"][k] * scale
        origin = -origin if origin[2] > 0 else origin  # from the sensor up, against z
        numbers, matrix = group["CHANNEL"][k][:6], None
        if kind == 4:
            matrix = group["CAL_MATRIX"][k].reshape(6, 6).T * np.repeat([1, scale], 3)[:, None]
        elif kind == 3:
            a, b, _ = np.abs(origin)
            numbers, origin = group["CHANNEL"][k][:8], origin * [0, 0, 1]
            moments = [
                [0, 0, 0, 0, b, b, -b, -b],
                [0, 0, 0, 0, -a, a, a, -a],
                [-b, b, a, -a, 0, 0, 0, 0],
            ]
            matrix = np.vstack([np.repeat(np.eye(3), [2, 2, 4], axis=1), moments])
        x = corners[[0, 3]].sum(axis=0) - corners[[1, 2]].sum(axis=0)
        y = corners[[0, 1]].sum(axis=0) - corners[[2, 3]].sum(axis=0)
        place = None
        if np.cross(x, y).any():
            turn, _ = Rotation.align_vectors([x, y], np.eye(3)[:2])
            xyz = corners.mean(axis=0) - turn.apply(origin)
            place = {"xyz": xyz.round(6).tolist(), "rpy": turn.as_euler("xyz").round(6).tolist()}
        names = tuple(channels[int(number) - 1] for number in numbers)
        rows = None if matrix is None else matrix.tolist()
        yield StatedPlate(f"plate_{k + 1}", names, place, rows)


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
    """Points (M, P, 3), analog (m, C), rates of analog and points [Hz], points missing (M, P)."""
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
    return points[..., :3] * size, analog, (rate * samples, rate), points[..., 3] < 0


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
    return each_once(given[k] if k < len(given) and given[k] else str(k) for k in range(count))


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
