"""What a person asks of physically consistent bodies: the one place of defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, ClassVar, Literal

from testbed.errors import SettingsError, UnknownName

Metric = Literal["log-det", "frobenius"]

METRICS: tuple[Metric, ...] = ("log-det", "frobenius")

PLANES = ("xy", "xz", "yz")
"""Planes of symmetry, through the origin of a body's frame."""

MASS = "mass"
"""Of all moving bodies together; `mass/LINK` is that of one with all that is fixed to it."""

SURE = 3.0
"""Sigmas by which known masses may contradict each other."""


@dataclass(frozen=True, kw_only=True)
class Wishes:
    """What is asked of physically consistent bodies, besides that they fit the data.

    Plain values only: an experiment file's table [consistent] holds the same keys.
    """

    metric: Metric = "log-det"
    """How far bodies are from the model file's: "log-det" keeps them away from what no body can
    be, "frobenius" lets them come as near as the data push them."""

    prior_error: float | Literal["chosen"] = 0.5
    """How wrong the model file's bodies are taken to be, in parts of themselves; "chosen" takes
    what foretells best the half of the recording that was held out."""

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
        if self.prior_error != "chosen" and not _positive(self.prior_error):
            raise SettingsError(
                f'prior_error is a positive part of one, or "chosen", found {self.prior_error!r}'
            )
        if not isinstance(self.centres_in_shapes, bool):
            raise SettingsError(f"centres_in_shapes is true or false: {self.centres_in_shapes!r}")
        object.__setattr__(self, "known", _known(self.known))
        object.__setattr__(self, "symmetric", _symmetric(self.symmetric))
        self._check_total()

    @property
    def masses(self) -> dict[str, tuple[float, float]]:
        """Mass and sigma by name [kg]."""
        pairs = self.known.items()
        return {k: v if isinstance(v, tuple) else (float(v), 0.0) for k, v in pairs}  # type: ignore[arg-type]

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
                f"kg that '{MASS}' says of all bodies together"
            )


def _positive(value: object) -> bool:
    real = isinstance(value, Real) and not isinstance(value, bool)
    return real and 0 < float(value) < math.inf  # type: ignore[arg-type]


def _known(given: object) -> dict[str, float | tuple[float, ...]]:
    """Masses by name, checked one by one."""
    if not isinstance(given, Mapping):
        raise SettingsError(f"known is a table of masses by name, found {given!r}")
    found: dict[str, float | tuple[float, ...]] = {}
    for name, value in given.items():
        if name != MASS and not str(name).startswith(f"{MASS}/"):
            raise SettingsError(f"known.{name}: only '{MASS}' and '{MASS}/LINK' can be known")
        listed: list[Any] = list(value) if isinstance(value, list | tuple) else [value]
        real = all(isinstance(x, Real) and not isinstance(x, bool) for x in listed)
        if not real or not 1 <= len(listed) <= 2 or not all(map(math.isfinite, listed)):
            raise SettingsError(f"known.{name} is a mass, or a mass and its sigma, found {value!r}")
        if listed[0] <= 0 or min(listed) < 0:
            raise SettingsError(f"known.{name} = {listed[0]:g} kg: masses are positive")
        found[str(name)] = float(listed[0]) if len(listed) == 1 else tuple(map(float, listed))
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
