"""What encoders do to joint positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.arrays import Array


@dataclass(frozen=True)
class EncoderNoise:
    """White noise on positions.

    Attributes:
        sigma: Standard deviation [rad or m].
    """

    kind: ClassVar[str] = "encoder_noise"
    sigma: float

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Positions with noise, (M, n) [rad or m]."""
        del time
        noisy: Array = signal + self.sigma * rng.normal(size=signal.shape)
        return noisy


@dataclass(frozen=True)
class EncoderResolution:
    """Positions rounded to the nearest count.

    Attributes:
        count: Least count [rad or m].
    """

    kind: ClassVar[str] = "encoder_resolution"
    count: float

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Positions in whole counts, (M, n) [rad or m]."""
        del time, rng
        rounded: Array = self.count * np.round(signal / self.count)
        return rounded
