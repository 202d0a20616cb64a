"""MATLAB files of version 5 (read by SciPy) and 7.3 (HDF5, read by h5py).

Fields of structs are named by their path, for example log/q[0].
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import (
    ForeignTable,
    is_column_array,
    reading_errors_as_recording_errors,
)
from testbed.importing.readers import hdf5

HEADER_BYTES = 128
"""Number of bytes before the first element."""


def read_file(path: Path) -> ForeignTable:
    """Read the columns of a MATLAB file.

    Fields of structs are named by their path, for example log/q.

    Args:
        path: Path of the file.

    Raises:
        RecordingError: The file is damaged, or it has version 7.3 and h5py is not installed.
    """
    with reading_errors_as_recording_errors(path):
        with path.open("rb") as stream:
            head = stream.read(HEADER_BYTES)
        if head.startswith(b"MATLAB 7.3"):
            return hdf5.read_file(path)
        if not head.startswith(b"MATLAB 5.0"):
            raise RecordingError(f"{path}: no MATLAB file of version 5 or 7.3")
        from scipy.io import loadmat

        contents = _nested_arrays(
            loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True)
        )
    arrays = {
        name: array
        for name, array in contents.items()
        if is_column_array(array.shape, array.dtype.kind)
    }
    return ForeignTable.table_from_arrays(path, arrays, {})


def _nested_arrays(
    content: dict[str, Any], prefix: str = ""
) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays in nested structs, keyed by path.

    Args:
        content: Fields of a struct, keyed by name.
        prefix: Path of the struct, with a slash at the end.
    """
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    for name, value in content.items():
        if isinstance(value, dict):
            arrays |= _nested_arrays(value, f"{prefix}{name}/")
        elif isinstance(value, np.ndarray) and not name.startswith("__"):
            arrays[prefix + name] = value
    return arrays
