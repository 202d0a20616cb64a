"""What the plate does to the wrench that it feels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.arrays import Array


@dataclass(frozen=True)
class PlateNoise:
    """White noise on the plate's channels.

    Attributes:
        force: Standard deviation of the forces [N].
        moment: Standard deviation of the moments [N m].
    """

    kind: ClassVar[str] = "plate_noise"
    force: float
    moment: float

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench with noise, (M, 6) [N, N m]."""
        del time
        sigma = np.repeat([self.force, self.moment], 3)
        noisy: Array = signal + sigma * rng.normal(size=signal.shape)
        return noisy
