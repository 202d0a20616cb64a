"""Files that are there whole or not at all."""

from __future__ import annotations

from pathlib import Path

from testbed.core.base.files import replacing


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file that is there whole or not at all.

    Args:
        path: The file; what stands there is replaced.
        content: Bytes, or text for UTF-8.
    """
    with replacing(path) as fresh:
        fresh.write_bytes(content.encode() if isinstance(content, str) else content)
