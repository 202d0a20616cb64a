"""Files and folders that are replaced whole and in one step, or stay as they were."""

from __future__ import annotations

import ctypes
import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

HIDDEN = ".testbed-"
"""First characters of a temporary folder's name; the folder of a killed process remains."""

FROM_WORKING_FOLDER, EXCHANGE = -100, 2
"""AT_FDCWD and RENAME_EXCHANGE of renameat2(2)."""


class _Replacements(ExitStack):
    """Complete outputs that wait to be put in place, with their temporary folders."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: list[tuple[Path, Path, Path]] = []

    def put_in_place(self) -> None:
        """Put all in place; after an error or Ctrl-C, all older ones are there again.

        Raises:
            OSError: One cannot be put there; in the words of its path.
        """
        new = [fresh.stat().st_ino for fresh, _, _ in self.waiting]
        seen = _SEEN.get({})
        try:
            for fresh, place, path in self.waiting:
                if seen.get(place, state := _state(place)) != state:
                    raise OSError(
                        f"'{path}' has been made or changed by something else since this command "
                        "began, and is not replaced; choose another name"
                    )
                with _in_words_of(path, fresh):
                    _exchange(fresh, place)
                seen |= {place: _state(place)} if place in seen else {}
                with suppress(OSError):  # a file system that does not flush folders
                    _flush(place.parent)
        except BaseException:
            for number, (fresh, place, _) in zip(new, self.waiting, strict=True):
                if place.exists() and place.stat().st_ino == number:
                    _exchange(fresh, place) if fresh.exists() else place.rename(fresh)
            raise


_SEEN: ContextVar[dict[Path, tuple[int, int] | None]] = ContextVar("_SEEN")
"""States of places when `check_writable` was asked about them."""


@contextmanager
def guarded() -> Iterator[None]:
    """Refuse in the block to replace what has changed since `check_writable` looked at it."""
    token = _SEEN.set({})
    try:
        yield
    finally:
        _SEEN.reset(token)


def _state(place: Path) -> tuple[int, int] | None:
    """Identity and time of the last change of what stands at a place; None for nothing."""
    found = place.stat() if place.exists() else None
    return found and (found.st_ino, found.st_mtime_ns)


_TOGETHER: ContextVar[_Replacements | None] = ContextVar("_TOGETHER", default=None)


@contextmanager
def together() -> Iterator[None]:
    """Delay all `replacing` within the block to its end: all paths are replaced, or none.

    Raises:
        OSError: A path cannot be replaced.
    """
    with _Replacements() as replacements:
        token = _TOGETHER.set(replacements)
        try:
            yield
        finally:
            _TOGETHER.reset(token)
        replacements.put_in_place()


@contextmanager
def replacing(path: Path, *, folder: bool = False) -> Iterator[Path]:
    """A temporary path beside `path`, which takes its place in one step if the block succeeds.

    The content is flushed to the disk before. Where the file system cannot exchange two folders,
    an older folder is away for an instant, under a name of its own beside.

    Args:
        path: What is to appear; what stands there is replaced only if it is of its kind.
        folder: Whether it is a folder, else a file.

    Yields:
        A path that does not exist yet. If the block fails, whatever it wrote there is
        removed and `path` is left as it was.

    Raises:
        OSError: A folder stands where a file is to appear or the other way round, or a
            device, or the place may not be written to; always in the words of `path`.
    """
    place = _place(path, folder)
    with _Replacements() as alone:
        replacements = _TOGETHER.get() or alone
        fresh = replacements.enter_context(_beside(place, path)) / "fresh"
        with _in_words_of(path, fresh):
            yield fresh
            for each in (fresh, *fresh.rglob("*")):
                if not each.is_symlink():
                    _flush(each)
            if place.exists():
                shutil.copymode(place, fresh)
        replacements.waiting.append((fresh, place, path))
        alone.put_in_place()


@contextmanager
def _in_words_of(path: Path, fresh: Path) -> Iterator[None]:
    """Reword errors of a temporary path, or of no path, as errors of the output."""
    try:
        yield
    except BrokenPipeError:  # of standard output
        raise
    except OSError as error:
        names = [
            os.fsdecode(n) for n in (error.filename, error.filename2) if n is not None
        ]
        ours = [name for name in names if name.startswith(str(fresh))]
        if names and not ours:
            raise  # of a file that is read
        if error.errno is None:
            raise OSError(str(error).replace(str(fresh), str(path))) from None
        place = (ours or [str(path)])[0].replace(str(fresh), str(path))
        said = f"cannot be written: {str(error.strerror).removeprefix('cannot be written: ')}"
        raise OSError(error.errno, said, place) from None


def _flush(path: Path) -> None:
    """Write what the system still holds of a file or folder to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _exchange(fresh: Path, place: Path) -> None:
    """Exchange what stands at two paths; the second may be empty.

    Raises:
        OSError: They are as before.
    """
    while True:  # until no other process has moved it away or put its own there
        if not place.exists():
            with suppress(FileExistsError, IsADirectoryError):
                fresh.rename(place)
                return
        elif not (number := _exchange_in_one_step(fresh, place)):
            return
        # a file system, or a kernel, that cannot exchange two paths
        elif number in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
            _exchange_in_steps(fresh, place)
            return
        elif number != errno.ENOENT or not fresh.exists():
            raise OSError(number, os.strerror(number))


