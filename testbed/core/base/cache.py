"""The user's cache folder: compiled kernels and other files that can be made again."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """The user's cache folder of testbed, below XDG_CACHE_HOME or ~/.cache; it need not exist."""
    home = (
        os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    )
    return Path(os.path.expanduser(home)) / "testbed"  # noqa: PTH111  # where there is no home, too
