"""What is installed: the distribution's name and version, and the files that came with it."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as _version
from pathlib import Path, PurePath

DISTRIBUTION = "bedplate"
"""The name under which testbed is packaged; that name itself is another project's."""

_HOME = Path(__file__).parents[2]
_PLACES = (_HOME / "shipped", _HOME.parent)
"""Where what ships stands: inside an installed package, beside it in a clone."""


def version() -> str:
    """The version that is installed; "not installed" where the source is used as it lies."""
    try:
        return _version(DISTRIBUTION)
    except PackageNotFoundError:
        return "not installed"


__version__ = version()


def versions() -> dict[str, str]:
    """Versions of Python, testbed and the packages that make the numbers."""
    found = {"python": platform.python_version(), "testbed": version()}
    for package in ("mujoco", "numpy", "scipy", "pin"):
        try:
            found[package] = _version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def shipped(name: str | Path) -> Path:
    """A model or an experiment that came with testbed.

    Args:
        name: As "models/puma562.xml", "experiments/table6.toml"; or short, as "puma562.xml",
            "table6", "campaigns/coverage".

    Returns:
        Its file.

    Raises:
        FileNotFoundError: There is none of that name.
    """
    for place in _PLACES:
        for found in _meant(place, PurePath(name)):
            if found.is_file():
                return found
    raise FileNotFoundError(f"testbed comes with no file '{name}'")


def own_or_shipped(name: str | Path) -> Path:
    """A person's own file, or where there is none the one that came with testbed; else `name`."""
    own = Path(name)
    if own.exists():
        return own
    try:
        return shipped(name)
    except FileNotFoundError:
        return own


def _meant(place: Path, name: PurePath) -> list[Path]:
    """Which files a name may mean; none outside the folders that ship."""
    if name.is_absolute() or ".." in name.parts or not name.parts:
        return []
    if name.parts[0] in {"models", "experiments"}:
        return [place / name]
    return [
        place / "experiments" / f"{name}.toml",
        place / "experiments" / name,
        place / "models" / name,
    ]
