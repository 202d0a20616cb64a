"""What drives do to the motor torques that they report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.arrays import Array


@dataclass(frozen=True)
class TorqueConstantError:
    """Torques reported with wrong torque constants.

    Attributes:
        errors: Relative, joint by joint: 0.08 reports 8 % too much, (n,).
    """

    kind: ClassVar[str] = "torque_constant_error"
    errors: tuple[float, ...]

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Torques as they are reported, (M, n) [N m or N]."""
        del time, rng
        reported: Array = (1 + np.array(self.errors)) * signal
        return reported


@dataclass(frozen=True)
class TorqueNoise:
    """White noise on the reported torques.

    Attributes:
        sigma: Standard deviation [N m or N].
    """

    kind: ClassVar[str] = "torque_noise"
    sigma: float

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Torques with noise, (M, n) [N m or N]."""
        del time
        noisy: Array = signal + self.sigma * rng.normal(size=signal.shape)
        return noisy
