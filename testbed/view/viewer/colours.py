"""Colours that mean the same in every picture; distinguished also by the colour-blind."""

from __future__ import annotations

from typing import TypeAlias

Colour: TypeAlias = tuple[int, int, int, int]

COLOURS: dict[str, Colour] = {
    "measured": (140, 150, 165, 255),
    "external": (0, 114, 178, 255),
    "internal": (213, 94, 0, 255),
    "force": (217, 38, 33, 255),
    "moment": (24, 84, 217, 255),
    "pressure": (240, 180, 40, 255),
    "path": (0, 158, 115, 255),
    "axis": (110, 118, 130, 255),
}

_SERIES: tuple[Colour, ...] = (
    (0, 114, 178, 255),
    (213, 94, 0, 255),
    (0, 158, 115, 255),
    (204, 121, 167, 255),
    (230, 159, 0, 255),
    (86, 180, 233, 255),
    (120, 94, 240, 255),
)


def palette(n: int) -> list[Colour]:
    """One a curve; they repeat after seven."""
    return [_SERIES[k % len(_SERIES)] for k in range(n)]
