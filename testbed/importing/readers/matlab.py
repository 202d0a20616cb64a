"""MATLAB's files: version 5 through SciPy, version 7.3, which is HDF5, through h5py.

Fields of structs are named by their path, as log/q[0].
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import ForeignTable, is_column, readable
from testbed.importing.readers import hdf5

HEADER = 128
"""Bytes before the first element."""


def read_file(path: Path) -> ForeignTable:
    """Columns of a MATLAB file.

    Args:
        path: The file.

    Raises:
        RecordingError: It is damaged, or of version 7.3 and h5py is not installed.
    """
    with readable(path):
        with path.open("rb") as stream:
            head = stream.read(HEADER)
        if head.startswith(b"MATLAB 7.3"):
            return hdf5.read_file(path)
        if not head.startswith(b"MATLAB 5.0"):
            raise RecordingError(f"{path}: no MATLAB file of version 5 or 7.3")
        from scipy.io import loadmat

        found = _nested(
            loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True)
        )
    arrays = {
        name: array
        for name, array in found.items()
        if is_column(array.shape, array.dtype.kind)
    }
    return ForeignTable.of(path, arrays, {})


def _nested(
    content: dict[str, Any], before: str = ""
) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays of structs in structs, by path."""
    found: dict[str, np.ndarray[Any, Any]] = {}
    for name, value in content.items():
        if isinstance(value, dict):
            found |= _nested(value, f"{before}{name}/")
        elif isinstance(value, np.ndarray) and not name.startswith("__"):
            found[before + name] = value
    return found
