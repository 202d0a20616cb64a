"""Readers of foreign formats: one module a format, each with `read_file(path, topic)`."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from testbed.errors import RecordingError, UnknownName
from testbed.recordings.importing.foreign_table import ForeignTable

READERS = {
    "delimited_text": (".csv", ".tsv", ".txt", ".dat"),
    "numpy_archive": (".npz", ".npy"),
    "parquet_columns": (".parquet",),
    "matlab": (".mat",),
    "hdf5": (".h5", ".hdf5", ".hdf"),
    "ros_bag": (".bag", ".mcap", ".db3"),
    "c3d": (".c3d",),
}
"""Modules of this room, and the endings of their files."""

ENDINGS = {ending: module for module, endings in READERS.items() for ending in endings}


def open_foreign(path: Path, topic: str | None = None) -> ForeignTable:
    """What a file of another program holds.

    Args:
        path: The file, of one of `ENDINGS`, text also packed as .gz; or a ROS 2 bag's folder.
        topic: Of a ROS bag, else None.

    Raises:
        RecordingError: The file is missing or damaged, or a library is not installed.
        UnknownName: The ending is that of no known format.
    """
    if "\0" in str(path) or not path.exists():
        raise RecordingError(f"there is no file '{path}'")
    module = reader_of(path)
    if (topic is not None) != (module == "ros_bag"):
        said = "say `topic`" if topic is None else "`topic` is for ROS bags"
        raise RecordingError(f"{path}: {said}")
    read = import_module(f"{__name__}.{module}").read_file  # one of READERS, not the file's word
    found: ForeignTable = read(path, topic)
    return found


def reader_of(path: Path) -> str:
    """The module that reads a file.

    Raises:
        RecordingError: It is no file.
        UnknownName: Its ending is that of no known format.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "ros_bag"
        raise RecordingError(f"'{path}' is a folder, and no ROS 2 bag")
    if not path.is_file():
        raise RecordingError(f"'{path}' is no file")
    name = path.name.lower().removesuffix(".gz")
    ending = Path(name).suffix
    packed = path.name.lower().endswith(".gz")
    if ending not in ENDINGS or (packed and ENDINGS[ending] != "delimited_text"):
        raise UnknownName("format", "".join(path.suffixes[-2:]) or path.name, ENDINGS)
    return ENDINGS[ending]
