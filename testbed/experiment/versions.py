"""Versions of what makes the numbers."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

from testbed.installation import version as own_version


def versions() -> dict[str, str]:
    """Versions of Python, testbed and the packages that make the numbers."""
    found = {"python": platform.python_version(), "testbed": own_version()}
    for package in ("mujoco", "numpy", "scipy", "pin"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
