"""What a person states by name: a value, or a value and its sigma."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Real

from testbed.errors import SettingsError


def finite_number(value: object) -> float | None:
    """A finite number, or None for what is none.

    Args:
        value: As it was written.
    """
    real = isinstance(value, Real) and not isinstance(value, bool)
    number = float(value) if real else math.nan  # type: ignore[arg-type]
    return number if math.isfinite(number) else None


def stated_values(given: object) -> dict[str, float | tuple[float, ...]]:
    """A table of values, or of values and sigmas, checked.

    Args:
        given: As it was written.

    Raises:
        SettingsError: It is none.
    """
    if not isinstance(given, Mapping):
        raise SettingsError(f"known is a table of values by name, found {given!r}")
    found: dict[str, float | tuple[float, ...]] = {}
    for name, value in given.items():
        listed = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        numbers = [finite_number(each) for each in listed]
        if not 1 <= len(numbers) <= 2 or None in numbers or (numbers[1:] and numbers[1] < 0):  # type: ignore[operator]
            raise SettingsError(
                f"known.{name} is a value, or a value and its sigma, found {value!r}"
            )
        exact = [float(each) for each in numbers]  # type: ignore[arg-type]
        found[str(name)] = exact[0] if len(exact) == 1 else tuple(exact)
    return found


def with_sigmas(stated: Mapping[str, float | Sequence[float]]) -> dict[str, tuple[float, float]]:
    """Value and sigma by name; zero where none is stated.

    Args:
        stated: A table that has been checked.
    """
    found = {}
    for name, given in stated.items():
        numbers = list(given) if isinstance(given, Sequence) else [given]
        found[name] = (float(numbers[0]), float(numbers[1]) if len(numbers) > 1 else 0.0)
    return found
