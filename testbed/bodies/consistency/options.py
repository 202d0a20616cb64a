"""Options of physically consistent bodies, with their defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from testbed.core.base.errors import SettingsError
from testbed.core.estimation.settings import (
    KNOWN_VALUES_FIELD,
    PositiveNumber,
    ValidatedValue,
    values_with_sigmas,
)

TOTAL_MASS = "mass"
"""Name of the total mass of all moving bodies; `mass/LINK`: a link with all links fixed to it."""


@dataclass(frozen=True, kw_only=True)
class ConsistencyOptions(ValidatedValue):
    """Options of physically consistent bodies: error of the model file and known masses.

    All values are plain, so that the table [consistent] of an experiment file has the same keys.
    """

    prior_error: Annotated[float, PositiveNumber, "a positive part of one"] = 0.5
    """Relative error of the model file's bodies."""

    known: Annotated[Mapping[str, float | Sequence[float]], *KNOWN_VALUES_FIELD] = (
        field(default_factory=dict, hash=False)
    )
    """Masses, or masses with sigmas, by name [kg]: "mass" for all moving bodies, "mass/LINK" for a
    link with all links fixed to it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, (mass, _) in self.masses.items():
            if name != TOTAL_MASS and not name.startswith(f"{TOTAL_MASS}/"):
                raise SettingsError(
                    f"known.{name}: only '{TOTAL_MASS}' and '{TOTAL_MASS}/LINK' can be known"
                )
            if mass <= 0:
                raise SettingsError(f"known.{name} = {mass:g} kg: masses are positive")

    @property
    def masses(self) -> dict[str, tuple[float, float]]:
        """Known masses and standard deviations [kg], keyed by name."""
        return values_with_sigmas(self.known)
