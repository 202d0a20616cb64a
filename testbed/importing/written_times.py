"""Parser for instants in text: ISO 8601, dates with time, and times of day."""

from __future__ import annotations

import re
from datetime import date
from functools import lru_cache

INSTANT_PATTERN = re.compile(
    r"(?:(\d+)([-/.])(\d+)[-/.](\d+))?[T ]*(\d\d?):(\d\d):(\d\d(?:[.,]\d+)?)"
    r" ?([AP]M)? ?(?:Z|UTC|([+-])(\d\d):?(\d\d)?)?",
    re.IGNORECASE,
)
"""Regular expression of an instant: optional date, time, optional AM or PM, optional time zone."""

DAY_MICROSECONDS = 86_400e6
"""Microseconds in a day."""


def parse_instant(text: str) -> float:
    """Instant since 1970, or since midnight if the text has no date [us].

    In a date such as 4.3.2026 the day comes first; in 3/4/2026 the month comes first, if the number
    can be a month. An instant with a time zone is converted to UTC.

    Args:
        text: Text of a field.

    Raises:
        ValueError: The text is not an instant.
    """
    match = INSTANT_PATTERN.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"'{text}' is no instant")
    *day, hours, minutes, seconds, half_of_day, sign, zone_hours, zone_minutes = (
        match.groups()
    )
    hour = (
        int(hours) % 12 + 12 * (half_of_day.upper() == "PM")
        if half_of_day
        else int(hours)
    )
    zone = (
        int(f"{sign}1") * (60 * int(zone_hours) + int(zone_minutes or 0)) if sign else 0
    )
    since = float(seconds.replace(",", ".")) + 60 * (60 * hour + int(minutes) - zone)
    return 1e6 * since + (DAY_MICROSECONDS * _days_since_epoch(*day) if day[0] else 0.0)


@lru_cache(maxsize=64)
def _days_since_epoch(first: str, mark: str, second: str, third: str) -> int:
    """Days from 1970-01-01 to a date.

    Args:
        first: First number of the date; a year if it has four digits.
        mark: Separator of the numbers.
        second: Second number.
        third: Third number.
    """
    year, month, day = int(first), int(second), int(third)
    if len(first) < 4:
        year, month, day = (
            (day, year, month) if mark == "/" and year <= 12 else (day, month, year)
        )
    return date(year, month, day).toordinal() - date(1970, 1, 1).toordinal()
