"""Gravity vectors in the base frame, from numbers or from the name of a mounting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from testbed.core.base.errors import SettingsError

DEFAULT_GRAVITY = 9.81
"""Default magnitude of gravity [m/s^2]."""

GRAVITY_BY_MOUNTING = {
    "level": [0.0, 0.0, -DEFAULT_GRAVITY],
    "ceiling": [0.0, 0.0, DEFAULT_GRAVITY],
    "wall +x": [DEFAULT_GRAVITY, 0.0, 0.0],
    "wall -x": [-DEFAULT_GRAVITY, 0.0, 0.0],
    "wall +y": [0.0, DEFAULT_GRAVITY, 0.0],
    "wall -y": [0.0, -DEFAULT_GRAVITY, 0.0],
    "none": [0.0, 0.0, 0.0],
}
"""Gravity vectors [m/s^2], keyed by mounting; a wall mounting is named after the axis along which
gravity points."""


def parse_gravity(value: Any) -> Any:
    """Gravity vector from a text: three numbers [m/s^2] or a key of `GRAVITY_BY_MOUNTING`.

    Values other than texts are returned unchanged.

    Args:
        value: Text of a file or option, numbers separated by blanks or commas; or a vector.

    Raises:
        SettingsError: The text is neither three numbers nor a name.
    """
    if not isinstance(value, str):
        return value
    words = value.replace(",", " ").split()
    try:
        x, y, z = GRAVITY_BY_MOUNTING.get(" ".join(words)) or map(float, words)
    except ValueError:
        raise SettingsError(
            f"'{value:.40}' is no gravity: three numbers [m/s^2], or "
            f"{', '.join(GRAVITY_BY_MOUNTING)}"
        ) from None
    return [x, y, z]


def mounting_name(gravity: Sequence[float]) -> str | list[float]:
    """Name of the mounting for a gravity vector; three numbers if no name fits.

    A name fits if its vector in `GRAVITY_BY_MOUNTING` equals the given vector exactly.

    Args:
        gravity: Gravity vector, (3,) [m/s^2].
    """
    numbers = [float(each) for each in gravity]
    return next(
        (word for word, g in GRAVITY_BY_MOUNTING.items() if g == numbers), numbers
    )
