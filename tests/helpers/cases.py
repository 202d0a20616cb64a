"""Many cases of one law: the first few belong to the fast set, all others are slow together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def cases(values: Iterable[Any], fast: int) -> list[Any]:
    """Values for `pytest.mark.parametrize`.

    Args:
        values: The cases.
        fast: How many of them are tried without `slow`.
    """
    return [
        value if k < fast else pytest.param(value, marks=pytest.mark.slow)
        for k, value in enumerate(values)
    ]
