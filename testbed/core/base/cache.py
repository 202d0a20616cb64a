"""User's cache folder, for compiled kernels and other files that can be made again."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """Path of testbed's cache folder, which need not exist.

    The folder "testbed" below XDG_CACHE_HOME, else below LOCALAPPDATA, else below ~/.cache.
    """
    home = (
        os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    )
    return Path(os.path.expanduser(home)) / "testbed"  # noqa: PTH111  # also without a home
