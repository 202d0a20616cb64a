"""A result as people see it, once: sections with tables, for terminal, page and Rerun's viewer."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import round_significant
from testbed.view.figures import Panel

DARKEST = 48
"""Part of the colour in the darkest cell, on which text can still be read [%]."""


@dataclass(frozen=True)
class Table:
    """Words in rows and columns.

    Attributes:
        heads: Of the columns; the first names the rows.
        rows: A cell a column.
        title: Above it.
        left: Heads of columns of words, which begin at the left as the first does.
        parts: Columns, the first apart, that stand together where not all have room.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    left: Sequence[str] = ()
    parts: Sequence[Sequence[int]] = ()

    @property
    def split(self) -> list[Table]:
        """A table for each part."""
        found = []
        for part in self.parts or [range(1, len(self.heads))]:
            heads, *rows = (
                [line[0], *(line[k] for k in part)] for line in (self.heads, *self.rows)
            )
            found.append(Table(heads, rows, self.title, self.left))
        return found

    @property
    def markdown(self) -> str:
        """As Rerun's viewer shows it."""
        lines = [self.heads, ["---"] * len(self.heads), *self.rows]
        cells = ([cell.replace("|", "/").replace("+-", "±") for cell in line] for line in lines)
        return "\n".join(f"| {' | '.join(line)} |" for line in cells)


@dataclass(frozen=True)
class HeatTable:
    """A table with cells from light to dark.

    Attributes:
        caption: What is shown.
        names: Of the columns.
        rows: Their names, and of every cell its text and how dark it is [%].
    """

    caption: str
    names: Sequence[str]
    rows: Sequence[tuple[str, Sequence[Mapping[str, Any]]]]

    @classmethod
    def of_shares(
        cls, caption: str, rows: Sequence[str], columns: Sequence[str], values: Array, shares: Array
    ) -> HeatTable:
        """Values on a colour scale.

        Args:
            caption: What is shown.
            rows: Their names, (m,).
            columns: Their names, (n,).
            values: (m, n); not a number where there is none.
            shares: Darkness of the cells from 0 to 1, (m, n).
        """
        percents = np.rint(DARKEST * np.clip(np.nan_to_num(shares), 0.0, 1.0)).astype(int)
        shown = []
        for name, row, dark in zip(rows, values.tolist(), percents.tolist(), strict=True):
            texts = ("" if math.isnan(x) else f"{round_significant(x, 2):g}" for x in row)
            shown.append(
                (name, [{"text": t, "share": s} for t, s in zip(texts, dark, strict=True)])
            )
        return cls(caption, columns, shown)


@dataclass(frozen=True, eq=False, kw_only=True)
class Section:
    """A part of a result: what it says, drawn and as a table.

    Attributes:
        id: Its place on a page.
        title: Above it.
        says: What there is to see, in a few sentences.
        legend: What curves are, by their kind.
        panels: Drawings.
        heats: Tables with cells from light to dark.
        shown: How many of these are not folded away; None for all.
        caption: Below them.
        table: The same in numbers.
    """

    id: str
    title: str
    says: str
    legend: Mapping[str, str] = field(default_factory=dict)
    panels: Sequence[Panel] = ()
    heats: Sequence[HeatTable] = ()
    shown: int | None = None
    caption: str = ""
    table: Table
