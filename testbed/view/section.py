"""Sections with tables and panels: contents of results for terminal, HTML page and Rerun viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from testbed.view.figures import Panel


@dataclass(frozen=True)
class Table:
    """Table of texts with column heads and a title.

    Attributes:
        heads: Heads of the columns; the first column contains the names of the rows.
        rows: Rows, one cell per column.
        title: Title above the table.
        left: Heads of left-aligned columns of words; the first column is always left-aligned.
        parts: Groups of columns, without the first, that become separate tables in little width.
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
            columns: Cells of the columns by head.
            title: Title above the table.
            left: Heads of left-aligned columns of words.
            parts: Groups of columns that become separate tables in little width.
        """
        rows = list(zip(*columns.values(), strict=True))
        return Table([*columns], rows, title, left, parts)

    @property
    def split(self) -> list[Table]:
        """Tables of the groups of columns in `parts`, each with the first column.

        Without groups, one table with all columns.
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
        """Markdown text of the table without title, for the Rerun viewer.

        A vertical bar in a cell becomes a slash, and +- becomes ±.
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
        legend: Labels of the curves, by kind.
        panels: Plots.
        shown: Number of panels that are not folded away; None for all.
        caption: Caption below the panels.
        table: Numbers of the panels.
    """

    id: str
    title: str
    explanation: str
    legend: Mapping[str, str] = field(default_factory=dict)
    panels: Sequence[Panel] = ()
    shown: int | None = None
    caption: str = ""
    table: Table
