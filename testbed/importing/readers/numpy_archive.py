"""NumPy files: one array (.npy), or several arrays in an archive (.npz), without pickles."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import (
    ForeignTable,
    is_column_array,
    reading_errors_as_recording_errors,
)

MAX_HEADER_BYTES = 10_000
"""Largest size of an array's header [bytes]."""


def read_file(path: Path) -> ForeignTable:
    """Read the columns of a file's arrays; a single array is named `array`.

    Args:
        path: Path of the file.

    Raises:
        RecordingError: The file is damaged.
    """
    archive, headers = None, {}
    with reading_errors_as_recording_errors(path):
        if path.suffix.lower() == ".npy":
            with path.open("rb") as stream:
                headers["array"] = _header(stream, path.stat().st_size)
        else:
            # the archive stays open: it may have thousands of members
            archive = zipfile.ZipFile(path)
            for member in archive.infolist():
                if member.filename.endswith(".npy"):
                    with archive.open(member) as inside:
                        name = member.filename.removesuffix(".npy")
                        headers[name] = _header(inside, member.file_size)
    shapes = {
        name: shape
        for name, (shape, kind) in headers.items()
        if is_column_array(shape, kind)
    }

    def load(name: str) -> Any:
        with (
            path.open("rb")
            if archive is None
            else archive.open(f"{name}.npy") as stream
        ):
            return np.lib.format.read_array(stream, allow_pickle=False)

    return ForeignTable(path, shapes, load)


def _header(stream: IO[bytes], size: int) -> tuple[tuple[int, ...], str]:
    """Shape and dtype kind of an array, from the header in the file.

    Args:
        stream: File at the beginning of the array.
        size: Size of the array including the header [bytes].

    Raises:
        RecordingError: The array would be larger than the file, or the format is not known.
    """
    readers = {
        1: np.lib.format.read_array_header_1_0,
        2: np.lib.format.read_array_header_2_0,
    }
    major, _ = np.lib.format.read_magic(stream)
    if (read := readers.get(major)) is None:
        raise RecordingError(f"an array of NumPy's format {major} is not known")
    shape, _, kind = read(stream, max_header_size=MAX_HEADER_BYTES)
    if min(shape, default=0) < 0 or np.prod(shape, dtype=float) * kind.itemsize > size:
        raise RecordingError(f"an array of shape {shape} is larger than its file")
    return shape, kind.kind
