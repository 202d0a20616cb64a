"""Parse known values of parameters and calibration numbers from words such as mass=20."""

from __future__ import annotations

from collections.abc import Iterable

from testbed.core.base.errors import SettingsError


def parse_known(words: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Parse words such as mass=20+-0.01 into values and sigmas by name.

    Args:
        words: Words of the command line.

    Raises:
        SettingsError: A word is malformed, two words have the same name, or a mass is not positive.
    """
    known: dict[str, tuple[float, float]] = {}
    for word in words:
        name, equals, numbers = word.rpartition("=")
        value, _, sigma = numbers.partition("+-")
        if name in known:
            raise SettingsError(f"--known contains {name} twice")
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
