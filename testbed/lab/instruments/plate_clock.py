"""What comes late, at other instants, or not at all from the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.lab.instruments.fault import Fault, PlateFault, StageOrder
from testbed.lab.kind_table import key

_LEAST_CUTOFF = 1e-5
"""Of a filter, in sampling rates: below, its coefficients drown in rounding."""


@dataclass(frozen=True)
class PlateAntiAliasFilter(PlateFault):
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
    place: ClassVar[StageOrder] = StageOrder.FILTER
    cutoff: float = key(100.0, positive=True)
    order: int = key(2, least=1, most=8, whole=True)

    def check_rate(self, rate: float) -> None:
        """Whether the filter's memory is not beyond counting."""
        if self.cutoff < _LEAST_CUTOFF * rate:
            raise SettingsError(
                f"{self.kind}: cutoff = {self.cutoff:g} Hz is too low for a rate of {rate:g} Hz; "
                f"raise it to {_LEAST_CUTOFF * rate:g} Hz or more"
            )

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench behind the filter, (M, 6) [N, N m]."""
        from scipy.signal import butter, cont2discrete, lfilter, lfilter_zi

        del rng
        step = (time[-1] - time[0]) / (len(time) - 1)
        poles = butter(self.order, 2 * np.pi * self.cutoff, analog=True, output="zpk")[1]
        for pole in poles[poles.imag > -1e-9 * abs(poles)]:  # of a pair the upper one
            below = np.poly([pole, pole.conj()] if pole.imag > 1e-9 * abs(pole) else [pole]).real
            above, below, _ = cont2discrete((below[-1:], below), step, "foh")
            rest = lfilter_zi(above[0], below)[:, None] * signal[0]
            signal = lfilter(above[0], below, signal, axis=0, zi=rest)[0]
        return signal


@dataclass(frozen=True)
class PlateDelay(PlateFault):
    """Skew: plate samples that are older than the joints' of the same time, by a constant delay.

    Source    Two loggers started by software: one sample at a thousand a second.

    Attributes:
        delay: How late the plate is; negative if it is early [s].
    """

    kind: ClassVar[str] = "plate_delay"
    place: ClassVar[StageOrder] = StageOrder.CLOCK
    delay: float = key(1e-3)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench of another time, (M, 6) [N, N m]; held before the first sample."""
        del rng
        return at_times(signal, time, time - self.delay) if self.delay else signal


@dataclass(frozen=True)
class PlateClockRate(PlateFault):
    """A plate with a clock of its own that runs too fast: a skew that grows from time 0.

    Source    Tolerance of quartz clocks in data sheets: 50 parts in a million.

    Attributes:
        error: Relative; the sample of time t is of t / (1 + error).
    """

    kind: ClassVar[str] = "plate_clock_rate"
    place: ClassVar[StageOrder] = StageOrder.CLOCK
    error: float = key(5e-5, least=-0.5, most=1.0)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench of earlier and earlier times, (M, 6) [N, N m]; held beyond its ends."""
        del rng
        return at_times(signal, time, time / (1 + self.error)) if self.error else signal


@dataclass(frozen=True)
class PlateDroppedSamples(PlateFault):
    """Samples that are lost on the way, and the ones before them repeated.

    Source    A bus without retransmission: one sample in a thousand.

    Attributes:
        share: Of the samples, each lost by chance.
    """

    kind: ClassVar[str] = "plate_dropped_samples"
    place: ClassVar[StageOrder] = StageOrder.LINE
    share: float = key(1e-3, least=0, most=1)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench with samples repeated, (M, 6) [N, N m]."""
        del time
        lost = rng.random(len(signal)) < self.share
        last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(signal))))
        return signal[last]


def at_times(signal: Array, time: Array, wanted: Array) -> Array:
    """A signal at other instants; before the first and after the last sample it is held.

    Args:
        signal: (M, k).
        time: Of its samples, (M,) [s].
        wanted: (L,) [s].
    """
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(time, signal, k=min(5, len(time) - 1))
    found: Array = spline(np.clip(wanted, time[0], time[-1]))
    return found


FAULTS: tuple[type[Fault], ...] = (
    PlateAntiAliasFilter,
    PlateDelay,
    PlateClockRate,
    PlateDroppedSamples,
)
"""All of the plate's clock and line."""
