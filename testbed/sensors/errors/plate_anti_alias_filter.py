"""Low-pass before the plate's converter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Le

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder, sampling_time

LEAST_CUTOFF = 1e-5
"""Of a filter, in sampling rates: below, its coefficients drown in rounding."""


@dataclass(frozen=True)
class PlateAntiAliasFilter(SensorError):
    """A low-pass before the plate's converter, which the joints' signals do not pass.

    A causal Butterworth filter, exact for signals that are straight between samples; it is at
    rest on the first sample's value. Slow signals it delays by sqrt(2) / (2 pi cutoff) if it
    is of second order.

    Source    Filters of bridge amplifiers in data sheets: second order, a tenth of the rate.

    Attributes:
        cutoff: Where half the power is left [Hz].
        order: 1 to 8.
    """

    kind: ClassVar[str] = "plate_anti_alias_filter"
    signal: ClassVar[Signal] = "wrench"
    stage: ClassVar[StageOrder] = StageOrder.FILTER
    cutoff: Annotated[float, Gt(0)] = 100.0
    order: Annotated[int, Ge(1), Le(8)] = 2

    def check_rate(self, rate: float) -> None:
        """Check that the memory of the filter is within rounding."""
        if self.cutoff < LEAST_CUTOFF * rate:
            raise SettingsError(
                f"{self.kind}: cutoff = {self.cutoff:g} Hz is too low for a rate of {rate:g} Hz; "
                f"raise it to {LEAST_CUTOFF * rate:g} Hz or more"
            )

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench behind the filter, (M, 6) [N, N m]."""
        from scipy.signal import butter, cont2discrete, lfilter, lfilter_zi

        del rng
        step = sampling_time(time)
        poles = butter(self.order, 2 * np.pi * self.cutoff, analog=True, output="zpk")[
            1
        ]
        for pole in poles[poles.imag > -1e-9 * abs(poles)]:  # of a pair the upper one
            below = np.poly(
                [pole, pole.conj()] if pole.imag > 1e-9 * abs(pole) else [pole]
            ).real
            above, below, _ = cont2discrete((below[-1:], below), step, "foh")
            rest = lfilter_zi(above[0], below)[:, None] * signal[0]
            signal = lfilter(above[0], below, signal, axis=0, zi=rest)[0]
        return signal
