"""Files appear whole or not at all."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path, *, folder: bool = False) -> Iterator[Path]:
    """A temporary path beside `path`, renamed to it if the block succeeds.

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
    shown, path = path, path.resolve()  # a link stays, what it points to is replaced
    if path.exists() and path.is_dir() is not folder:
        raise OSError(
            f"'{shown}' is a {'folder' if path.is_dir() else 'file'}; choose another name"
        )
    if path.exists() and not folder and not path.is_file():
        raise OSError(f"'{shown}' is a device or pipe, not a file; choose another name")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        nest = Path(tempfile.mkdtemp(prefix=".testbed-", dir=path.parent))
    except OSError as error:
        raise OSError(f"'{shown}' may not be written there: {error.strerror}") from None
    try:
        fresh = nest / "fresh"
        yield fresh
        if folder and path.exists():  # a folder cannot be renamed over a full one
            path.rename(nest / "old")
            try:
                fresh.rename(path)
            except OSError:
                (nest / "old").rename(path)
                raise
        else:
            fresh.replace(path)
    finally:
        shutil.rmtree(nest, ignore_errors=True)


def fingerprint(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
