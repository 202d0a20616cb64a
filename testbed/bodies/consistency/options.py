"""What a person asks of physically consistent bodies: the one place of defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from testbed.core.base.errors import SettingsError
from testbed.core.estimation.settings import KNOWN, Checked, Share, with_sigmas

MASS = "mass"
"""Of all moving bodies together; `mass/LINK` is that of one with all that is fixed to it."""


@dataclass(frozen=True, kw_only=True)
class ConsistencyOptions(Checked):
    """What is asked of physically consistent bodies, besides that they fit the data.

    Plain values only: an experiment file's table [consistent] holds the same keys.
    """

    prior_error: Annotated[float, Share, "a positive part of one"] = 0.5
    """How wrong the model file's bodies are taken to be, in parts of themselves."""

    known: Annotated[Mapping[str, float | Sequence[float]], *KNOWN] = field(
        default_factory=dict, hash=False
    )
    """Masses, or mass and sigma, by name: "mass" is that of all moving bodies, "mass/LINK" of one
    with all that is fixed to it [kg]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, (mass, _) in self.masses.items():
            if name != MASS and not name.startswith(f"{MASS}/"):
                raise SettingsError(
                    f"known.{name}: only '{MASS}' and '{MASS}/LINK' can be known"
                )
            if mass <= 0:
                raise SettingsError(f"known.{name} = {mass:g} kg: masses are positive")

    @property
    def masses(self) -> dict[str, tuple[float, float]]:
        """Mass and sigma by name [kg]."""
        return with_sigmas(self.known)
