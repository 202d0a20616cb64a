"""Atomic replacement of files and folders: complete new content, or no change."""

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

TEMPORARY_PREFIX = ".testbed-"
"""Prefix of the names of temporary folders; a killed process leaves its folder behind."""

AT_FDCWD, RENAME_EXCHANGE = -100, 2
"""Constants AT_FDCWD and RENAME_EXCHANGE of renameat2(2)."""


class _Replacements(ExitStack):
    """Complete outputs that are about to replace their targets, and their temporary folders.

    Attributes:
        waiting: Temporary path, resolved target, and path as written by the user, for each output.
    """

    def __init__(self) -> None:
        super().__init__()
        self.waiting: list[tuple[Path, Path, Path]] = []

    def put_in_place(self) -> None:
        """Move all outputs to their targets; undo every move after an error or Ctrl-C.

        Raises:
            OSError: An output cannot be moved, or its target was changed since `check_writable`
                within `refuse_changed_targets`; the message contains the user's path.
        """
        inodes = [temporary.stat().st_ino for temporary, _, _ in self.waiting]
        states = _CHECKED_STATES.get({})
        try:
            for temporary, target, path in self.waiting:
                if states.get(target, state := _file_state(target)) != state:
                    raise OSError(
                        f"'{path}' has been made or changed by something else since this command "
                        "began, and is not replaced; choose another name"
                    )
                with _output_named_in_errors(path, temporary):
                    _exchange(temporary, target)
                states |= {target: _file_state(target)} if target in states else {}
                with suppress(OSError):  # a file system that does not flush folders
                    _flush(target.parent)
        except BaseException:
            for inode, (temporary, target, _) in zip(inodes, self.waiting, strict=True):
                if target.exists() and target.stat().st_ino == inode:
                    _exchange(
                        temporary, target
                    ) if temporary.exists() else target.rename(temporary)
            raise


_CHECKED_STATES: ContextVar[dict[Path, tuple[int, int] | None]] = ContextVar(
    "_CHECKED_STATES"
)
"""States of targets recorded by `check_writable` within a `refuse_changed_targets` block."""


@contextmanager
def refuse_changed_targets() -> Iterator[None]:
    """Context manager that refuses to replace targets changed since `check_writable`.

    A target has changed if its inode or modification time differs, or if it was created or removed.
    Its replacement then raises an OSError.
    """
    token = _CHECKED_STATES.set({})
    try:
        yield
    finally:
        _CHECKED_STATES.reset(token)


def _file_state(target: Path) -> tuple[int, int] | None:
    """Inode and modification time of an existing path; None if it does not exist."""
    status = target.stat() if target.exists() else None
    return status and (status.st_ino, status.st_mtime_ns)


_DELAYED: ContextVar[_Replacements | None] = ContextVar("_DELAYED", default=None)
"""Replacements of the enclosing `replace_together` block; None outside a block."""


@contextmanager
def replace_together() -> Iterator[None]:
    """Context manager that delays the replacements by `atomic_output` until the end of its block.

    At the end, all paths are replaced. After an error in the block or in a replacement, no path is
    replaced.

    Raises:
        OSError: A path cannot be replaced.
    """
    with _Replacements() as replacements:
        token = _DELAYED.set(replacements)
        try:
            yield
        finally:
            _DELAYED.reset(token)
        replacements.put_in_place()


@contextmanager
def atomic_output(path: Path, *, folder: bool = False) -> Iterator[Path]:
    """Context manager with a temporary path that replaces `path` if the block succeeds.

    The content is flushed to the disk before the replacement, which `replace_together` can delay.
    If the file system cannot exchange two folders, the older folder is renamed for a moment.

    Args:
        path: Output; an existing path is replaced only if it is of the same kind.
        folder: True for a folder, False for a file.

    Yields:
        Temporary path that does not exist yet. If the block fails, the temporary path is removed
        and `path` is not changed.

    Raises:
        OSError: The target is of the other kind, is a device, or is not writable; the message
            contains `path`.
    """
    target = _output_path(path, folder)
    with _Replacements() as immediate:
        replacements = _DELAYED.get() or immediate
        temporary = (
            replacements.enter_context(_temporary_folder(target, path)) / "fresh"
        )
        with _output_named_in_errors(path, temporary):
            yield temporary
            for each in (temporary, *temporary.rglob("*")):
                if not each.is_symlink():
                    _flush(each)
            if target.exists():
                shutil.copymode(target, temporary)
        replacements.waiting.append((temporary, target, path))
        immediate.put_in_place()


