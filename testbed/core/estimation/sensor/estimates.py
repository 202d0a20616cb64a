"""Coefficients of sensor errors in an estimate."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NuisanceEstimate:
    """Coefficient of a sensor error, estimated together with the parameters.

    Attributes:
        kind: Term of the sensor error, such as "pose".
        name: Name of the coefficient, such as "pose/rx".
        unit: Unit of the coefficient.
        value: Estimated value.
        sigma: Standard deviation of the value.
    """

    kind: str
    name: str
    unit: str
    value: float
    sigma: float
