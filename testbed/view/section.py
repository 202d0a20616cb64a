"""Sections with tables and panels: contents of results for terminal, HTML page and Rerun viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from testbed.view.figures import Panel


@dataclass(frozen=True)
class Table:
    """Table of texts, with column heads and a title.

    Attributes:
        heads: Heads of the columns; the first column contains the names of the rows.
        rows: Rows, one cell per column.
        title: Title above the table.
        left: Heads of further left-aligned columns; the first column is always left-aligned.
        parts: Groups of columns, without the first column, that become separate tables if the table
            is too wide.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    left: Sequence[str] = ()
    parts: Sequence[Sequence[int]] = ()

    @staticmethod
    def from_columns(
        columns: Mapping[str, Sequence[str]],
        title: str = "",
        left: Sequence[str] = (),
        parts: Sequence[Sequence[int]] = (),
    ) -> Table:
        """Build a table from columns of equal length.

        Args:
            columns: Cells of the columns, keyed by head.
            title: Title above the table.
            left: Heads of left-aligned columns.
            parts: Groups of columns that become separate tables if the table is too wide.
        """
        rows = list(zip(*columns.values(), strict=True))
        return Table([*columns], rows, title, left, parts)

    @property
    def split(self) -> list[Table]:
        """Separate tables for the groups of columns in `parts`, each with the first column.

        If there are no groups, the result is one table with all columns.
        """
        tables = []
        for part in self.parts or [range(1, len(self.heads))]:
            heads, *rows = (
                [line[0], *(line[k] for k in part)] for line in (self.heads, *self.rows)
            )
            tables.append(Table(heads, rows, self.title, self.left))
        return tables

    @property
    def markdown(self) -> str:
        """Markdown text of the table without its title, for the Rerun viewer.

        Vertical bars in cells are replaced by slashes, and +- by ±.
        """
        lines = [self.heads, ["---"] * len(self.heads), *self.rows]
        cells = (
            [cell.replace("|", "/").replace("+-", "±") for cell in line]
            for line in lines
        )
        return "\n".join(f"| {' | '.join(line)} |" for line in cells)


@dataclass(frozen=True, eq=False, kw_only=True)
class Section:
    """Part of a result: explanation, panels and table.

    Attributes:
        id: Anchor on a page.
        title: Title of the section.
        explanation: Explanation of the panels in a few sentences.
        legend: Labels of the curves, keyed by kind.
        panels: Plots of the section.
        shown: Number of panels that are visible without unfolding; None for all.
        caption: Caption below the panels.
        table: Table with the numbers behind the panels.
    """

    id: str
    title: str
    explanation: str
    legend: Mapping[str, str] = field(default_factory=dict)
    panels: Sequence[Panel] = ()
    shown: int | None = None
    caption: str = ""
    table: Table