def _exchange_in_one_step(first: Path, second: Path) -> int:
    """Exchange two paths by renameat2(2); the number of its error, 0 if there is none."""
    rename: Any = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename is None:
        return errno.ENOSYS
    one, other = os.fsencode(first), os.fsencode(second)
    failed = rename(FROM_WORKING_FOLDER, one, FROM_WORKING_FOLDER, other, EXCHANGE)
    return ctypes.get_errno() if failed else 0


def _exchange_in_steps(fresh: Path, place: Path) -> None:
    """Exchange two paths; a folder is away for an instant, a file is not.

    Raises:
        OSError: They are as before, unless that fails, too: then NAME-before-PID is the older one.
    """
    older = place.with_name(f"{place.name}-before-{os.getpid()}")
    try:
        try:
            os.link(place, older)
        except OSError:  # a folder, or a file system without links
            place.rename(older)
        fresh.replace(place)
        older.rename(fresh)
    except BaseException:
        if older.exists():
            if not fresh.exists():
                place.rename(fresh)
            older.replace(place)
            # to rename a link to the same file does nothing
            older.unlink(missing_ok=True)
        raise


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
                raise OSError(
                    f"'{path}' is read, or written twice, by this command; choose another name"
                )
            with _beside(place, path):
                _SEEN.get({})[place] = _state(place)
            kept.add(place)


@contextmanager
def _beside(place: Path, path: Path) -> Iterator[Path]:
    """A temporary folder beside a place, and the folders above it while something is in them.

    Raises:
        OSError: It cannot be made there; in the words of `path`.
    """
    missing = [each for each in place.parents if not each.exists()]
    hidden = place.parent / f"{HIDDEN}{secrets.token_hex(4)}"
    with ExitStack() as left:
        for each in reversed(missing):
            left.callback(_remove_empty, each)
        for _ in range(2):  # once more where Ctrl-C ends the first
            left.callback(shutil.rmtree, hidden, ignore_errors=True)
        try:
            hidden.mkdir(mode=0o700, parents=True)
        except OSError as error:
            raise OSError(
                f"'{path}' may not be written there: {error.strerror}"
            ) from None
        yield hidden


def _remove_empty(folder: Path) -> None:
    """Remove a folder if it is empty."""
    with suppress(OSError):
        folder.rmdir()


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
            # we would be left in one that is none
            if folder and Path.cwd().is_relative_to(place):
                raise ValueError(
                    "it is the working folder or above it; choose another name"
                )
    except (
        OSError
    ) as error:  # a name that is too long, a file among the folders above it
        raise OSError(f"'{path}' cannot be written: {error.strerror}") from None
    except (
        RuntimeError,
        ValueError,
    ) as error:  # of Python: links in a circle, a zero byte
        raise OSError(f"'{path}' cannot be written: {error}") from None
    return place
