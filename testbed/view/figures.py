"""Panels: what a figure shows, before anything is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array

MAX_ROWS, COLUMNS = 9, 3
"""Named rows above which a figure is split, and into how many panels."""

OFFSET = 0.32
"""Between the points of a row [rows]."""

# x and y by kind: measured, external, internal
Curves = Mapping[Any, tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Panel:
    """A small plot, or several over one horizontal axis.

    Attributes:
        title: Quantity with its unit.
        curves: By kind: "measured", "external" or "internal".
        x_label: Quantity on the horizontal axis, with its unit.
        log: Whether both axes are logarithmic; of named rows the horizontal one.
        points: Kinds that are drawn as points.
        bars: Ends of the horizontal bars of points, by kind.
        bands: Half widths of the bands around lines, by kind.
        names: Labels of the rows 0, 1, ... from the top; () for a vertical axis of numbers.
        limits: Of the horizontal axis; None for those of the curves.
        line: Reference value, a vertical line.
        from_zero: Whether the vertical axis begins at zero.
        below: Curves of further plots, by title.
    """

    title: str
    curves: Curves
    x_label: str
    log: bool = False
    points: tuple[str, ...] = ()
    bars: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    bands: Mapping[str, Array] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    limits: tuple[float, float] | None = None
    line: float | None = None
    from_zero: bool = False
    below: Mapping[str, Curves] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Description for readers who do not see the drawing."""
        rows = [f"{self.names[0]} to {self.names[-1]}"] if self.names else []
        shown = [words for words in (self.title, *rows, *self.below) if words]
        return f"{', '.join(shown)} over {self.x_label}"


def thinned(x: Array, y: Array, most: int = 1000) -> tuple[Array, Array]:
    """At most so many points of a curve, evenly taken."""
    step = max(1, -(-len(x) // most))
    return x[::step], y[::step]


def decades(values: Array) -> tuple[float, float]:
    """Powers of ten around all positive finite values."""
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
    """Points by name, a row each.

    Args:
        title: Of the panel.
        names: Of the rows, (p,).
        values: By kind, (p,); not a number where a row has none.
        x_label: Quantity and unit of the values.
        bars: Ends of bars by kind, (p,) each.
        line: Reference value.
        log: Whether the horizontal axis is logarithmic.
    """
    bars = bars or {}
    offsets = OFFSET * (np.arange(len(values)) - (len(values) - 1) / 2)
    rows = np.arange(len(names), dtype=float)
    curves = {
        kind: (each, rows + offset)
        for (kind, each), offset in zip(values.items(), offsets, strict=True)
    }
    ends = [end for pair in bars.values() for end in pair]
    drawn = np.concatenate([*values.values(), *ends, [] if line is None else [line]])
    return Panel(
        title,
        curves,
        x_label,
        log=log,
        points=tuple(values),
        bars=bars,
        names=tuple(names),
        limits=decades(drawn) if log else _padded(drawn),
        line=line,
    )


def _padded(values: Array) -> tuple[float, float]:
    """Least and largest finite value, with a margin."""
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
    """Points by name, a row each; many rows in several panels of one scale.

    Args are those of `named_panel`.
    """
    whole = named_panel(title, names, values, x_label, **options)
    count = COLUMNS if len(names) > MAX_ROWS else 1
    return [_part(whole, rows) for rows in np.array_split(np.arange(len(names)), count)]


def _part(panel: Panel, rows: NDArray[np.intp]) -> Panel:
    """Some rows of a panel."""
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
