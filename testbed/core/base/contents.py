"""Text of files up to a maximum size, and SHA-256 digests."""

from __future__ import annotations

import hashlib
from pathlib import Path


def read_text(path: Path, max_bytes: int) -> str:
    """Read a text file, with replacement characters for bytes that are not UTF-8.

    Args:
        path: The file.
        max_bytes: Largest permitted size.

    Raises:
        OSError: The path is not a file, or the file is not readable or too large.
    """
    if not path.is_file():  # opening a pipe would wait for its writer
        raise OSError(f"'{path}' is no file")
    size = path.stat().st_size
    if size > max_bytes:
        raise OSError(
            f"'{path}' has {size} bytes; what is expected there has at most {max_bytes}"
        )
    return path.read_text(encoding="utf-8", errors="replace")


def sha256_of_file(path: Path) -> str:
    """SHA-256 digest of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
