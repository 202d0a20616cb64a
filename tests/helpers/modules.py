"""Modules of the package and their syntax trees, each parsed once."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from tests.helpers.paths import ROOT

HOUSE = ROOT / "testbed"


def module_name(path: Path) -> str:
    """Dotted name of a module of the package."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


MODULES = {module_name(path): path for path in sorted(HOUSE.rglob("*.py"))}
"""File of every module, by its dotted name."""


@cache
def syntax(module: str) -> ast.Module:
    """Syntax tree of a module of the package."""
    return ast.parse(MODULES[module].read_text("utf-8"))
