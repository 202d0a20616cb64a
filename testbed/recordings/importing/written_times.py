"""Instants that a file writes as text: ISO 8601, dates with a time, times of the day."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array

INSTANT = re.compile(
    r"(?:(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?)"
    r"|(?P<first>\d\d?)(?P<mark>[./])(?P<second>\d\d?)[./](?P<last>\d{4}))?[T ]*"
    r"(?P<hours>\d\d?):(?P<minutes>\d\d):(?P<seconds>\d\d)(?:[.,](?P<rest>\d{1,12}))?"
    r" ?(?P<half>[AaPp][Mm])? ?(?:Z|UTC|(?P<zone>[+-]\d\d):?(?P<more>\d\d)?)?"
)
"""An instant: a date or none, a time with a fraction or none, a zone or none."""

SECOND, DAY = 10**9, 86_400 * 10**9
"""In nanoseconds."""


def is_instant(text: str) -> bool:
    """Whether a text is an instant.

    Args:
        text: Of a field.
    """
    return INSTANT.fullmatch(text.strip()) is not None


def nanoseconds(texts: Sequence[str]) -> NDArray[np.int64] | Array:
    """Nanoseconds of instants since 1970, or since the first day's midnight, (M,).

    Of 3/4/2026 the month is first unless a number beyond 12 is there. Where no date is written,
    times that fall by half a day or more are of the next day. Where one is missing: float64, nan.

    Args:
        texts: Instants, one a sample; empty where one is missing.
    """
    found = [INSTANT.fullmatch(text.strip()) for text in texts]
    given = np.array([each is not None for each in found], dtype=bool)
    read = [each for each in found if each is not None]
    month_first = all(int(m["first"]) <= 12 for m in read if m["mark"] == "/")
    counts = np.array([_count(each, month_first=month_first) for each in read], dtype=np.int64)
    dated = any(each["year"] or each["last"] for each in read)
    if not dated and len(counts):
        counts[1:] += DAY * np.cumsum(np.diff(counts) < -DAY // 2)
    if given.all():
        return counts
    holed = np.full(len(texts), np.nan)
    holed[given] = counts
    return holed


def _count(said: re.Match[str], *, month_first: bool) -> int:
    """Nanoseconds of one instant."""
    day = 0
    if said["year"]:
        day = _days(said["year"], said["month"], said["day"])
    elif said["last"]:
        pair = (said["first"], said["second"])
        month, number = pair if said["mark"] == "/" and month_first else pair[::-1]
        day = _days(said["last"], month, number)
    hours = int(said["hours"])
    if said["half"]:
        hours = hours % 12 + 12 * (said["half"] in ("PM", "pm", "Pm"))
    minutes = 60 * hours + int(said["minutes"])
    if said["zone"]:
        ahead = 60 * int(said["zone"][1:]) + int(said["more"] or 0)
        minutes -= ahead if said["zone"][0] == "+" else -ahead
    rest = int((said["rest"] or "").ljust(9, "0")[:9])
    return day * DAY + (60 * minutes + int(said["seconds"])) * SECOND + rest


@lru_cache(maxsize=64)
def _days(year: str, month: str, day: str) -> int:
    """Days since 1970."""
    return date(int(year), int(month), int(day)).toordinal() - date(1970, 1, 1).toordinal()
