"""Columns by name, as other packages' data frames and back."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from testbed.core.base.errors import SettingsError

PACKAGES = {"pandas": "DataFrame", "polars": "DataFrame", "pyarrow": "table"}
"""What makes a frame of columns, by package."""


def frame_of(columns: Mapping[str, Any], package: str | None = None) -> Any:
    """Columns as a data frame of pandas or polars, or as an Arrow table, which both read.

    Args:
        columns: Values by name, (M,) each.
        package: "pandas", "polars" or "pyarrow"; default the first that is installed.

    Raises:
        SettingsError: The package is not installed.
    """
    for name in PACKAGES if package is None else (package,):
        try:
            made = getattr(import_module(name), PACKAGES[name])
        except (ModuleNotFoundError, KeyError):
            continue
        return made(dict(columns))
    raise SettingsError(
        f"data frames are of {', '.join(PACKAGES)}; {package} is not installed"
    )


def columns_of(frame: Any) -> dict[str, Any]:
    """Columns of a data frame of pandas or polars, an Arrow table, or a mapping, by name.

    Args:
        frame: The frame; values of a mapping may have several columns, (M, k).

    Raises:
        SettingsError: It is none of these.
    """
    names = getattr(frame, "column_names", None) or getattr(frame, "columns", None)
    if names is None and isinstance(frame, Mapping):
        names = frame.keys()
    if names is None or callable(names):
        raise SettingsError(
            "a data frame, an Arrow table or a dict of arrays is wanted, not "
            f"{type(frame).__name__}"
        )
    return {str(name): np.asarray(frame[name], dtype=float) for name in names}
