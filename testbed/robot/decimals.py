"""One grammar of decimal numbers, for model files and options alike.

Parsers differ in what they let pass: Python takes "1_0" and "nan", urdfdom drops a mass of
"3 " without a word. Nothing here is passed over: a text is exactly so many numbers, or none.
"""

from __future__ import annotations

import re

_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_LONGEST = 400
"""Characters of a number: Python takes quadratic time over digits."""


def decimals(text: str, count: int) -> list[float] | None:
    """So many finite decimal numbers with blanks between and around; None if it is not that."""
    words = text.split()
    if len(words) != count or any(len(word) > _LONGEST for word in words):
        return None
    if not all(_DECIMAL.fullmatch(word) for word in words):
        return None
    values = [float(word) for word in words]
    return values if all(abs(value) < float("inf") for value in values) else None
