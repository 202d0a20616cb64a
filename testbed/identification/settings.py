"""How signals are treated on their way to equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array, readonly
from testbed.errors import SettingsError, UnknownName
from testbed.kernel.layout import TERMS, Term


@dataclass(frozen=True, eq=False)
class Settings:
    """How a recording becomes equations.

    Attributes:
        position_cutoff: Low-pass on encoder positions before they are differentiated,
            at least twice `cutoff` [Hz]; None for none.
        cutoff: Parallel low-pass on regressor and measurement [Hz]; None for none.
        deadband: Joint rows at lower speeds are dropped: dry friction there has no sign
            [rad/s or m/s].
        terms: What a joint's torque holds besides the robot's: "coulomb", "viscous",
            "offset" and "rotor", a rotor's inertia.
        weights: "channels": every channel by its own noise; "full": by the covariance of
            all channels' residuals; or that covariance, (6, 6) for the plate, if known
            [N^2, N^2 m, N^2 m^2].
    """

    position_cutoff: float | None = 40.0
    cutoff: float | None = 5.0
    deadband: float = 0.02
    terms: tuple[Term, ...] = ("coulomb", "viscous")
    weights: Literal["channels", "full"] | ArrayLike = "channels"

    def __post_init__(self) -> None:
        for name in ("position_cutoff", "cutoff"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | float) and 0 < value < np.inf):
                raise SettingsError(f"{name} is a positive frequency [Hz] or None, found {value}")
        if not 0 <= self.deadband < np.inf:
            raise SettingsError(f"deadband is a speed, found {self.deadband}")
        slow, fast = self.cutoff, self.position_cutoff
        if slow is not None and fast is not None and fast < 2 * slow:
            raise SettingsError(
                f"position_cutoff = {fast:g} Hz is less than twice cutoff = {slow:g} Hz: what it "
                "takes from the motion would bias the estimate"
            )
        for term in self.terms:
            if term not in TERMS:
                raise UnknownName("term of a joint's torque", term, TERMS)
        if len(set(self.terms)) < len(self.terms):
            raise SettingsError(f"terms names something twice: {', '.join(self.terms)}")
        if isinstance(self.weights, str):
            if self.weights not in ("channels", "full"):
                raise UnknownName("weights", self.weights, ("channels", "full", "a covariance"))
        else:
            object.__setattr__(self, "weights", _covariance(self.weights))

    @property
    def joined(self) -> bool:
        """Whether noise of different channels is taken as correlated."""
        return not (isinstance(self.weights, str) and self.weights == "channels")

    @property
    def covariance(self) -> Array | None:
        """The covariance that was given, if one was."""
        return None if isinstance(self.weights, str) else np.asarray(self.weights)


def _covariance(given: ArrayLike) -> Array:
    size = np.shape(given)[0] if np.ndim(given) == 2 else 0
    matrix = readonly(given, (size, size) if size else (None, None), "weights")
    symmetric = np.allclose(matrix, matrix.T, rtol=1e-9, atol=0)
    if not symmetric or np.linalg.eigvalsh(matrix).min(initial=1.0) <= 0:
        raise SettingsError("weights is no covariance: it is not symmetric and positive definite")
    return matrix
