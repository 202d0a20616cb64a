"""Atomic writing of small files."""

from __future__ import annotations

from pathlib import Path

from testbed.core.base.files import atomic_output


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write a file atomically: complete content, or no change.

    Args:
        path: The file; an existing file is replaced.
        content: Bytes, or text that is encoded as UTF-8.
    """
    with atomic_output(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
