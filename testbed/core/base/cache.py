"""User's cache folder, for compiled kernels and other files that can be recreated."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """Path of testbed's cache folder, which may not exist yet.

    The folder is named "testbed" and is located in XDG_CACHE_HOME, or if this is not set in
    LOCALAPPDATA, or otherwise in ~/.cache.
    """
    home = (
        os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    )
    return Path(os.path.expanduser(home)) / "testbed"  # noqa: PTH111  # also without a home
