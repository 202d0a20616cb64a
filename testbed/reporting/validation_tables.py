"""Validations as tables for the terminal. No number is ever cut off: the table splits instead."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from testbed.arrays import Array
from testbed.errors import printable
from testbed.reporting.widths import first_that_fits

if TYPE_CHECKING:
    from testbed.identification.validate import Validation

_NAME = 12
"""Columns that are left to a channel's name, at least, when it gives way."""

_PARTS = (("unit", "residual", "of signal", "mean"), ("noise", "sigma adds", "ratio", "rows"))
"""Columns beside the channel's name, where all do not fit beside each other."""


def validation_tables(console: Console, found: Validation) -> list[Table]:
    """What an estimate leaves of another recording: one table, or two where that is too wide.

    Args:
        console: Where it is to be printed.
        found: By one method.
    """
    whole = (tuple(head for part in _PARTS for head in part),)
    layouts = ((whole, None), (_PARTS, None), (_PARTS, console.width))
    return first_that_fits(
        console, ([_table(found, heads, width) for heads in parts] for parts, width in layouts)
    )


def _table(found: Validation, heads: tuple[str, ...], width: int | None) -> Table:
    """Some columns of a validation; the channels' names are folded into a width, if any."""
    columns = {head: _cells(found, head) for head in heads}
    taken = sum(max(len(head), *map(len, cells)) + 2 for head, cells in columns.items())
    room = None if width is None else max(_NAME, width - taken - 4)
    table = Table(
        title=f"{found.method}, on another recording",
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
    )
    table.add_column("channel", overflow="fold", max_width=room, no_wrap=room is None)
    for head in heads:
        table.add_column(head, justify="left" if head == "unit" else "right", no_wrap=True)
    for name, *cells in zip(found.channels, *columns.values(), strict=True):
        table.add_row(printable(name), *cells)
    return table


def _cells(found: Validation, head: str) -> list[str]:
    """One column."""
    if head == "unit":
        return list(found.units)
    if head == "rows":
        return [str(rows) for rows in found.rows]
    if head == "of signal":
        return [_text(100 * share, " %") for share in found.relative_residual]
    numbers: dict[str, Array] = {
        "residual": found.residual,
        "mean": found.mean,
        "noise": found.noise,
        "sigma adds": found.spread,
        "ratio": found.ratio,
    }
    return [_text(number) for number in numbers[head]]


def _text(number: float, unit: str = "") -> str:
    return "-" if np.isnan(number) else f"{number:.3g}{unit}"
