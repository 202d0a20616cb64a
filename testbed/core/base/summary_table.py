"""Values as short tables: in a terminal, in a notebook."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from html import escape
from typing import Any, Self, cast

from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnknownName

MOST_ROWS = 40
"""Rows that are printed; of more, how many are left out is said."""


@dataclass(frozen=True)
class SummaryTable:
    """Text of a value.

    Attributes:
        head: What it is.
        rows: Cells of each row, as many in all; the first is a name.
        notes: What to be careful about.
    """

    head: str
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def short(self) -> SummaryTable:
        """Its first rows, as many as a screen has room for."""
        more = len(self.rows) - MOST_ROWS
        if more <= 0:
            return self
        return SummaryTable(
            self.head, self.rows[:MOST_ROWS], (f"... and {more} more", *self.notes)
        )

    def text(self) -> str:
        """A line each: head, rows in columns, notes."""
        columns = []
        for k, column in enumerate(zip(*self.rows, strict=True)):
            width = max(map(len, column))
            side = ">" if k == 1 < len(self.rows[0]) - 1 else "<"
            columns.append([f"{cell:{side}{width}}" for cell in column])
        lines = ("  ".join(row).rstrip() for row in zip(*columns, strict=True))
        return "\n".join([self.head, *lines, *self.notes])

    def html(self) -> str:
        """A table with a caption, then the notes."""
        rows = (
            "".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self.rows
        )
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        notes = "".join(f"<li>{escape(line)}</li>" for line in self.notes)
        return f"<table><caption>{escape(self.head)}</caption>{body}</table><ul>{notes}</ul>"


class Value:
    """A frozen dataclass: a table in notebooks, copies with some fields changed."""

    @property
    def summary(self) -> SummaryTable:
        """The value as a short table: its fields, if a class says nothing else."""
        shown = (each.name for each in fields(cast(Any, self)) if each.repr)
        rows = tuple((name, repr(getattr(self, name))) for name in shown)
        return SummaryTable(type(self).__name__, rows)

    def _repr_html_(self) -> str:
        return self.summary.html()

    def with_(self, **changes: Any) -> Self:
        """Copy of the value with other values of some fields.

        Args:
            **changes: New values by the names of fields.

        Raises:
            UnknownName: There is no such field.
            TestbedError: Values do not fit each other.
        """
        known = [each.name for each in fields(cast(Any, self)) if each.init]
        for name in changes:
            if name not in known:
                raise UnknownName(f"argument of {type(self).__name__}", name, known)
        return replace(cast(Any, self), **changes)  # type: ignore[no-any-return]


class Summarized(Value):
    """A value that prints as its summary; a dataclass of this kind needs `repr=False`."""

    def __repr__(self) -> str:
        return self.summary.short.text()

    def __str__(self) -> str:
        """All rows."""
        return self.summary.text()


EXACT, EXACT_SHORT = 1e-7, 1e-10
"""Relative sigma below which decimals would hide how small it is; the same in brackets."""

ROUNDING = 1e-15
"""Relative sigma of what is known: numbers of the computer have no more digits."""

NOT_IDENTIFIABLE = "not identifiable"
OPEN_ZERO = f"{NOT_IDENTIFIABLE}: plate zero unknown"
"""In place of a number whose sigma is infinite: no motion separates it from the plate's zero."""


def number_with_sigma(value: float, sigma: float, short: bool = False) -> str:
    """Value and sigma, with as many decimals as sigma has to say.

    Args:
        value: The value.
        sigma: Its standard deviation; infinite where the value is not identifiable.
        short: 1.0610(9) for 1.0610 +- 0.0009: the digits in brackets are of the last places.
    """
    if math.isinf(sigma):
        return NOT_IDENTIFIABLE if short else OPEN_ZERO
    # numbers and sigmas below this are rounding of zero, in any unit [kg, kg m, kg m^2, N m]
    if max(abs(value), sigma) < 1e-15:
        return "0"
    if sigma <= ROUNDING * abs(value):
        return f"{value:.9g}"  # known
    if sigma < (EXACT_SHORT if short else EXACT) * abs(value):
        return f"{value:.9g} +- {sigma:.0e}"
    # decimals that show two digits of sigma
    digits = 1 if sigma >= 1 or sigma == 0 else len(f"{1 / sigma:.0f}") + 1
    if short:
        places = f"{sigma:.{digits}f}".replace(".", "").lstrip("0")
        return (
            f"{value:.{digits}f}({sigma:.1f})"
            if sigma >= 1
            else f"{value:.{digits}f}({places})"
        )
    return f"{value:.{digits}f} +- {sigma:.{digits}f}"


def numbers_with_sigma(values: Array, sigma: Array, short: bool = False) -> list[str]:
    """Values and sigmas in words, row by row of arrays of more axes.

    Args:
        values: Of any shape.
        sigma: Standard deviations, of the same shape.
        short: As of `number_with_sigma`.
    """
    pairs = zip(values.ravel().tolist(), sigma.ravel().tolist(), strict=True)
    return [number_with_sigma(*pair, short) for pair in pairs]


def parameter_rows(
    names: Sequence[str], values: Array, sigma: Array, units: Sequence[str]
) -> tuple[tuple[str, ...], ...]:
    """Name, value with sigma, and unit, a row each.

    Args:
        names: (p,).
        values: (p,).
        sigma: Standard deviations, (p,).
        units: (p,).
    """
    pairs = zip(values.tolist(), sigma.tolist(), strict=True)
    numbers = [number_with_sigma(*pair) for pair in pairs]
    return tuple(zip(names, numbers, units, strict=True))
