"""Commercial force plates and wrist sensors, with noise and range."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class PlateModel:
    """Noise and range of a commercial force plate or wrist sensor.

    Attributes:
        force_noise: Standard deviation of the measured forces [N].
        moment_noise: Standard deviation of the measured moments [N m].
        full_scale: Largest values of the channels [N, N m].
        source: Source of these values.
    """

    force_noise: float
    moment_noise: float
    full_scale: tuple[float, float, float, float, float, float]
    source: str


ATI_SOURCE = (
    "ranges of calibration 0 and the bound of normal noise, 0.05 % of full scale, from ATI's "
    "manuals 9610-05-Ethernet Axia and 9620-05-C-Ethernet Axia"
)
"""Source of the numbers of ATI's sensors."""

PLATE_MODELS: Mapping[str, PlateModel] = {
    "amti-bms400600": PlateModel(
        force_noise=2.9,
        moment_noise=0.8,
        full_scale=(4450.0, 4450.0, 8900.0, 2670.0, 1780.0, 1330.0),
        source="noise: rms over the channels above 2 Hz at 100 Hz of examples/ur5e_plate; ranges: "
        "8.9 kN as its type (2000 lb) states, the others in proportion, our own choice",
    ),
    "ati-axia80-m20": PlateModel(
        0.25, 0.01, (500.0, 500.0, 900.0, 20.0, 20.0, 20.0), ATI_SOURCE
    ),
    "ati-axia90-m50": PlateModel(
        0.5, 0.025, (1000.0, 1000.0, 2000.0, 50.0, 50.0, 50.0), ATI_SOURCE
    ),
}
"""Models of plates by name, for `measurement.plate` of an experiment."""
