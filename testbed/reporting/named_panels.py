"""Values by name, a row each: many in several plots on one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from testbed.arrays import Array
from testbed.reporting.figures import Panel, text_width

MOST_ROWS = 9
"""Named rows from which they stand in several plots."""
COLUMNS = 3
"""Plots beside each other on a wide page."""
APART = 0.32
"""Of points in one row, in rows."""
LEAST_ROOM = 5e-3
"""Beside values that are nearly equal, part of their size."""


def named_panels(
    title: str,
    names: Sequence[str],
    values: Mapping[str, Array],
    x_label: str,
    *,
    bars: Mapping[str, tuple[Array, Array]] | None = None,
    pale: bool = False,
    line: float | None = None,
    log: bool = False,
) -> list[Panel]:
    """Values by name, a row each; many in several plots on one scale.

    Args:
        title: What is shown.
        names: (p,).
        values: By what they are, (p,).
        x_label: Of the values, with unit.
        bars: Ends of bars, by what they are of, (p,) each.
        pale: Bars are broad and pale, as those that begin at the axis.
        line: What the values are held against.
        log: Logarithmic; values that are no numbers above zero are not drawn.
    """
    bars = bars or {}
    every = np.concatenate([*values.values(), *(end for pair in bars.values() for end in pair)])
    every = np.append(every, [] if line is None else line)
    every = every[np.isfinite(every) & ((every > 0) | (not log))]
    low, high = (float(every.min()), float(every.max())) if every.size else (0.1, 1.0)
    if log:
        low, high = 10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high))
        limits = (low, max(high, 10 * low))
    else:
        room = max(0.04 * (high - low), LEAST_ROOM * max(abs(low), abs(high))) or 1.0
        limits = (low - room, high + room)
    panels = []
    count = COLUMNS if len(names) > MOST_ROWS else 1
    for part in np.array_split(np.arange(len(names)), count):
        rows = np.arange(len(part), dtype=float)
        curves = {
            kind: (each[part], rows + APART * (k - (len(values) - 1) / 2))
            for k, (kind, each) in enumerate(values.items())
        }
        if line is not None:
            curves["measured"] = np.array([line, line]), np.array([-0.5, len(part) - 0.5])
        panels.append(
            Panel(
                title,
                curves,
                x_label,
                log=log,
                points=tuple(values),
                bars={kind: (low[part], high[part]) for kind, (low, high) in bars.items()},
                pale=pale,
                names=tuple(names[k] for k in part),
                room=max(map(text_width, names)),
                limits=limits,
            )
        )
    return panels
