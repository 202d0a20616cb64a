"""Versions of what makes the numbers, and where those of a written file come from."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from testbed.files import fingerprint
from testbed.installation import version as own_version

if TYPE_CHECKING:
    from testbed.identification.consistency.consistent import Consistent
    from testbed.robot.model_file import ModelFile

DIGITS = 16
"""Of a fingerprint, in a comment."""


def versions() -> dict[str, str]:
    """Versions of Python, testbed and the packages that make the numbers."""
    found = {"python": platform.python_version(), "testbed": own_version()}
    for package in ("mujoco", "numpy", "scipy", "pin"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def provenance(found: Consistent, model: ModelFile, recordings: Sequence[Path]) -> list[str]:
    """Where the numbers of a written file come from, for a comment.

    Args:
        found: What is written.
        model: The file that is copied.
        recordings: What it was identified from.
    """
    methods = " and ".join(each.method for each in found.bent)
    return [
        f"testbed {versions()['testbed']}: inertials and joint losses are physically consistent",
        f"ones by the {methods} method from",
        *(f"{each.name} (sha256 {fingerprint(each)[:DIGITS]})," for each in recordings),
        f"prior {model.path.name} (sha256",
        f"{fingerprint(model.path)[:DIGITS]}) taken to be wrong by {found.prior_error:g}; all else",
        "is that file, unchanged",
    ]
