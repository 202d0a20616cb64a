"""What a person asks of physically consistent bodies: the one place of defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from testbed.errors import SettingsError, UnknownName
from testbed.identification.settings import finite_number, stated_values, with_sigmas

Metric = Literal["log-det", "frobenius"]

METRICS: tuple[Metric, ...] = ("log-det", "frobenius")

PLANES = ("xy", "xz", "yz")
"""Planes of symmetry, through the origin of a body's frame."""

MASS = "mass"
"""Of all moving bodies together; `mass/LINK` is that of one with all that is fixed to it."""

SURE = 3.0
"""Sigmas by which known masses may contradict each other."""


@dataclass(frozen=True, kw_only=True)
class ConsistencyOptions:
    """What is asked of physically consistent bodies, besides that they fit the data.

    Plain values only: an experiment file's table [consistent] holds the same keys.
    """

    metric: Metric = "log-det"
    """How far bodies are from the model file's: "log-det" keeps them away from what no body can
    be, "frobenius" lets them come as near as the data push them."""

    prior_error: float | Literal["chosen"] = 0.5
    """How wrong the model file's bodies are taken to be, in parts of themselves; "chosen" takes
    what predicts best the half of the recording that was held out."""

    known: Mapping[str, float | Sequence[float]] = field(default_factory=dict, hash=False)
    """Masses, or mass and sigma, by name: "mass" is that of all moving bodies, "mass/LINK" of one
    with all that is fixed to it [kg]."""

    symmetric: Mapping[str, str | Sequence[str]] = field(default_factory=dict, hash=False)
    """Planes of symmetry by link, through the origin of its frame: "xz", or ["xz", "yz"]."""

    centres_in_shapes: bool = False
    """Whether every mass centre lies in the box around its link's shapes in the model file."""

    __pydantic_config__: ClassVar = {"extra": "forbid", "strict": True}

    def __post_init__(self) -> None:
        if self.metric not in METRICS:
            raise UnknownName("metric of bodies", str(self.metric), METRICS)
        if self.prior_error != "chosen" and not (finite_number(self.prior_error) or 0) > 0:
            raise SettingsError(
                f'prior_error is a positive part of one, or "chosen", found {self.prior_error!r}'
            )
        if not isinstance(self.centres_in_shapes, bool):
            raise SettingsError(f"centres_in_shapes is true or false: {self.centres_in_shapes!r}")
        object.__setattr__(self, "known", _masses(self.known))
        object.__setattr__(self, "symmetric", _symmetric(self.symmetric))
        self._check_total()

    @property
    def masses(self) -> dict[str, tuple[float, float]]:
        """Mass and sigma by name [kg]."""
        return with_sigmas(self.known)

    def _check_total(self) -> None:
        """Whether the total leaves room for the masses that are known."""
        parts = {name: mass for name, mass in self.masses.items() if name != MASS}
        if MASS not in self.masses or not parts:
            return
        total, doubt = self.masses[MASS]
        together = sum(mass for mass, _ in parts.values())
        spread = math.hypot(doubt, *(sigma for _, sigma in parts.values()))
        if together - total > SURE * spread:
            raise SettingsError(
                f"known masses: {' + '.join(parts)} make {together:g} kg, more than the {total:g} "
                f"kg of '{MASS}', the mass of all bodies"
            )


def _masses(given: object) -> dict[str, float | tuple[float, ...]]:
    """Masses by name, checked one by one."""
    found = stated_values(given)
    for name, (mass, _) in with_sigmas(found).items():
        if name != MASS and not name.startswith(f"{MASS}/"):
            raise SettingsError(f"known.{name}: only '{MASS}' and '{MASS}/LINK' can be known")
        if mass <= 0:
            raise SettingsError(f"known.{name} = {mass:g} kg: masses are positive")
    return found


def _symmetric(given: object) -> dict[str, tuple[str, ...]]:
    """Planes by link, checked one by one."""
    if not isinstance(given, Mapping):
        raise SettingsError(f"symmetric is a table of planes by link, found {given!r}")
    found = {}
    for link, planes in given.items():
        listed = (planes,) if isinstance(planes, str) else tuple(planes)
        for plane in listed:
            if plane not in PLANES:
                raise UnknownName(f"plane of symmetry of '{link}'", str(plane), PLANES)
        found[str(link)] = listed
    return found
