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
    """Pink noise, with a spectral density of 1/f as in amplifiers; constant below `lowest`.

    Source    Our own choice: the same size as the white noise of experiments/table6.toml.

    Attributes:
        force: Standard deviation of the forces [N].
        moment: Standard deviation of the moments [N m].
        lowest: Frequency below which the spectral density is constant [Hz].
    """

    kind: ClassVar[str] = "plate_pink_noise"
    force: Annotated[PerAxis, Ge(0)] = 0.5
    moment: Annotated[PerAxis, Ge(0)] = 0.1
    lowest: Annotated[float, Gt(0)] = 0.01

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Pink noise of unit variance, (M, 6), shaped in the frequency domain."""
        samples, step = len(signal), sampling_time(time)
        length = 2 * samples  # avoids periodicity: the end is independent of the start
        frequency = np.maximum(np.fft.rfftfreq(length, step), self.lowest)
        density = 1 / frequency
        # inner lines of a real signal's spectrum have weight two
        line_weights = np.full(len(density), 2.0)
        line_weights[[0, -1]] = 1.0
        density *= length / (line_weights @ density)
        white = np.fft.rfft(rng.normal(size=(length, signal.shape[1])), axis=0)
        return np.fft.irfft(np.sqrt(density)[:, None] * white, length, axis=0)[:samples]
