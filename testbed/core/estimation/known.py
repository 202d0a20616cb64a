"""Parse known values of parameters and calibration numbers from words such as mass=20."""

from __future__ import annotations

from collections.abc import Iterable

from testbed.core.base.errors import SettingsError


def parse_known(words: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Value and sigma by name, of words such as mass=20 and gain/Fz=1+-0.001.

    Args:
        words: As written.

    Raises:
        SettingsError: A word is not of that form, two say something of one name, or a mass is none.
    """
    known: dict[str, tuple[float, float]] = {}
    for word in words:
        name, equals, numbers = word.rpartition("=")
        value, _, sigma = numbers.partition("+-")
        if name in known:
            raise SettingsError(f"--known says {name} twice")
        try:
            known[name] = float(value), float(sigma or 0.0)
        except ValueError:
            equals = ""
        if not equals or not name:
            raise SettingsError(
                f"--known '{word}': write it as mass=20 or mass=20+-0.01"
            )
        if name == "mass" and not known[name][0] > 0:
            raise SettingsError(f"--known '{word}': a mass is positive")
    return known
