"""A result as people see it, once: sections with tables, for terminal, page and Rerun's viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from testbed.view.figures import Panel


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

    @staticmethod
    def of(
        columns: Mapping[str, Sequence[str]],
        title: str = "",
        left: Sequence[str] = (),
        parts: Sequence[Sequence[int]] = (),
    ) -> Table:
        """Table of columns of equal length, by their heads."""
        rows = list(zip(*columns.values(), strict=True))
        return Table([*columns], rows, title, left, parts)

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
        cells = (
            [cell.replace("|", "/").replace("+-", "±") for cell in line]
            for line in lines
        )
        return "\n".join(f"| {' | '.join(line)} |" for line in cells)


@dataclass(frozen=True, eq=False, kw_only=True)
class Section:
    """A part of a result: what it says, drawn and as a table.

    Attributes:
        id: Its place on a page.
        title: Above it.
        says: What there is to see, in a few sentences.
        legend: What curves are, by their kind.
        panels: Drawings.
        shown: How many of these are not folded away; None for all.
        caption: Below them.
        table: The same in numbers.
    """

    id: str
    title: str
    says: str
    legend: Mapping[str, str] = field(default_factory=dict)
    panels: Sequence[Panel] = ()
    shown: int | None = None
    caption: str = ""
    table: Table
