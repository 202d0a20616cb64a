"""Colours that mean the same in every picture; distinguished also by the colour-blind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

COLOURS = {
    "measured": 0x8C96A5FF,
    "external": 0x0072B2FF,
    "internal": 0xD55E00FF,
    "force": 0xD92621FF,
    "moment": 0x1854D9FF,
    "pressure": 0xF0B428FF,
    "path": 0x009E73FF,
    "axis": 0x6E7682FF,
}
"""Red, green, blue and opacity, a byte each."""

SERIES = np.array(
    [
        0x0072B2FF,
        0xD55E00FF,
        0x009E73FF,
        0xCC79A7FF,
        0xE69F00FF,
        0x56B4E9FF,
        0x785EF0FF,
    ],
    np.uint32,
)


def palette(n: int) -> NDArray[np.uint32]:
    """One a curve; they repeat after seven."""
    return np.resize(SERIES, n)
