"""Colours with the same meaning in all pictures, suitable for colour-blind readers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

COLOURS = {
    "measured": 0x8C96A5FF,
    "wrench": 0x0072B2FF,
    "torque": 0xD55E00FF,
    "force": 0xD92621FF,
    "moment": 0x1854D9FF,
    "pressure": 0xF0B428FF,
    "path": 0x009E73FF,
    "axis": 0x6E7682FF,
}
"""Colours by meaning: red, green, blue and opacity, one byte each."""

CURVE_COLOURS = np.array(
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
"""Colours of curves without a fixed meaning."""


def palette(n: int) -> NDArray[np.uint32]:
    """Colours of n curves, (n,), repeated after seven.

    Args:
        n: Number of curves.
    """
    return np.resize(CURVE_COLOURS, n)
