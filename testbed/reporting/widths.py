"""Tables as wide as the terminal allows; no number is ever cut off."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console
from rich.table import Table


def first_that_fits(console: Console, layouts: Iterable[list[Table]]) -> list[Table]:
    """The first of some layouts whose tables all fit; the last one where none does.

    Args:
        console: Where the tables are to be printed.
        layouts: From wide to narrow, at least one; made only as far as they are needed.
    """
    free = console.options.update(max_width=10_000)
    tables: list[Table] = []
    for tables in layouts:
        if all(console.measure(table, options=free).maximum <= console.width for table in tables):
            break
    return tables
