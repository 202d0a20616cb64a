"""Files appear whole or not at all."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, renamed to it if the block succeeds.

    Yields:
        A path that does not exist yet, for a file or a folder. If the block fails,
        whatever it wrote there is removed and `path` is left as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    nest = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        fresh = nest / path.name
        yield fresh
        if path.is_dir():
            path.rename(nest / "old")  # a folder cannot be renamed over a full one
        fresh.replace(path)
    finally:
        shutil.rmtree(nest, ignore_errors=True)


def fingerprint(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
