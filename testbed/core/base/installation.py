"""Name and version of the installed distribution, and the files shipped with it."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as _version
from pathlib import Path, PurePath

DISTRIBUTION = "bedplate"
"""Name of the distribution on PyPI; "testbed" is the name of another project there."""

_PACKAGE_FOLDER = Path(__file__).parents[2]
_SHIPPED_ROOTS = (_PACKAGE_FOLDER / "shipped", _PACKAGE_FOLDER.parent)
"""Folders of the shipped files: in an installed package, or next to the package in a clone."""


def installed_version() -> str:
    """Version of the installed distribution, or "not installed" when run from a source tree."""
    try:
        return _version(DISTRIBUTION)
    except PackageNotFoundError:
        return "not installed"


__version__ = installed_version()


def package_versions() -> dict[str, str]:
    """Versions of Python, testbed and the numerical packages, keyed by name."""
    by_package = {"python": platform.python_version(), "testbed": installed_version()}
    for package in ("mujoco", "numpy", "scipy", "pin"):
        try:
            by_package[package] = _version(package)
        except PackageNotFoundError:
            by_package[package] = "not installed"
    return by_package


def shipped(name: str | Path) -> Path:
    """Path of a model file or an experiment file that is shipped with testbed.

    Args:
        name: Path such as "models/puma562.xml" or "experiments/table6.toml"; or a short name such
            as "puma562.xml", "table6", "campaigns/coverage".

    Returns:
        Path of the file.

    Raises:
        FileNotFoundError: No shipped file has this name.
    """
    for root in _SHIPPED_ROOTS:
        for path in _candidate_paths(root, PurePath(name)):
            if path.is_file():
                return path
    raise FileNotFoundError(f"testbed comes with no file '{name}'")


def user_or_shipped_file(name: str | Path) -> Path:
    """Path of the user's file if it exists, otherwise of the shipped file, or `name`."""
    own = Path(name)
    if own.exists():
        return own
    try:
        return shipped(name)
    except FileNotFoundError:
        return own


def _candidate_paths(root: Path, name: PurePath) -> list[Path]:
    """Candidate paths of a shipped file; empty for absolute paths and paths with "..".

    Paths that begin with models/ or experiments/ are used unchanged. Other names are tried in this
    order: experiments/NAME.toml, experiments/NAME, models/NAME.

    Args:
        root: Folder that contains models/ and experiments/.
        name: Path or short name of the file.
    """
    if name.is_absolute() or ".." in name.parts or not name.parts:
        return []
    if name.parts[0] in {"models", "experiments"}:
        return [root / name]
    return [
        root / "experiments" / f"{name}.toml",
        root / "experiments" / name,
        root / "models" / name,
    ]
