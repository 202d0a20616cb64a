"""Pink noise of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import PerAxis
from testbed.sensors.sensor_error import AddedWrench, sampling_time


@dataclass(frozen=True)
class PlatePinkNoise(AddedWrench):
    """Pink noise: of density 1/f, as of amplifiers at low frequencies, and level below `lowest`.

    Source    Our own choice: as much as the white noise of experiments/table6.toml.

    Attributes:
        force: Standard deviation of the forces [N].
        moment: Standard deviation of the moments [N m].
        lowest: Frequency below which the density grows no more [Hz].
    """

    kind: ClassVar[str] = "plate_pink_noise"
    force: Annotated[PerAxis, Ge(0)] = 0.5
    moment: Annotated[PerAxis, Ge(0)] = 0.1
    lowest: Annotated[float, Gt(0)] = 0.01

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Noise of variance one, (M, 6)."""
        samples, step = len(signal), sampling_time(time)
        around = 2 * samples  # so that the end forgets the start
        frequency = np.maximum(np.fft.rfftfreq(around, step), self.lowest)
        density = 1 / frequency
        # of a real signal the inner lines of the spectrum count twice
        twice = np.full(len(density), 2.0)
        twice[[0, -1]] = 1.0
        density *= around / (twice @ density)
        white = np.fft.rfft(rng.normal(size=(around, signal.shape[1])), axis=0)
        return np.fft.irfft(np.sqrt(density)[:, None] * white, around, axis=0)[:samples]
