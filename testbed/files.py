"""Files appear whole or not at all: they are written beside their place, and renamed."""

from __future__ import annotations

import errno
import hashlib
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

HIDDEN = ".testbed-"
"""How temporary folders begin; one of a writer that was killed stays."""


@contextmanager
def replacing(path: Path, *, folder: bool = False) -> Iterator[Path]:
    """A temporary path beside `path`, which takes its place if the block succeeds.

    What stands there is complete at every instant; a folder that is replaced is away for one.

    Args:
        path: What is to appear; what stands there is replaced only if it is of its kind.
        folder: Whether it is a folder, else a file.

    Yields:
        A path that does not exist yet. If the block fails, whatever it wrote there is
        removed and `path` is left as it was.

    Raises:
        OSError: A folder stands where a file is to appear or the other way round, or a
            device, or the place may not be written to.
    """
    place = _place(path, folder)
    with _beside(place, path) as hidden:
        fresh = hidden / "fresh"
        yield fresh
        for turn in count():
            try:
                fresh.replace(place)
                return
            except OSError as error:  # a folder cannot replace a full one
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
            with suppress(FileNotFoundError):  # another writer has moved it
                place.rename(hidden / f"older-{turn}")


def check_writable(
    *paths: Path | None, folder: bool = False, read: Iterable[Path | None] = ()
) -> None:
    """Whether `replacing` could write there: said before the work, not after it.

    Args:
        paths: What is to appear; None for nothing.
        folder: Whether they are folders, else files.
        read: What the work begins with, and is not to be replaced; None for nothing.

    Raises:
        OSError: As `replacing`, or it would replace what is read.
    """
    kept = {path.resolve() for path in read if path is not None and path.exists()}
    for path in paths:
        if path is not None:
            place = _place(path, folder)
            if place in kept:
                raise OSError(f"'{path}' is read by this command; choose another name to write")
            with _beside(place, path):
                pass


@contextmanager
def _beside(place: Path, path: Path) -> Iterator[Path]:
    """A temporary folder beside a place, and the folders above it while something is in them.

    Raises:
        OSError: It cannot be made there; in the words of `path`.
    """
    missing = [each for each in place.parents if not each.exists()]
    try:
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            hidden = tempfile.TemporaryDirectory(
                prefix=HIDDEN, dir=place.parent, ignore_cleanup_errors=True
            )
        except OSError as error:
            raise OSError(f"'{path}' may not be written there: {error.strerror}") from None
        with hidden as name:
            yield Path(name)
    finally:
        for each in missing:
            with suppress(OSError):  # what was written stands there
                each.rmdir()


def read_text(path: Path, most: int) -> str:
    """The text in a file, which need not be all UTF-8.

    Args:
        path: The file.
        most: Bytes that it may have.

    Raises:
        OSError: It is no file, may not be read, or is longer.
    """
    if not path.is_file():  # opening a pipe would wait for whoever writes into it
        raise OSError(f"'{path}' is no file")
    size = path.stat().st_size
    if size > most:
        raise OSError(f"'{path}' has {size} bytes; what is expected there has at most {most}")
    return path.read_text(encoding="utf-8", errors="replace")


def fingerprint(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _place(path: Path, folder: bool) -> Path:
    """Where to write: a link stays, what it points to is replaced."""
    try:
        place = path.resolve()
        with suppress(FileNotFoundError):
            mode = place.stat().st_mode
            if stat.S_ISDIR(mode) is not folder:
                kind = "folder" if stat.S_ISDIR(mode) else "file"
                raise ValueError(f"there is a {kind}; choose another name")
            if not folder and not stat.S_ISREG(mode):
                raise ValueError("it is a device or pipe, no file; choose another name")
            if folder and Path.cwd().is_relative_to(place):  # we would be left in one that is none
                raise ValueError("it is the working folder or above it; choose another name")
    except OSError as error:  # a name that is too long, a file among the folders above it
        raise OSError(f"'{path}' cannot be written: {error.strerror}") from None
    except (RuntimeError, ValueError) as error:  # of Python: links in a circle, a zero byte
        raise OSError(f"'{path}' cannot be written: {error}") from None
    return place
