"""What is added to the wrench on its way: constants, drifts, waves and noise of every colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.arrays import Array
from testbed.instruments.fault import Fault, PerAxis, PerChannel, Place, Signal, each_channel
from testbed.kind_table import key


@dataclass(frozen=True)
class PlateNoise(Fault):
    """White noise on the plate's channels, besides that of `measurement.force_noise`.

    Source    Our own choice: the noise of experiments/table6.toml, of a plate for 1 kN.

    Attributes:
        force: Standard deviation of the forces [N].
        moment: Standard deviation of the moments [N m].
    """

    kind: ClassVar[str] = "plate_noise"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.NOISE
    force: PerAxis = key(0.5, "axes", least=0)
    moment: PerAxis = key(0.1, "axes", least=0)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench with noise, (M, 6) [N, N m]."""
        del time
        noisy: Array = signal + each_channel(self.force, self.moment) * rng.normal(
            size=signal.shape
        )
        return noisy


@dataclass(frozen=True)
class PlateBias(Fault):
    """A constant error of the zero.

    Source    Zero error of amplifiers in data sheets: 0.2 to 0.5 % of full scale.

    Attributes:
        force: What the forces show too much [N].
        moment: What the moments show too much [N m].
    """

    kind: ClassVar[str] = "plate_bias"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.NOISE
    force: PerAxis = key(2.0, "axes", "sign")
    moment: PerAxis = key(0.5, "axes", "sign")

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench from a wrong zero, (M, 6) [N, N m]."""
        del time, rng
        shifted: Array = signal + each_channel(self.force, self.moment)
        return shifted


@dataclass(frozen=True)
class PlateDrift(Fault):
    """An error of the zero that grows in proportion to time, from none at time 0.

    Source    Drift of charge amplifiers in data sheets, 0.01 N/s, five times over: one that
        warms up.

    Attributes:
        force: Of the forces [N/s].
        moment: Of the moments [N m/s].
    """

    kind: ClassVar[str] = "plate_drift"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.NOISE
    force: PerAxis = key(0.05, "axes", "sign")
    moment: PerAxis = key(0.01, "axes", "sign")

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench on a slope, (M, 6) [N, N m]."""
        del rng
        sloped: Array = signal + time[:, None] * each_channel(self.force, self.moment)
        return sloped


@dataclass(frozen=True)
class PlateRandomWalk(Fault):
    """An error of the zero that wanders at random, from none at time 0.

    Source    Our own choice: after a second it is where the drift of 0.05 N/s would be.

    Attributes:
        force: Standard deviation of the forces after a second [N/sqrt(s)].
        moment: Standard deviation of the moments after a second [N m/sqrt(s)].
    """

    kind: ClassVar[str] = "plate_random_walk"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.NOISE
    force: PerAxis = key(0.05, "axes", least=0)
    moment: PerAxis = key(0.01, "axes", least=0)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench with a wandering zero, (M, 6) [N, N m]."""
        spread = np.sqrt(np.append(abs(time[0]), np.diff(time)))
        walk = np.cumsum(spread[:, None] * rng.normal(size=signal.shape), axis=0)
        wandering: Array = signal + each_channel(self.force, self.moment) * walk
        return wandering


@dataclass(frozen=True)
class PlateColouredNoise(Fault):
    """Coloured noise: autoregressive of first order, stationary.

    Its correlation fades as exp(-t / time_constant).

    Source    Our own choice: as much as the white noise of experiments/table6.toml, and slow
        enough to pass a filter of 5 Hz.

    Attributes:
        force: Standard deviation of the forces [N].
        moment: Standard deviation of the moments [N m].
        time_constant: Of the memory [s].
    """

    kind: ClassVar[str] = "plate_coloured_noise"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.NOISE
    force: PerAxis = key(0.5, "axes", least=0)
    moment: PerAxis = key(0.1, "axes", least=0)
    time_constant: float = key(0.3, positive=True)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench with noise, (M, 6) [N, N m]."""
        from scipy.signal import lfilter

        white = rng.normal(size=signal.shape)
        kept = np.exp(-_step(time) / self.time_constant)
        white[1:] *= np.sqrt(1 - kept**2)  # the first sample is as large as all others
        noisy: Array = signal + each_channel(self.force, self.moment) * lfilter(
            [1.0], [1.0, -kept], white, axis=0
        )
        return noisy


@dataclass(frozen=True)
class PlatePinkNoise(Fault):
    """Pink noise: of density 1/f, as of amplifiers at low frequencies, and level below `lowest`.

    Source    Our own choice: as much as the white noise of experiments/table6.toml.

    Attributes:
        force: Standard deviation of the forces [N].
        moment: Standard deviation of the moments [N m].
        lowest: Frequency below which the density grows no more [Hz].
    """

    kind: ClassVar[str] = "plate_pink_noise"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.NOISE
    force: PerAxis = key(0.5, "axes", least=0)
    moment: PerAxis = key(0.1, "axes", least=0)
    lowest: float = key(0.01, positive=True)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench with noise, (M, 6) [N, N m]."""
        samples, step = len(signal), _step(time)
        around = 2 * samples  # so that the end forgets the start
        frequency = np.maximum(np.fft.rfftfreq(around, step), self.lowest)
        density = 1 / frequency
        # of a real signal the inner lines of the spectrum count twice
        twice = np.full(len(density), 2.0)
        twice[[0, -1]] = 1.0
        density *= around / (twice @ density)
        white = np.fft.rfft(rng.normal(size=(around, signal.shape[1])), axis=0)
        pink = np.fft.irfft(np.sqrt(density)[:, None] * white, around, axis=0)[:samples]
        noisy: Array = signal + each_channel(self.force, self.moment) * pink
        return noisy


@dataclass(frozen=True)
class PlateHum(Fault):
    """Hum of the mains: a sine in every channel, each of its own phase.

    Source    50 Hz: frequency of the mains in Europe and most of Asia and Africa (60 Hz in
        America); as much as the bias.

    Attributes:
        force: Amplitude of the forces [N].
        moment: Amplitude of the moments [N m].
        frequency: Of the mains [Hz].
        phase: At time 0; drawn if left out [rad].
    """

    kind: ClassVar[str] = "plate_hum"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.NOISE
    force: PerAxis = key(2.0, "axes")
    moment: PerAxis = key(0.5, "axes")
    frequency: float = key(50.0, positive=True)
    phase: PerChannel | None = key(None, "channels", "phase")

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench with the mains, (M, 6) [N, N m]."""
        del rng
        turn = 2 * np.pi * self.frequency * time[:, None] + np.asarray(self.phase or 0.0)
        humming: Array = signal + each_channel(self.force, self.moment) * np.sin(turn)
        return humming


def _step(time: Array) -> float:
    """Time between two samples [s]."""
    return float((time[-1] - time[0]) / (len(time) - 1))


FAULTS: tuple[type[Fault], ...] = (
    PlateBias,
    PlateDrift,
    PlateRandomWalk,
    PlateNoise,
    PlateColouredNoise,
    PlatePinkNoise,
    PlateHum,
)
"""All that is added to the plate's signals."""
