"""C3D files of motion laboratories: analog channels (force plates) and points.

Columns are analog/LABEL and point/LABEL/x, y, z, with times analog/time and point/time [s] computed
from the rates in the file. Points that the cameras did not detect are nan.

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
    LENGTH_UNITS,
    DescribedPlate,
    ForeignTable,
    canonical_unit,
    optional_package,
    reading_errors_as_recording_errors,
    unique_column_names,
)

MAX_FRAMES = 65535
"""Largest number of frames that the header can state."""

FRAME_NUMBERS_OFFSET = 6
"""Offset of the first and the last frame's number in the header [bytes]."""

Parameters = dict[str, dict[str, Any]]
"""Parameters by group and name: arrays of numbers, or lists of texts."""


def read_file(path: Path) -> ForeignTable:
    """Read the columns of a C3D file.

    Columns are analog/LABEL and point/LABEL/x, y, z, with analog/time and point/time [s]. Force
    plates that the parameters describe are in `plates`, which is empty if the parameters are
    incomplete.

    Args:
        path: Path of the file.

    Raises:
        RecordingError: The file is damaged or incomplete, or ezc3d is not installed.
    """
    with optional_package("ezc3d"):
        import ezc3d
    with reading_errors_as_recording_errors(path):
        try:
            content = ezc3d.c3d(str(path))
        except (OSError, RuntimeError):
            raise RecordingError(f"{path}: no C3D file, or a damaged one") from None
        groups: Parameters = {
            group: {
                name: each["value"]
                for name, each in parameters.items()
                if "value" in each
            }
            for group, parameters in content["parameters"].items()
        }
        points, (analog,) = content["data"]["points"], content["data"]["analogs"]
        _check_complete(path, points.shape[2])
        columns: dict[str, tuple[Array, str]] = {}
        for kind, count in (("analog", analog.shape[1]), ("point", points.shape[2])):
            if (rate := content["header"][f"{kind}s"]["frame_rate"]) > 0:
                columns[f"{kind}/time"] = np.arange(count) / rate, "s"
        channels = _units_by_label("ANALOG", groups, len(analog))
        for label, values in zip(channels, analog, strict=True):
            columns[f"analog/{label}"] = values, channels[label]
        markers = _units_by_label("POINT", groups, points.shape[1])
        for label, place in zip(markers, points[:3].swapaxes(0, 1), strict=True):
            for axis, values in zip("xyz", place, strict=True):
                columns[f"point/{label}/{axis}"] = values, markers[label]
        plates: list[DescribedPlate] = []
        # incomplete parameters
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
    """Refuse a file that ends before its last frame, which ezc3d does not detect.

    Raises:
        ValueError: Frames are missing.
    """
    with path.open("rb") as stream:
        header = stream.read(FRAME_NUMBERS_OFFSET + 4)
    frame_numbers = (
        struct.unpack_from(f"{order}2H", header, FRAME_NUMBERS_OFFSET) for order in "<>"
    )
    if frames < MAX_FRAMES and frames not in [
        last - first + 1 for first, last in frame_numbers
    ]:
        raise ValueError(f"it ends early, after {frames} frames")


def _units_by_label(kind: str, groups: Parameters, count: int) -> dict[str, str]:
    """Units of channels or points, keyed by unique label; empty where no unit is stated.

    Args:
        kind: Parameter group, ANALOG or POINT.
        groups: Parameters of the file.
        count: Number of channels or points.
    """
    names = unique_column_names(_texts(kind, "LABELS", groups), count)
    units = _texts(kind, "UNITS", groups)
    units = units[:1] * count if kind == "POINT" else units[:count]
    return dict(zip_longest(names, units, fillvalue=""))


def _texts(group: str, name: str, groups: Parameters) -> list[str]:
    """Texts of a parameter, continued in the parameters with suffixes 2, 3 and 4."""
    parts = (
        groups.get(group, {}).get(f"{name}{suffix}", ())
        for suffix in ("", "2", "3", "4")
    )
    return [str(text).strip() for part in parts for text in part]


def _eight_force_matrix(origin: Array) -> Array:
    """Matrix from a type-3 plate's eight forces to the wrench at the plate's centre, (6, 8).

    Forces are in the order x12, x34, y14, y23, z1, z2, z3, z4, where the digits number the corners.

    Args:
        origin: Distances of the corner sensors from the centre along x and y, (3,) [m].
    """
    a, b, _ = np.abs(origin)
    moments = [
        [0, 0, 0, 0, b, b, -b, -b],
        [0, 0, 0, 0, -a, a, a, -a],
        [-b, b, a, -a, 0, 0, 0, 0],
    ]
    return np.vstack([np.repeat(np.eye(3), [2, 2, 4], axis=1), moments])


def _plates(groups: Parameters, channels: Sequence[str]) -> Iterator[DescribedPlate]:
    """Yield force plates with six forces and moments (types 2 and 4) or eight forces (type 3).

    Forces and moments act on the plate, along axes that the corners define; z points downwards.

    Args:
        groups: Parameters of the file.
        channels: Column names of the channels.
    """
    unit = canonical_unit(next(iter(_texts("POINT", "UNITS", groups)), "mm"))
    scale = LENGTH_UNITS.get(unit, LENGTH_UNITS["mm"])
    platform = groups["FORCE_PLATFORM"]
    for k, kind in enumerate(platform["TYPE"]):
        if kind not in (2, 3, 4):
            continue
        corners = platform["CORNERS"][:, :, k].T * scale
        origin = platform["ORIGIN"][:, k] * scale
        origin = -origin if origin[2] > 0 else origin  # vector upwards, against z
        numbers, matrix = platform["CHANNEL"][:6, k], None
        if kind == 4:
            matrix = platform["CAL_MATRIX"][:, :, k] * np.repeat([1, scale], 3)[:, None]
        elif kind == 3:
            matrix = _eight_force_matrix(origin)
            numbers, origin = platform["CHANNEL"][:8, k], origin * [0, 0, 1]
        names = tuple(channels[int(number) - 1] for number in numbers)
        rows = None if matrix is None else matrix.tolist()
        yield DescribedPlate(
            f"plate_{k + 1}", names, _sensor_pose(corners, origin), rows
        )


def _sensor_pose(corners: Array, origin: Array) -> dict[str, list[float]] | None:
    """Pose `xyz` [m] and `rpy` [rad] of a plate's sensor; None for degenerate corners.

    The pose is in the laboratory frame; roll, pitch and yaw are about fixed axes x, then y, then z.

    Args:
        corners: Corners of the plate in the laboratory frame, (4, 3) [m].
        origin: Vector from the sensor to the plate's centre in the plate's axes, (3,) [m].
    """
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
