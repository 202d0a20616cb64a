"""C3D files of motion laboratories: analog channels (force plates) and points.

Columns are analog/LABEL and point/LABEL/x, y, z, with times analog/time and point/time [s]
from the rates in the file. Points that were not seen are no numbers.

Source    The C3D File Format User Guide, Motion Lab Systems
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import (
    LENGTHS,
    ForeignTable,
    StatedPlate,
    each_once,
    library,
    plain,
    readable,
)

MOST_FRAMES = 65535
"""That the header can state."""

FIRST_LAST = 6
"""Place of the first and the last frame's number in the header."""

Parameters = dict[str, dict[str, Any]]
"""Values by group and name: arrays of numbers, or lists of texts."""


def read_file(path: Path) -> ForeignTable:
    """Columns of a C3D file.

    Args:
        path: The file.

    Raises:
        RecordingError: It is damaged, ends early, or ezc3d is not installed.
    """
    with library("ezc3d"):
        import ezc3d
    with readable(path):
        try:
            content = ezc3d.c3d(str(path))
        except (OSError, RuntimeError):
            raise RecordingError(f"{path}: no C3D file, or a damaged one") from None
        groups: Parameters = {
            group: {
                name: each["value"] for name, each in own.items() if "value" in each
            }
            for group, own in content["parameters"].items()
        }
        points, (analog,) = content["data"]["points"], content["data"]["analogs"]
        _check_complete(path, points.shape[2])
        columns: dict[str, tuple[Array, str]] = {}
        for kind, count in (("analog", analog.shape[1]), ("point", points.shape[2])):
            if (rate := content["header"][f"{kind}s"]["frame_rate"]) > 0:
                columns[f"{kind}/time"] = np.arange(count) / rate, "s"
        channels = _labels("ANALOG", groups, len(analog))
        for label, values in zip(channels, analog, strict=True):
            columns[f"analog/{label}"] = values, channels[label]
        markers = _labels("POINT", groups, points.shape[1])
        for label, place in zip(markers, points[:3].swapaxes(0, 1), strict=True):
            for axis, values in zip("xyz", place, strict=True):
                columns[f"point/{label}/{axis}"] = values, markers[label]
        plates: list[StatedPlate] = []
        # parameters that are not all there
        with suppress(KeyError, ValueError, IndexError):
            plates = [*_plates(groups, [f"analog/{label}" for label in channels])]
    shapes = {
        name: values.shape for name, (values, _) in columns.items() if len(values) > 1
    }
    units = {name: unit for name, (_, unit) in columns.items() if unit}
    return ForeignTable(
        path, shapes, lambda name: columns[name][0], units, plates=plates
    )


def _check_complete(path: Path, frames: int) -> None:
    """Refuse a file that ends before its last frame, of which ezc3d does not complain.

    Raises:
        ValueError: It does.
    """
    with path.open("rb") as stream:
        header = stream.read(FIRST_LAST + 4)
    ends = (struct.unpack_from(f"{order}2H", header, FIRST_LAST) for order in "<>")
    if frames < MOST_FRAMES and frames not in [
        last - first + 1 for first, last in ends
    ]:
        raise ValueError(f"it ends early, after {frames} frames")


def _labels(kind: str, groups: Parameters, count: int) -> dict[str, str]:
    """Units of channels or points, by labels that stand once each; empty where none is stated."""
    names = each_once(_texts(kind, "LABELS", groups), count)
    units = _texts(kind, "UNITS", groups)
    units = units[:1] * count if kind == "POINT" else units[:count]
    return dict(zip_longest(names, units, fillvalue=""))


def _texts(group: str, name: str, groups: Parameters) -> list[str]:
    """A list of texts, which goes on under LABELS2, LABELS3 where there are many."""
    parts = (
        groups.get(group, {}).get(f"{name}{more}", ()) for more in ("", "2", "3", "4")
    )
    return [str(text).strip() for part in parts for text in part]


def _plates(groups: Parameters, channels: Sequence[str]) -> Iterator[StatedPlate]:
    """Force plates of six forces and moments (types 2 and 4) or of eight forces (type 3).

    What they measure acts on the plate, along axes that are by its corners; z is downwards.

    Args:
        groups: What the file says of itself.
        channels: Names of columns.
    """
    unit = plain(next(iter(_texts("POINT", "UNITS", groups)), "mm"))
    scale = LENGTHS.get(unit, LENGTHS["mm"])
    said = groups["FORCE_PLATFORM"]
    for k, kind in enumerate(said["TYPE"]):
        if kind not in (2, 3, 4):
            continue
        corners = said["CORNERS"][:, :, k].T * scale
        origin = said["ORIGIN"][:, k] * scale
        origin = -origin if origin[2] > 0 else origin  # from the sensor up, against z
        numbers, matrix = said["CHANNEL"][:6, k], None
        if kind == 4:
            matrix = said["CAL_MATRIX"][:, :, k] * np.repeat([1, scale], 3)[:, None]
        elif kind == 3:
            a, b, _ = np.abs(origin)
            numbers, origin = said["CHANNEL"][:8, k], origin * [0, 0, 1]
            moments = [
                [0, 0, 0, 0, b, b, -b, -b],
                [0, 0, 0, 0, -a, a, a, -a],
                [-b, b, a, -a, 0, 0, 0, 0],
            ]
            matrix = np.vstack([np.repeat(np.eye(3), [2, 2, 4], axis=1), moments])
        names = tuple(channels[int(number) - 1] for number in numbers)
        rows = None if matrix is None else matrix.tolist()
        yield StatedPlate(f"plate_{k + 1}", names, _place(corners, origin), rows)


def _place(corners: Array, origin: Array) -> dict[str, list[float]] | None:
    """`xyz` and `rpy` of a sensor by its plate's corners (4, 3); None where they span no plane."""
    x = corners[[0, 3]].sum(axis=0) - corners[[1, 2]].sum(axis=0)
    y = corners[[0, 1]].sum(axis=0) - corners[[2, 3]].sum(axis=0)
    if not np.cross(x, y).any():
        return None
    rotation, _ = Rotation.align_vectors([x, y], np.eye(3)[:2])
    xyz = corners.mean(axis=0) - rotation.apply(origin)
    return {
        "xyz": xyz.round(6).tolist(),
        "rpy": rotation.as_euler("xyz").round(6).tolist(),
    }
