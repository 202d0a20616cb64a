"""An estimate in words: values with sigmas, as a table for people."""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape

EXACT, EXACT_SHORT = 1e-7, 1e-10
"""Relative sigma below which decimals would hide how small it is; the same in brackets."""

ROUNDING = 1e-15
"""Relative sigma of what is known: numbers of the computer have no more digits."""

NOT_IDENTIFIABLE = "not identifiable"
OPEN_ZERO = f"{NOT_IDENTIFIABLE}: plate zero unknown"
"""In place of a number whose sigma is infinite: no motion tells it from the plate's zero."""

NOTHING = 1e-15
"""Numbers and sigmas below this are rounding of zero, in any unit [kg, kg m, kg m^2, N m]."""


def number_with_sigma(value: float, sigma: float, short: bool = False) -> str:
    """Value and sigma, with as many decimals as sigma has to say.

    Args:
        value: The value.
        sigma: Its standard deviation; infinite where the value is not identifiable.
        short: 1.0610(9) for 1.0610 +- 0.0009: the digits in brackets are of the last places.
    """
    if math.isinf(sigma):
        return NOT_IDENTIFIABLE if short else OPEN_ZERO
    if max(abs(value), sigma) < NOTHING:
        return "0"
    if sigma <= ROUNDING * abs(value):
        return f"{value:.9g}"  # known
    if sigma < (EXACT_SHORT if short else EXACT) * abs(value):
        return f"{value:.9g} +- {sigma:.0e}"
    digits = _digits(sigma)
    if short:
        places = f"{sigma:.{digits}f}".replace(".", "").lstrip("0")
        return f"{value:.{digits}f}({sigma:.1f})" if sigma >= 1 else f"{value:.{digits}f}({places})"
    return f"{value:.{digits}f} +- {sigma:.{digits}f}"


def _digits(sigma: float) -> int:
    """Decimals that show two digits of sigma."""
    return 1 if sigma >= 1 or sigma == 0 else len(f"{1 / sigma:.0f}") + 1


@dataclass(frozen=True)
class Words:
    """What is printed of an estimate.

    Attributes:
        head: What it is.
        rows: Name, value, sigma and unit of each parameter.
        sentences: What to be careful about.
    """

    head: str
    rows: tuple[tuple[str, float, float, str], ...]
    sentences: tuple[str, ...]

    def text(self) -> str:
        """Name, value with sigma and unit, a line each; then what to be careful about."""
        rows = [(name, number_with_sigma(value, s), unit) for name, value, s, unit in self.rows]
        name, value = (max(len(row[k]) for row in rows) for k in range(2))
        lines = [f"{row[0]:{name}s}  {row[1]:>{value}s}  {row[2]}" for row in rows]
        return "\n".join([self.head, *lines, *(f"warning: {line}" for line in self.sentences)])

    def html(self) -> str:
        """The same as a table of a page."""
        body = "".join(
            f'<tr><th style="text-align:left">{escape(name)}</th><td style="text-align:right">'
            f"{number_with_sigma(value, sigma).replace('+-', '&plusmn;')}</td>"
            f'<td style="text-align:left">{escape(unit)}</td></tr>'
            for name, value, sigma, unit in self.rows
        )
        lines = "".join(f"<li>{escape(line)}</li>" for line in self.sentences)
        said = f"<ul>{lines}</ul>" if lines else ""
        return f"<table><caption>{escape(self.head)}</caption>{body}</table>{said}"
