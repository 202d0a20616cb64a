"""Versions of what makes the numbers."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version


def versions() -> dict[str, str]:
    """Versions of Python, testbed and the packages that make the numbers."""
    found = {"python": platform.python_version()}
    for package in ("testbed", "mujoco", "numpy", "scipy", "pin"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