@contextmanager
def _output_named_in_errors(path: Path, temporary: Path) -> Iterator[None]:
    """Context manager that replaces a temporary path by the output path in messages of OSErrors.

    Errors that concern other files or a broken pipe are raised unchanged.

    Args:
        path: Output, as written by the user.
        temporary: Temporary path of the output.
    """
    try:
        yield
    except BrokenPipeError:  # of standard output
        raise
    except OSError as error:
        names = [
            os.fsdecode(n) for n in (error.filename, error.filename2) if n is not None
        ]
        temporary_names = [name for name in names if name.startswith(str(temporary))]
        if names and not temporary_names:
            raise  # of a file that is read
        if error.errno is None:
            raise OSError(str(error).replace(str(temporary), str(path))) from None
        target = (temporary_names or [str(path)])[0].replace(str(temporary), str(path))
        message = f"cannot be written: {str(error.strerror).removeprefix('cannot be written: ')}"
        raise OSError(error.errno, message, target) from None


def _flush(path: Path) -> None:
    """Flush buffered data of a file or folder to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _exchange(temporary: Path, target: Path) -> None:
    """Exchange two paths; rename the first if the second does not exist.

    Raises:
        OSError: The exchange failed; both paths are unchanged.
    """
    while True:  # repeat while another process moves or makes the target
        if not target.exists():
            with suppress(FileExistsError, IsADirectoryError):
                temporary.rename(target)
                return
        elif not (error_number := _exchange_in_one_step(temporary, target)):
            return
        # a file system, or a kernel, that cannot exchange two paths
        elif error_number in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
            _exchange_in_steps(temporary, target)
            return
        elif error_number != errno.ENOENT or not temporary.exists():
            raise OSError(error_number, os.strerror(error_number))


def _exchange_in_one_step(first: Path, second: Path) -> int:
    """Exchange two paths by renameat2(2); return its error number, or 0 if it succeeds."""
    rename: Any = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename is None:
        return errno.ENOSYS
    first_name, second_name = os.fsencode(first), os.fsencode(second)
    failed = rename(AT_FDCWD, first_name, AT_FDCWD, second_name, RENAME_EXCHANGE)
    return ctypes.get_errno() if failed else 0


def _exchange_in_steps(temporary: Path, target: Path) -> None:
    """Exchange two paths by renaming; for a moment, the target folder does not exist.

    Raises:
        OSError: The exchange failed. Both paths are unchanged unless restoring fails too; in this
            case, NAME-before-PID next to the target NAME has the old content.
    """
    older = target.with_name(f"{target.name}-before-{os.getpid()}")
    try:
        try:
            os.link(target, older)
        except OSError:  # a folder, or a file system without links
            target.rename(older)
        temporary.replace(target)
        older.rename(temporary)
    except BaseException:
        if older.exists():
            if not temporary.exists():
                target.rename(temporary)
            older.replace(target)
            # to rename a link to the same file does nothing
            older.unlink(missing_ok=True)
        raise


def check_writable(
    *paths: Path | None, folder: bool = False, read: Iterable[Path | None] = ()
) -> None:
    """Check before a computation that its outputs can be written.

    A temporary folder is created next to each output and removed again. Within
    `refuse_changed_targets`, the states of the outputs are recorded.

    Args:
        *paths: Outputs; None is skipped.
        folder: True if the outputs are folders, False if they are files.
        read: Inputs, which must not be replaced; None is skipped.

    Raises:
        OSError: An output cannot be written, is an input, or occurs twice.
    """
    protected = {path.resolve() for path in read if path is not None and path.exists()}
    for path in paths:
        if path is not None:
            target = _output_path(path, folder)
            if target in protected:
                raise OSError(
                    f"'{path}' is read, or written twice, by this command; choose another name"
                )
            with _temporary_folder(target, path):
                _CHECKED_STATES.get({})[target] = _file_state(target)
            protected.add(target)


@contextmanager
def _temporary_folder(target: Path, path: Path) -> Iterator[Path]:
    """Context manager with a temporary folder next to an output.

    Missing parent folders are created, and removed again if they remain empty.

    Args:
        target: Resolved path of the output.
        path: Path of the output, as written by the user.

    Raises:
        OSError: The folder cannot be created; the message contains `path`.
    """
    missing = [each for each in target.parents if not each.exists()]
    hidden = target.parent / f"{TEMPORARY_PREFIX}{secrets.token_hex(4)}"
    with ExitStack() as cleanup:
        for each in reversed(missing):
            cleanup.callback(_remove_empty, each)
        for _ in range(2):  # a second time if Ctrl-C ends the first
            cleanup.callback(shutil.rmtree, hidden, ignore_errors=True)
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


def _output_path(path: Path, folder: bool) -> Path:
    """Resolved path of an output: for a link its target, so that links are kept.

    Raises:
        OSError: The path exists and is of another kind, is the working folder or one of its parent
            folders, or cannot be resolved.
    """
    try:
        target = path.resolve()
        with suppress(FileNotFoundError):
            mode = target.stat().st_mode
            if stat.S_ISDIR(mode) is not folder:
                kind = "folder" if stat.S_ISDIR(mode) else "file"
                raise ValueError(f"there is a {kind}; choose another name")
            if not folder and not stat.S_ISREG(mode):
                raise ValueError("it is a device or pipe, no file; choose another name")
            # else the working folder of this process would be replaced
            if folder and Path.cwd().is_relative_to(target):
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
    return target
