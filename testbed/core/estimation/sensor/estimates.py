"""Coefficients of sensor errors in an estimate."""

from __future__ import annotations

from dataclasses import dataclass


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
