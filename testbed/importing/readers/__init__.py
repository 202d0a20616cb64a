"""Readers of foreign formats: one module each, with `read_file` or, by topics, `tables`.

In: a file.
Out: named columns as they stand there.
"""

from __future__ import annotations

from pathlib import Path

from testbed.core.base.errors import WIDTH, RecordingError, UnknownName, few, no_file
from testbed.importing.foreign_table import ForeignTable, Tables, check_count, readable
from testbed.importing.readers.isolated import read_isolated, tables_of
from testbed.importing.vocabulary import read_table

FORMATS = read_table("formats")
"""By the module of this room that reads them."""

FOLDERS = {name: each["folder"] for name, each in FORMATS.items() if "folder" in each}
"""Modules that read a folder, and the file in it by which it is known."""

ENDINGS = {ending: name for name, each in FORMATS.items() for ending in each["endings"]}


def open_foreign(path: Path, topic: str | None = None) -> ForeignTable:
    """What a file of another program holds.

    Args:
        path: The file, of one of `ENDINGS`, text also packed as .gz; or a folder that holds one of
            `FOLDERS`.
        topic: Which of a file's tables: a topic, an entity of Rerun; None if it is one.

    Raises:
        RecordingError: The file is missing or damaged, or a library is not installed.
        UnknownName: The ending is that of no known format.
    """
    module = _reader_of(path)
    if topic is not None and not FORMATS[module].get("topics"):
        raise RecordingError(f"{path}: `topic` is for bags, MCAP and .rrd")
    found = _tables(path, module, topic)
    if len(found) > 1:
        raise RecordingError(f"{path}: say `topic`: {few([*found], WIDTH)}")
    (table,) = found.values()
    if isinstance(table, Exception):
        raise table
    return table


def tables(path: Path) -> Tables:
    """All tables of a file by what `open_foreign` takes as its topic; "" where it is one.

    Args:
        path: The file or folder.

    Raises:
        RecordingError: It is damaged, or a library is not installed.
        UnknownName: The ending is that of no known format.
    """
    return _tables(path, _reader_of(path), None)


def _tables(path: Path, module: str, topic: str | None) -> Tables:
    isolated = FORMATS[module].get("isolated")
    found = (read_isolated if isolated else tables_of)(module, path, topic)
    if not found:
        raise RecordingError(f"{path}: there are no messages or numbers in it")
    return found


MOST_FILES = 100_000
"""Of a folder."""


def _reader_of(path: Path) -> str:
    """The module that reads a file.

    Raises:
        RecordingError: It is no file.
        UnknownName: Its ending is that of no known format.
    """
    if path.is_dir():
        for module, mark in FOLDERS.items():
            if (path / mark).is_file():
                _check_folder(path)
                return module
        marks = " or ".join(FOLDERS.values())
        raise RecordingError(
            f"'{path}' is a folder without {marks}: no dataset and no ROS 2 bag"
        )
    if "\0" in str(path) or not path.is_file():
        raise RecordingError(no_file(path, "file"))
    above = path.absolute().parents
    if (
        path.suffix == ".parquet"
        and len(above) > 2
        and (above[2] / FOLDERS["lerobot"]).is_file()
    ):
        _check_folder(above[2])
        return "lerobot"  # a file of a dataset
    name = path.name.lower().removesuffix(".gz")
    ending = Path(name).suffix
    packed = path.name.lower().endswith(".gz")
    if ending not in ENDINGS or (packed and ENDINGS[ending] != "delimited_text"):
        raise UnknownName("format", "".join(path.suffixes[-2:]) or path.name, ENDINGS)
    return ENDINGS[ending]


def _check_folder(path: Path) -> None:
    """Refuse a folder in which a reader could wait, or leave the folder.

    Raises:
        RecordingError: A pipe, a device or a link to elsewhere is in it, or too many files are.
    """
    with readable(path):
        for count, each in enumerate(path.rglob("*"), start=1):
            check_count(path, "files", count, MOST_FILES)
            linked = each.is_symlink() and not each.resolve().is_relative_to(
                path.resolve()
            )
            if linked or not (each.is_file() or each.is_dir()):
                kind = (
                    "a link out of the folder"
                    if linked
                    else "a pipe, device or broken link"
                )
                raise RecordingError(
                    f"{path}: '{each.relative_to(path)}' is {kind}, which is not read; put the "
                    "file itself there, or remove it"
                )
