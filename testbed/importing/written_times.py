"""Instants that a file writes as text: ISO 8601, dates with a time, times of the day."""

from __future__ import annotations

import re
from datetime import date
from functools import lru_cache

INSTANT = re.compile(
    r"(?:(\d+)([-/.])(\d+)[-/.](\d+))?[T ]*(\d\d?):(\d\d):(\d\d(?:[.,]\d+)?)"
    r" ?([AP]M)? ?(?:Z|UTC|([+-])(\d\d):?(\d\d)?)?",
    re.IGNORECASE,
)
"""A date or none, a time, half of the day or none, a zone or none."""

DAY = 86_400e6
"""In microseconds."""


def microseconds(text: str) -> float:
    """Time of a written instant since 1970, or since midnight without a date [us].

    Of 4.3.2026 the day is first, of 3/4/2026 the month, if it can be one.

    Args:
        text: Of a field.

    Raises:
        ValueError: It is no instant.
    """
    found = INSTANT.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"'{text}' is no instant")
    *day, hours, minutes, seconds, half, sign, ahead, more = found.groups()
    hour = int(hours) % 12 + 12 * (half.upper() == "PM") if half else int(hours)
    zone = int(f"{sign}1") * (60 * int(ahead) + int(more or 0)) if sign else 0
    since = float(seconds.replace(",", ".")) + 60 * (60 * hour + int(minutes) - zone)
    return 1e6 * since + (DAY * _days(*day) if day[0] else 0.0)


@lru_cache(maxsize=64)
def _days(first: str, mark: str, second: str, third: str) -> int:
    """Days since 1970."""
    year, month, day = int(first), int(second), int(third)
    if len(first) < 4:
        year, month, day = (
            (day, year, month) if mark == "/" and year <= 12 else (day, month, year)
        )
    return date(year, month, day).toordinal() - date(1970, 1, 1).toordinal()
