"""HDF5 files, including MATLAB 7.3.

A column is named by its path, for example log/q[0]. Only data in the file itself are read, no links
to other files and no virtual datasets.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from testbed.importing.foreign_table import (
    ForeignTable,
    is_column_array,
    optional_package,
    reading_errors_as_recording_errors,
)


def read_file(path: Path) -> ForeignTable:
    """Read the columns of an HDF5 file, named by the path of their dataset.

    Units are taken from the attribute `unit` or `units`; external and virtual datasets are ignored.

    Args:
        path: Path of the file.

    Raises:
        RecordingError: The file is damaged, or h5py is not installed.
    """
    with optional_package("h5py"):
        import h5py
    shapes: dict[str, tuple[int, ...]] = {}
    units: dict[str, str] = {}

    def visit(name: str, item: Any) -> None:
        inside = (
            isinstance(item, h5py.Dataset) and not item.external and not item.is_virtual
        )
        if inside and is_column_array(item.shape or (), item.dtype.kind):
            shapes[name] = (
                tuple(reversed(item.shape))
                if _is_written_by_matlab(item)
                else item.shape
            )
            unit = item.attrs.get("unit", item.attrs.get("units"))
            if isinstance(unit, str):
                units[name] = unit

    with reading_errors_as_recording_errors(path), h5py.File(path, "r") as file:
        file.visititems(visit)
    return ForeignTable(path, shapes, lambda name: _dataset_values(path, name), units)


def _dataset_values(path: Path, name: str) -> Any:
    """Values of a dataset; the axes of a MATLAB file are reversed."""
    import h5py

    with h5py.File(path, "r") as file:
        dataset = file[name]
        return dataset[()].T if _is_written_by_matlab(dataset) else dataset[()]


def _is_written_by_matlab(dataset: Any) -> bool:
    """Test whether MATLAB wrote a dataset, with the axes in reverse order."""
    return "MATLAB_class" in dataset.attrs
