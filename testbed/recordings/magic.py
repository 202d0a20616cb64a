"""What a file is, by its first bytes."""

from __future__ import annotations

from pathlib import Path


def is_parquet(path: Path) -> bool:
    """Whether the file begins as Parquet files do."""
    with path.open("rb") as stream:
        return stream.read(4) == b"PAR1"
