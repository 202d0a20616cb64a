"""HDF5 files, those of MATLAB 7.3 among them: a column is named by its path, as log/q[0].

Only what lies in the file itself is read: no links to other files, no virtual datasets.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from testbed.importing.foreign_table import ForeignTable, is_column, library, readable


def read_file(path: Path) -> ForeignTable:
    """Columns of an HDF5 file.

    Args:
        path: The file.

    Raises:
        RecordingError: It is damaged, or h5py is not installed.
    """
    with library("h5py"):
        import h5py
    shapes: dict[str, tuple[int, ...]] = {}
    units: dict[str, str] = {}

    def visit(name: str, item: Any) -> None:
        inside = (
            isinstance(item, h5py.Dataset) and not item.external and not item.is_virtual
        )
        if inside and is_column(item.shape or (), item.dtype.kind):
            shapes[name] = (
                tuple(reversed(item.shape)) if _by_matlab(item) else item.shape
            )
            unit = item.attrs.get("unit", item.attrs.get("units"))
            if isinstance(unit, str):
                units[name] = unit

    with readable(path), h5py.File(path, "r") as file:
        file.visititems(visit)
    return ForeignTable(path, shapes, lambda name: _dataset(path, name), units)


def _dataset(path: Path, name: str) -> Any:
    import h5py

    with h5py.File(path, "r") as file:
        found = file[name]
        return found[()].T if _by_matlab(found) else found[()]


def _by_matlab(dataset: Any) -> bool:
    """Whether MATLAB wrote it, which counts axes from the other end."""
    return "MATLAB_class" in dataset.attrs
