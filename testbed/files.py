"""Files appear whole or not at all.

What is being written stands in a hidden folder beside its place, a nest, which its writer
holds locked. The lock goes with the process, so the next writer there can sweep the nests of
those that were killed.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import hashlib
import os
import platform
import re
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

NEST = f".testbed-{re.sub('[^A-Za-z0-9]', '_', platform.node())[:64]}-"
"""How nests begin: with this machine's name, since not every file system shares its locks."""

AT_FDCWD, EXCHANGE = -100, 2
"""Of Linux' renameat2, and of renamex_np of macOS."""


@contextmanager
def replacing(path: Path, *, folder: bool = False) -> Iterator[Path]:
    """A temporary path beside `path`, which takes its place if the block succeeds.

    At every instant the old or the new one stands there, complete.

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
    with _nest_beside(place, path) as nest:
        yield nest / "fresh"
        _put(nest, place)


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
            with _nest_beside(place, path):
                pass


@contextmanager
def _nest_beside(place: Path, path: Path) -> Iterator[Path]:
    """A nest beside a place, and the folders above it while there is something in them.

    Raises:
        OSError: It cannot be made there; in the words of `path`.
    """
    missing = [each for each in place.parents if not each.exists()]
    try:
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            _sweep(place.parent)
            nest, lock = _new_nest(place.parent)
        except OSError as error:
            raise OSError(f"'{path}' may not be written there: {error.strerror}") from None
        try:
            yield nest
        finally:
            _remove(nest, lock)
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


def _new_nest(parent: Path) -> tuple[Path, int]:
    """A folder for what is not whole yet, and the lock on it."""
    while True:
        nest = Path(tempfile.mkdtemp(prefix=NEST, dir=parent))
        lock = _locked(nest)
        if lock is not None:
            return nest, lock


def _locked(nest: Path, *, sweeping: bool = False) -> int | None:
    """The lock on a nest; None if another process has it, or has just swept the nest away."""
    path = nest / "lock"
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(lock), path.stat()):
            return lock
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:  # a file system without locks: nobody can sweep there
        if not sweeping:
            return lock
    os.close(lock)
    return None


def _sweep(folder: Path) -> None:
    """Remove the nests of writers that were killed there."""
    for nest in folder.glob(f"{NEST}*"):
        with suppress(OSError):
            lock = None if nest.is_symlink() else _locked(nest, sweeping=True)
            if lock is not None:
                try:
                    _put_back(nest)
                finally:  # its owner may be removing it at this moment
                    _remove(nest, lock)


def _remove(nest: Path, lock: int) -> None:
    """Remove a nest; its lock is held meanwhile, so that nobody else removes it too."""
    shutil.rmtree(nest, ignore_errors=True)
    os.close(lock)
    with suppress(OSError):  # gone already, unless the file system keeps what is open
        nest.rmdir()


def _put(nest: Path, place: Path) -> None:
    """Put what is fresh in its place."""
    fresh = nest / "fresh"
    while True:
        with _passing(errno.ENOTEMPTY, errno.EEXIST):  # a folder cannot replace a full one
            fresh.replace(place)
            return
        with _passing(errno.ENOENT, errno.ENOTEMPTY, errno.EEXIST):  # another writer moved it away
            if not _exchanged(fresh, place):
                _in_two_steps(nest, place)
            return


@contextmanager
def _passing(*codes: int) -> Iterator[None]:
    """Errors of the system with these codes are none."""
    try:
        yield
    except OSError as error:
        if error.errno not in codes:
            raise


def _exchanged(a: Path, b: Path) -> bool:
    """Let two paths change places in one step; False if this system cannot."""
    library, ends = ctypes.CDLL(None, use_errno=True), (os.fsencode(a), os.fsencode(b))
    if hasattr(library, "renameat2"):  # of Linux
        failed = library.renameat2(AT_FDCWD, ends[0], AT_FDCWD, ends[1], EXCHANGE)
    elif hasattr(library, "renamex_np"):  # of macOS
        failed = library.renamex_np(*ends, EXCHANGE)
    else:
        return False
    code = ctypes.get_errno()
    if failed and code not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP):
        raise OSError(code, os.strerror(code), str(b))
    return not failed


def _in_two_steps(nest: Path, place: Path) -> None:
    """The older one away, the fresh one there; if that fails or is killed, the older one back."""
    older = nest / "older" / place.name
    shutil.rmtree(older.parent, ignore_errors=True)
    older.parent.mkdir()
    place.rename(older)
    try:
        (nest / "fresh").rename(place)
    except OSError:
        _put_back(nest)
        raise


def _put_back(nest: Path) -> None:
    """What stood in a place that is empty now goes there again."""
    if (nest / "older").is_dir():
        for older in (nest / "older").iterdir():
            with suppress(OSError):  # somebody has put something there
                older.rename(nest.parent / older.name)
