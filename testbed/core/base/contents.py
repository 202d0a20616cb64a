"""Contents of files: texts of a bounded size, and fingerprints."""

from __future__ import annotations

import hashlib
from pathlib import Path


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
        raise OSError(
            f"'{path}' has {size} bytes; what is expected there has at most {most}"
        )
    return path.read_text(encoding="utf-8", errors="replace")


def fingerprint(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
