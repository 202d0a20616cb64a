"""Coloured noise of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import PerAxis
from testbed.sensors.sensor_error import AddedWrench, sampling_time


@dataclass(frozen=True)
class PlateColouredNoise(AddedWrench):
    """Coloured noise: stationary first-order autoregressive process.

    The autocorrelation decays as exp(-t / time_constant).

    Source    Our own choice: the same size as the white noise of experiments/table6.toml, and slow
        enough to pass a 5 Hz low-pass filter.

    Attributes:
        force: Standard deviation of the forces [N].
        moment: Standard deviation of the moments [N m].
        time_constant: Correlation time [s].
    """

    kind: ClassVar[str] = "plate_coloured_noise"
    force: Annotated[PerAxis, Ge(0)] = 0.5
    moment: Annotated[PerAxis, Ge(0)] = 0.1
    time_constant: Annotated[float, Gt(0)] = 0.3

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Coloured noise of unit variance, (M, 6)."""
        from scipy.signal import lfilter

        white = rng.normal(size=signal.shape)
        correlation = np.exp(-sampling_time(time) / self.time_constant)
        white[1:] *= np.sqrt(
            1 - correlation**2
        )  # the first sample has the stationary variance
        return np.asarray(lfilter([1.0], [1.0, -correlation], white, axis=0))
