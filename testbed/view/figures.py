"""Panels: contents of plots, independent of the drawing library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array

MAX_ROWS, SPLIT_PANEL_COUNT = 9, 3
"""Largest number of named rows in one panel, and number of panels for more rows."""

POINT_SPACING = 0.32
"""Vertical distance between the points of a row [rows]."""

# x and y by kind: measured, wrench, torque
Curves = Mapping[Any, tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Panel:
    """Plot, or several plots above each other with a common horizontal axis.

    Attributes:
        title: Quantity on the vertical axis, with its unit.
        curves: Curves (x, y), (M,) each, keyed by kind: "measured", "wrench" or "torque".
        x_label: Quantity on the horizontal axis, with its unit.
        log_scale: True for logarithmic axes; with named rows, only the horizontal axis is
            logarithmic.
        points: Kinds of curves that are drawn as points.
        bars: Left and right ends of horizontal error bars, keyed by kind.
        bands: Half widths of bands around lines, keyed by kind.
        names: Labels of the rows 0, 1, ... from the top; () for a numeric vertical axis.
        limits: Limits of the horizontal axis; None for the range of the curves.
        reference_value: Position of a vertical reference line; None without a line.
        from_zero: True if the vertical axis begins at zero.
        lower_plots: Curves of the lower plots, keyed by title.
    """

    title: str
    curves: Curves
    x_label: str
    log_scale: bool = False
    points: tuple[str, ...] = ()
    bars: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    bands: Mapping[str, Array] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    limits: tuple[float, float] | None = None
    reference_value: float | None = None
    from_zero: bool = False
    lower_plots: Mapping[str, Curves] = field(default_factory=dict)

    @property
    def text_alternative(self) -> str:
        """Text that describes the drawing: titles, range of row names, horizontal axis."""
        rows = [f"{self.names[0]} to {self.names[-1]}"] if self.names else []
        parts = [words for words in (self.title, *rows, *self.lower_plots) if words]
        return f"{', '.join(parts)} over {self.x_label}"


def subsampled_curve(x: Array, y: Array, max_points: int = 1000) -> tuple[Array, Array]:
    """Points of a curve at equal index steps, limited to `max_points` points.

    The smallest possible step is used, and the first point is included.

    Args:
        x: Horizontal coordinates, (M,).
        y: Vertical coordinates, (M,).
        max_points: Largest number of points.
    """
    step = max(1, -(-len(x) // max_points))
    return x[::step], y[::step]


def enclosing_decades(values: Array) -> tuple[float, float]:
    """Powers of ten below and above all positive finite values.

    The range covers at least one decade; it is (0.1, 1) if no value is positive and finite.
    """
    powers = np.log10(values[np.isfinite(values) & (values > 0)])
    if not powers.size:
        return 0.1, 1.0
    low, high = np.floor(powers.min()), np.ceil(powers.max())
    return float(10.0**low), float(10.0 ** max(high, low + 1))


def named_panel(
    title: str,
    names: Sequence[str],
    values: Mapping[str, Array],
    x_label: str,
    *,
    bars: Mapping[str, tuple[Array, Array]] | None = None,
    line: float | None = None,
    log: bool = False,
) -> Panel:
    """Panel with one row per name, and in each row one point per kind.

    The points of a row are `POINT_SPACING` rows apart. The horizontal axis includes values, bars
    and reference line; it covers whole decades if logarithmic, otherwise the range with a margin of
    4 %.

    Args:
        title: Title of the panel.
        names: Labels of the rows, (p,).
        values: Values keyed by kind, (p,) each; nan is not drawn.
        x_label: Quantity and unit of the values.
        bars: Left and right ends of error bars, keyed by kind, (p,) each.
        line: Reference value, drawn as a vertical line; None for no line.
        log: True for a logarithmic horizontal axis.
    """
    bars = bars or {}
    offsets = POINT_SPACING * (np.arange(len(values)) - (len(values) - 1) / 2)
    rows = np.arange(len(names), dtype=float)
    curves = {
        kind: (points, rows + offset)
        for (kind, points), offset in zip(values.items(), offsets, strict=True)
    }
    ends = [end for pair in bars.values() for end in pair]
    drawn_values = np.concatenate(
        [*values.values(), *ends, [] if line is None else [line]]
    )
    return Panel(
        title,
        curves,
        x_label,
        log_scale=log,
        points=tuple(values),
        bars=bars,
        names=tuple(names),
        limits=enclosing_decades(drawn_values) if log else _padded_range(drawn_values),
        reference_value=line,
    )


def _padded_range(values: Array) -> tuple[float, float]:
    """Smallest and largest finite value, extended by a margin of 4 % on both sides.

    The margin is 1 if all values are equal. If no value is finite, the range is that of 0 and 1.
    """
    finite = values[np.isfinite(values)]
    low, high = (
        (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    )
    margin = 0.04 * (high - low) or 1.0
    return low - margin, high + margin


def named_panels(
    title: str,
    names: Sequence[str],
    values: Mapping[str, Array],
    x_label: str,
    **options: Any,
) -> list[Panel]:
    """Panels made by `named_panel`, with long lists of rows split over three panels.

    Lists of more than `MAX_ROWS` (9) rows are split. All panels have the same horizontal axis. The
    arguments are those of `named_panel`.
    """
    panel = named_panel(title, names, values, x_label, **options)
    count = SPLIT_PANEL_COUNT if len(names) > MAX_ROWS else 1
    return [
        _panel_rows(panel, rows)
        for rows in np.array_split(np.arange(len(names)), count)
    ]


def _panel_rows(panel: Panel, rows: NDArray[np.intp]) -> Panel:
    """Copy of a panel with a range of its rows, renumbered from zero.

    Args:
        panel: Panel with named rows.
        rows: Indices of consecutive rows.
    """
    return replace(
        panel,
        curves={
            kind: (x[rows], y[rows] - rows[0]) for kind, (x, y) in panel.curves.items()
        },
        bars={
            kind: (low[rows], high[rows]) for kind, (low, high) in panel.bars.items()
        },
        names=tuple(panel.names[k] for k in rows),
    )
