"""Conversion between named columns and data frames of other packages."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from testbed.core.base.errors import SettingsError

FRAME_CLASSES = {"pandas": "DataFrame", "polars": "DataFrame", "pyarrow": "table"}
"""Class or function that creates a data frame from columns, keyed by package."""


def data_frame(columns: Mapping[str, Any], package: str | None = None) -> Any:
    """Data frame of pandas or polars, or Arrow table, created from columns.

    Args:
        columns: Values keyed by column name, (M,) each.
        package: "pandas", "polars" or "pyarrow"; by default the first of these that is installed.

    Raises:
        SettingsError: The package is not installed.
    """
    for name in FRAME_CLASSES if package is None else (package,):
        try:
            make_frame = getattr(import_module(name), FRAME_CLASSES[name])
        except (ModuleNotFoundError, KeyError):
            continue
        return make_frame(dict(columns))
    raise SettingsError(
        f"data frames are of {', '.join(FRAME_CLASSES)}; {package} is not installed"
    )


def frame_columns(frame: Any) -> dict[str, Any]:
    """Columns of a data frame, an Arrow table or a mapping, keyed by name.

    Args:
        frame: Data frame of pandas or polars, Arrow table, or mapping; the values of a mapping may
            have several columns, (M, k).

    Returns:
        Arrays of float64, keyed by column name.

    Raises:
        SettingsError: The frame is of another type.
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
