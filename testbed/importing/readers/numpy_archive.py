"""NumPy's own files: one array (.npy), or several in an archive (.npz). Never pickles."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import ForeignTable, is_column, readable

LONGEST_HEADER = 10_000
"""Bytes of the words before an array's numbers."""


def read_file(path: Path) -> ForeignTable:
    """Columns of an archive's arrays; of a single array, those of `array`.

    Args:
        path: The file.

    Raises:
        RecordingError: It is damaged.
    """
    archive, found = None, {}
    with readable(path):
        if path.suffix.lower() == ".npy":
            with path.open("rb") as stream:
                found["array"] = _header(stream, path.stat().st_size)
        else:
            # stays open: some have thousands of members
            archive = zipfile.ZipFile(path)
            for member in archive.infolist():
                if member.filename.endswith(".npy"):
                    with archive.open(member) as inside:
                        name = member.filename.removesuffix(".npy")
                        found[name] = _header(inside, member.file_size)
    shapes = {
        name: shape for name, (shape, kind) in found.items() if is_column(shape, kind)
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
    """Shape and kind of an array, which must fit into what the file says it has.

    Raises:
        RecordingError: It does not: reading it would make place for numbers that are not there.
    """
    readers = {
        1: np.lib.format.read_array_header_1_0,
        2: np.lib.format.read_array_header_2_0,
    }
    major, _ = np.lib.format.read_magic(stream)
    if (read := readers.get(major)) is None:
        raise RecordingError(f"an array of NumPy's format {major} is not known")
    shape, _, kind = read(stream, max_header_size=LONGEST_HEADER)
    if min(shape, default=0) < 0 or np.prod(shape, dtype=float) * kind.itemsize > size:
        raise RecordingError(f"an array of shape {shape} is larger than its file")
    return shape, kind.kind
