"""Tables that summarise values, as plain text and as HTML."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from html import escape
from typing import Any, Self, cast

from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnknownName

MAX_PRINTED_ROWS = 40
"""Largest number of printed rows; a note gives the number of remaining rows."""


@dataclass(frozen=True)
class SummaryTable:
    """Title, rows and notes that summarise a value.

    Attributes:
        title: Title, one line.
        rows: Cells of each row; all rows have the same length, and the first cell is a name.
        notes: Remarks below the table.
    """

    title: str
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def first_rows(self) -> SummaryTable:
        """Table of the first `MAX_PRINTED_ROWS` rows, with a note on the remaining rows."""
        omitted = len(self.rows) - MAX_PRINTED_ROWS
        if omitted <= 0:
            return self
        return SummaryTable(
            self.title,
            self.rows[:MAX_PRINTED_ROWS],
            (f"... and {omitted} more", *self.notes),
        )

    def text(self) -> str:
        """Plain text: title, rows in aligned columns, notes."""
        columns = []
        for k, column in enumerate(zip(*self.rows, strict=True)):
            width = max(map(len, column))
            side = ">" if k == 1 < len(self.rows[0]) - 1 else "<"
            columns.append([f"{cell:{side}{width}}" for cell in column])
        lines = ("  ".join(row).rstrip() for row in zip(*columns, strict=True))
        return "\n".join([self.title, *lines, *self.notes])

    def html(self) -> str:
        """HTML table with the title as caption, followed by a list of the notes."""
        rows = (
            "".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self.rows
        )
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        notes = "".join(f"<li>{escape(line)}</li>" for line in self.notes)
        return f"<table><caption>{escape(self.title)}</caption>{body}</table><ul>{notes}</ul>"


class Value:
    """Base class of frozen dataclasses with a summary table and copies with changed fields."""

    @property
    def summary(self) -> SummaryTable:
        """Summary table of the value; by default one row per field."""
        names = (each.name for each in fields(cast(Any, self)) if each.repr)
        rows = tuple((name, repr(getattr(self, name))) for name in names)
        return SummaryTable(type(self).__name__, rows)

    def _repr_html_(self) -> str:
        """HTML text of the summary, for notebooks."""
        return self.summary.html()

    def with_(self, **changes: Any) -> Self:
        """Copy of the value with some fields replaced.

        Args:
            **changes: New values, keyed by field name.

        Raises:
            UnknownName: A field does not exist.
            TestbedError: The new values are inconsistent.
        """
        field_names = [each.name for each in fields(cast(Any, self)) if each.init]
        for name in changes:
            if name not in field_names:
                raise UnknownName(
                    f"argument of {type(self).__name__}", name, field_names
                )
        return replace(cast(Any, self), **changes)  # type: ignore[no-any-return]


class Summarized(Value):
    """Value whose text form is its summary; derived dataclasses need `repr=False`."""

    def __repr__(self) -> str:
        return self.summary.first_rows.text()

    def __str__(self) -> str:
        """Plain text of the summary with all rows."""
        return self.summary.text()


MIN_DECIMAL_RATIO, MIN_SHORT_DECIMAL_RATIO = 1e-7, 1e-10
"""Relative sigma below which sigma is printed as a power of ten, for the long and short forms."""

RELATIVE_ROUNDING = 1e-15
"""Relative sigma below which a value is considered known exactly: float64 rounding."""

NOT_IDENTIFIABLE = "not identifiable"
UNKNOWN_PLATE_ZERO = f"{NOT_IDENTIFIABLE}: plate zero unknown"
"""Text for a value with infinite sigma, which no motion separates from the plate's zero error."""


def number_with_sigma(value: float, sigma: float, short: bool = False) -> str:
    """Value and standard deviation as text, rounded to two significant digits of sigma.

    Sigma is printed as a power of ten if it is below `MIN_DECIMAL_RATIO` times the value, and
    omitted below `RELATIVE_ROUNDING` times the value. An infinite sigma gives "not identifiable",
    with the reason in the long form. If value and sigma are below 1e-15, the text is "0".

    Args:
        value: Value, in any unit.
        sigma: Standard deviation; infinite if the value is not identifiable.
        short: True for the form 1.06100(90) instead of 1.06100 +- 0.00090, where the digits in
            brackets are the standard deviation in units of the last decimal places.
    """
    if math.isinf(sigma):
        return NOT_IDENTIFIABLE if short else UNKNOWN_PLATE_ZERO
    # numbers and sigmas below this are rounding of zero, in any unit [kg, kg m, kg m^2, N m]
    if max(abs(value), sigma) < 1e-15:
        return "0"
    if sigma <= RELATIVE_ROUNDING * abs(value):
        return f"{value:.9g}"  # known exactly
    if sigma < (MIN_SHORT_DECIMAL_RATIO if short else MIN_DECIMAL_RATIO) * abs(value):
        return f"{value:.9g} +- {sigma:.0e}"
    # decimals that show two digits of sigma
    digits = 1 if sigma >= 1 or sigma == 0 else len(f"{1 / sigma:.0f}") + 1
    if short:
        sigma_digits = f"{sigma:.{digits}f}".replace(".", "").lstrip("0")
        return (
            f"{value:.{digits}f}({sigma:.1f})"
            if sigma >= 1
            else f"{value:.{digits}f}({sigma_digits})"
        )
    return f"{value:.{digits}f} +- {sigma:.{digits}f}"


def numbers_with_sigma(values: Array, sigma: Array, short: bool = False) -> list[str]:
    """Texts of values with their standard deviations, in row-major order.

    Args:
        values: Values, of any shape.
        sigma: Standard deviations, of the same shape.
        short: Short form, as in `number_with_sigma`.
    """
    pairs = zip(values.ravel().tolist(), sigma.ravel().tolist(), strict=True)
    return [number_with_sigma(*pair, short) for pair in pairs]


def parameter_rows(
    names: Sequence[str], values: Array, sigma: Array, units: Sequence[str]
) -> tuple[tuple[str, ...], ...]:
    """Table rows of parameters: name, value with standard deviation, unit.

    Args:
        names: Parameter names, (p,).
        values: Values, (p,).
        sigma: Standard deviations, (p,).
        units: Units, (p,).
    """
    pairs = zip(values.tolist(), sigma.tolist(), strict=True)
    numbers = [number_with_sigma(*pair) for pair in pairs]
    return tuple(zip(names, numbers, units, strict=True))
