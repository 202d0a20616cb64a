"""Anti-aliasing filter of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Le

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder, sampling_time

MIN_RELATIVE_CUTOFF = 1e-5
"""Smallest cutoff relative to the sampling rate; below it, rounding dominates the coefficients."""


@dataclass(frozen=True)
class PlateAntiAliasFilter(SensorError):
    """Low-pass filter before the plate's converter; joint signals are not filtered.

    The causal Butterworth filter is exact for signals that are linear between samples. Its initial
    state is the steady state for the first sample. A second-order filter delays slow signals by
    sqrt(2) / (2 pi cutoff).

    Source    Filters of bridge amplifiers in data sheets: second order, a tenth of the sampling
        rate.

    Attributes:
        cutoff: Cutoff frequency, at half the power [Hz].
        order: Order, 1 to 8.
    """

    kind: ClassVar[str] = "plate_anti_alias_filter"
    signal: ClassVar[Signal] = "wrench"
    stage: ClassVar[StageOrder] = StageOrder.FILTER
    cutoff: Annotated[float, Gt(0)] = 100.0
    order: Annotated[int, Ge(1), Le(8)] = 2

    def check_rate(self, rate: float) -> None:
        """Check that the cutoff is high enough for small rounding errors of the filter.

        Args:
            rate: Sampling rate [Hz].

        Raises:
            SettingsError: The cutoff is below `MIN_RELATIVE_CUTOFF` of the rate.
        """
        if self.cutoff < MIN_RELATIVE_CUTOFF * rate:
            raise SettingsError(
                f"{self.kind}: cutoff = {self.cutoff:g} Hz is too low for a rate of {rate:g} Hz; "
                f"raise it to {MIN_RELATIVE_CUTOFF * rate:g} Hz or more"
            )

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Filtered wrench, (M, 6) [N, N m]."""
        from scipy.signal import butter, cont2discrete, lfilter, lfilter_zi

        del rng
        step = sampling_time(time)
        poles = butter(self.order, 2 * np.pi * self.cutoff, analog=True, output="zpk")[
            1
        ]
        for pole in poles[
            poles.imag > -1e-9 * abs(poles)
        ]:  # one pole of each conjugate pair
            denominator = np.poly(
                [pole, pole.conj()] if pole.imag > 1e-9 * abs(pole) else [pole]
            ).real
            numerator, denominator, _ = cont2discrete(
                (denominator[-1:], denominator), step, "foh"
            )
            initial_state = lfilter_zi(numerator[0], denominator)[:, None] * signal[0]
            signal = lfilter(
                numerator[0], denominator, signal, axis=0, zi=initial_state
            )[0]
        return signal
