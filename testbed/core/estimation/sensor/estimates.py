"""Coefficients of sensor errors in an estimate, and tests of its residuals for such errors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from testbed.sensors.catalogue import systematic_errors

NEARLY = 0.6
"""Part of what a cause explains that a simpler one among it has to explain to be named first."""


@dataclass(frozen=True)
class NuisanceEstimate:
    """One number of the instrument that was estimated with the parameters.

    Attributes:
        kind: Of the nuisance.
        name: Such as "pose/rx".
        unit: Its unit.
        value: What the instrument adds or does.
        sigma: Its standard deviation.
    """

    kind: str
    name: str
    unit: str
    value: float
    sigma: float


@dataclass(frozen=True)
class TraceTest:
    """Whether residuals hold what one kind of fault of the instrument would leave.

    Attributes:
        nuisance: Term of the sensor error.
        chance: Probability of residuals like these where the model holds.
        clearness: How much it explains beyond what its numbers alone would, by Akaike's
            criterion.
        names: Of its numbers.
        units: One each.
        size: What they would be if it were the only fault.
        shift: By how many sigma the parameter moves that moves most if it is estimated.
        parameter: Which one that is.
        alone: The one number that explains nearly as much, and what it would be; None if none does.
    """

    nuisance: str
    chance: float
    clearness: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    size: tuple[float, ...]
    shift: float
    parameter: str
    alone: NuisanceEstimate | None = None

    def largest(self, count: int) -> list[str]:
        """The fault's largest numbers in words, so many of each unit; or the one that explains it.

        Args:
            count: How many.
        """
        one = self.alone
        if one is not None:
            return [
                f"{one.name} {one.value:.3g} +- {one.sigma:.2g} {one.unit}".rstrip()
            ]
        numbers = sorted(
            zip(self.names, self.units, self.size, strict=True),
            key=lambda n: -abs(n[2]),
        )
        phrases = []
        for unit in dict.fromkeys(self.units):
            own = [(name, size) for name, own_unit, size in numbers if own_unit == unit]
            phrases += [
                f"{name} {size:.3g} {unit}".rstrip() for name, size in own[:count]
            ]
        return phrases


def in_order(tests: Iterable[TraceTest]) -> tuple[TraceTest, ...]:
    """The clearest first; one that holds a simpler one after it, if that does nearly as well.

    Args:
        tests: Of all kinds.
    """
    every = tuple(tests)
    clearness = {test.nuisance: test.clearness for test in every}

    def rank(test: TraceTest) -> tuple[float, int]:
        own = test.clearness
        held = [
            clearness.get(kind, 0.0)
            for kind in systematic_errors()[test.nuisance].contains
        ]
        nearly = [other for other in held if other > NEARLY * own > 0]
        return -min([own, *nearly]), len(nearly)

    return tuple(sorted(every, key=rank))
