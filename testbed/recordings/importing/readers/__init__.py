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
    "ros_bag": (".bag", ".db3"),
    "mcap": (".mcap",),
    "rerun_log": (".rrd",),
    "c3d": (".c3d",),
}
"""Modules of this room, and the endings of their files."""

FOLDERS = {"lerobot": "meta/info.json", "ros_bag": "metadata.yaml"}
"""Modules that read a folder, and the file in it by which it is known."""

ENDINGS = {ending: module for module, endings in READERS.items() for ending in endings}


def open_foreign(path: Path, topic: str | None = None) -> ForeignTable:
    """What a file of another program holds.

    Args:
        path: The file, of one of `ENDINGS`, text also packed as .gz; or a folder that holds one of
            `FOLDERS`.
        topic: Which of a file's tables: a topic, an entity of Rerun, an episode; None if it is one.

    Raises:
        RecordingError: The file is missing or damaged, or a library is not installed.
        UnknownName: The ending is that of no known format.
    """
    if "\0" in str(path) or not path.exists():
        raise RecordingError(f"there is no file '{path}'")
    module = _reader_of(path)
    if topic is not None and module not in PARTED:
        raise RecordingError(f"{path}: `topic` is for {', '.join(PARTED)}")
    reader = import_module(f"{__name__}.{module}")  # one of READERS, not the file's word
    if topic is None and len(names := topics(path)) != 1:
        raise RecordingError(f"{path}: say `topic`: {', '.join(map(str, names))}")
    found: ForeignTable = reader.read_file(path, topic or names[0])
    return found


def topics(path: Path) -> list[str | None]:
    """What of a file `open_foreign` takes as a table; None alone where that is the file.

    Args:
        path: The file or folder.

    Raises:
        RecordingError: It is damaged, or a library is not installed.
        UnknownName: The ending is that of no known format.
    """
    reader = import_module(f"{__name__}.{_reader_of(path)}")
    return [*reader.topics(path)] if hasattr(reader, "topics") else [None]


PARTED = ("ros_bag", "mcap", "rerun_log", "lerobot")
"""Modules whose files may hold several tables."""


def _reader_of(path: Path) -> str:
    """The module that reads a file.

    Raises:
        RecordingError: It is no file.
        UnknownName: Its ending is that of no known format.
    """
    if path.is_dir():
        for module, mark in FOLDERS.items():
            if (path / mark).is_file():
                return module
        marks = " or ".join(FOLDERS.values())
        raise RecordingError(f"'{path}' is a folder without {marks}: no dataset and no ROS 2 bag")
    if not path.is_file():
        raise RecordingError(f"'{path}' is no file")
    name = path.name.lower().removesuffix(".gz")
    ending = Path(name).suffix
    packed = path.name.lower().endswith(".gz")
    if ending not in ENDINGS or (packed and ENDINGS[ending] != "delimited_text"):
        raise UnknownName("format", "".join(path.suffixes[-2:]) or path.name, ENDINGS)
    return ENDINGS[ending]
