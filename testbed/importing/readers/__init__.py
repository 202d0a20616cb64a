"""Readers of foreign formats: one module each, with `read_file` or, for several topics, `tables`.

Input: a file.
Output: columns by name, with the values as in the file.
"""

from __future__ import annotations

from pathlib import Path

from testbed.core.base.errors import (
    MAX_LIST_WIDTH,
    RecordingError,
    UnknownName,
    missing_file_message,
    shortened_list,
)
from testbed.importing.foreign_table import (
    ForeignTable,
    TablesByTopic,
    check_count,
    reading_errors_as_recording_errors,
)
from testbed.importing.readers.isolated import (
    read_tables_directly,
    read_tables_in_child,
)
from testbed.importing.vocabulary import read_table

FORMATS = read_table("formats")
"""Formats by the module of this package that reads them."""

FOLDER_MARKS = {
    name: each["folder"] for name, each in FORMATS.items() if "folder" in each
}
"""Modules that read a folder, and the file by which such a folder is recognised."""

MODULE_OF_ENDING = {
    ending: name for name, each in FORMATS.items() for ending in each["endings"]
}


def open_foreign_table(path: Path, topic: str | None = None) -> ForeignTable:
    """Open a table in a file of another program.

    Args:
        path: File with an extension in `MODULE_OF_ENDING`, text also compressed as .gz; or a folder
            with one of the files in `FOLDER_MARKS`.
        topic: Topic of a bag or entity of a Rerun file, if the file holds several tables; otherwise
            None.

    Raises:
        RecordingError: The file is missing or damaged, a library is not installed, or the file
            holds several tables and `topic` is None.
        UnknownName: The extension is not known.
    """
    module = _reader_module(path)
    if topic is not None and not FORMATS[module].get("topics"):
        raise RecordingError(f"{path}: `topic` is for bags, MCAP and .rrd")
    contents = _tables_of_module(path, module, topic)
    if len(contents) > 1:
        raise RecordingError(
            f"{path}: say `topic`: {shortened_list([*contents], MAX_LIST_WIDTH)}"
        )
    (table,) = contents.values()
    if isinstance(table, Exception):
        raise table
    return table


def read_tables(path: Path) -> TablesByTopic:
    """Tables of a file, keyed by topic; a single table has the topic "".

    Args:
        path: File or folder.

    Raises:
        RecordingError: The file is damaged, or a library is not installed.
        UnknownName: The extension is not known.
    """
    return _tables_of_module(path, _reader_module(path), None)


def _tables_of_module(path: Path, module: str, topic: str | None) -> TablesByTopic:
    """Tables of a file, keyed by topic, read by a module of this package.

    Modules whose libraries can crash run in a child process.

    Args:
        path: File or folder.
        module: Reader in this package.
        topic: Topic of a single table; None for all tables.

    Raises:
        RecordingError: The file contains no numbers.
    """
    isolated = FORMATS[module].get("isolated")
    contents = (read_tables_in_child if isolated else read_tables_directly)(
        module, path, topic
    )
    if not contents:
        raise RecordingError(f"{path}: there are no messages or numbers in it")
    return contents


MAX_FILES = 100_000
"""Largest number of files in a folder."""


def _reader_module(path: Path) -> str:
    """Name of the module that reads a file.

    Raises:
        RecordingError: The path is neither a file nor a folder of a known format.
        UnknownName: The extension is not known.
    """
    if path.is_dir():
        for module, mark in FOLDER_MARKS.items():
            if (path / mark).is_file():
                _check_folder(path)
                return module
        marks = " or ".join(FOLDER_MARKS.values())
        raise RecordingError(
            f"'{path}' is a folder without {marks}: no dataset and no ROS 2 bag"
        )
    if "\0" in str(path) or not path.is_file():
        raise RecordingError(missing_file_message(path, "file"))
    parents = path.absolute().parents
    if (
        path.suffix == ".parquet"
        and len(parents) > 2
        and (parents[2] / FOLDER_MARKS["lerobot"]).is_file()
    ):
        _check_folder(parents[2])
        return "lerobot"  # file of a dataset
    name = path.name.lower().removesuffix(".gz")
    ending = Path(name).suffix
    is_gzip = path.name.lower().endswith(".gz")
    if ending not in MODULE_OF_ENDING or (
        is_gzip and MODULE_OF_ENDING[ending] != "delimited_text"
    ):
        raise UnknownName(
            "format", "".join(path.suffixes[-2:]) or path.name, MODULE_OF_ENDING
        )
    return MODULE_OF_ENDING[ending]


def _check_folder(path: Path) -> None:
    """Refuse a folder with pipes, devices, links out of the folder, or too many files.

    Raises:
        RecordingError: The folder contains such an entry.
    """
    with reading_errors_as_recording_errors(path):
        for count, each in enumerate(path.rglob("*"), start=1):
            check_count(path, "files", count, MAX_FILES)
            leaves_folder = each.is_symlink() and not each.resolve().is_relative_to(
                path.resolve()
            )
            if leaves_folder or not (each.is_file() or each.is_dir()):
                kind = (
                    "a link out of the folder"
                    if leaves_folder
                    else "a pipe, device or broken link"
                )
                raise RecordingError(
                    f"{path}: '{each.relative_to(path)}' is {kind}, which is not read; put the "
                    "file itself there, or remove it"
                )
