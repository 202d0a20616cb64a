"""Gravity along the axes of a robot's base, by numbers or by a word for how it is mounted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from testbed.core.base.errors import SettingsError

SIZE = 9.81
"""Where no numbers are given [m/s^2]."""

MOUNTINGS = {
    "level": [0.0, 0.0, -SIZE],
    "ceiling": [0.0, 0.0, SIZE],
    "wall +x": [SIZE, 0.0, 0.0],
    "wall -x": [-SIZE, 0.0, 0.0],
    "wall +y": [0.0, SIZE, 0.0],
    "wall -y": [0.0, -SIZE, 0.0],
    "none": [0.0, 0.0, 0.0],
}
"""Gravity [m/s^2] by word; on a wall the axis is that along which it points."""


def gravity_of(given: Any) -> Any:
    """Gravity of a text, three numbers or one of `MOUNTINGS` [m/s^2]; other values as they are.

    Args:
        given: As a person wrote it.

    Raises:
        SettingsError: The text is neither.
    """
    if not isinstance(given, str):
        return given
    words = given.replace(",", " ").split()
    try:
        x, y, z = MOUNTINGS.get(" ".join(words)) or map(float, words)
    except ValueError:
        raise SettingsError(
            f"'{given:.40}' is no gravity: three numbers [m/s^2], or {', '.join(MOUNTINGS)}"
        ) from None
    return [x, y, z]


def in_words(gravity: Sequence[float]) -> str | list[float]:
    """The word for a gravity, or its numbers where there is none [m/s^2].

    Args:
        gravity: (3,) [m/s^2].
    """
    numbers = [float(each) for each in gravity]
    return next((word for word, g in MOUNTINGS.items() if g == numbers), numbers)
