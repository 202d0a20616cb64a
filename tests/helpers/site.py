"""The documentation's site, built."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.paths import ROOT


def built(folder: Path) -> Path:
    """The folder of a site that is built strictly; skipped without what builds it."""
    for library in ("zensical", "latex2mathml"):
        if find_spec(library) is None:
            pytest.skip(f"no {library}: pip install '.[docs]'")
    from docs.site import main

    return main(folder).parent


def navigation() -> Iterator[str]:
    """Pages that the navigation leads to."""

    def inside(entry: Any) -> Iterator[str]:
        if isinstance(entry, str):
            yield entry
        else:
            for each in entry.values() if isinstance(entry, dict) else entry:
                yield from inside(each)

    return inside(tomllib.loads((ROOT / "zensical.toml").read_text())["project"]["nav"])
