"""What the plate's mechanics and electronics do to the wrench that it feels, and to its tare."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform
from testbed.core.robot.rotations import from_vector
from testbed.lab.instruments.fault import (
    FULL_SCALE,
    Fault,
    GainFault,
    Matrix,
    PerAxis,
    PerChannel,
    PlateFault,
    Signal,
    StageOrder,
)
from testbed.lab.kind_table import hidden, key


class AddedWrench(PlateFault):
    """Error added to the plate's channels: their sizes times a pattern over time."""

    place: ClassVar[StageOrder] = StageOrder.NOISE
    force: PerAxis
    moment: PerAxis

    @abstractmethod
    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Error of channels of size one, (M, 6) or (M, 1).

        Args:
            signal: Wrench before the fault, (M, 6) [N, N m].
            time: (M,) [s].
            rng: The fault's own random numbers.
        """

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Wrench with the error, (M, 6) [N, N m]."""
        sizes = [np.broadcast_to(np.asarray(each), 3) for each in (self.force, self.moment)]
        return signal + np.concatenate(sizes) * self.pattern(signal, time, rng)


@dataclass(frozen=True)
class PlateNoise(AddedWrench):
    """White noise on the plate's channels, besides that of `measurement.force_noise`.

    Source    Our own choice: the noise of experiments/table6.toml, of a plate for 1 kN.

    Attributes:
        force: Standard deviation of the forces [N].
        moment: Standard deviation of the moments [N m].
    """

    kind: ClassVar[str] = "plate_noise"
    force: PerAxis = key(0.5, "axes", least=0)
    moment: PerAxis = key(0.1, "axes", least=0)

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Noise of variance one, (M, 6)."""
        del time
        return rng.normal(size=signal.shape)


@dataclass(frozen=True)
class PlateBias(AddedWrench):
    """A constant error of the zero.

    Source    Zero error of amplifiers in data sheets: 0.2 to 0.5 % of full scale.

    Attributes:
        force: What the forces show too much [N].
        moment: What the moments show too much [N m].
    """

    kind: ClassVar[str] = "plate_bias"
    force: PerAxis = key(2.0, "axes", "sign")
    moment: PerAxis = key(0.5, "axes", "sign")

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """One, at every sample."""
        del time, rng
        return np.ones_like(signal)


@dataclass(frozen=True)
class PlateDrift(AddedWrench):
    """An error of the zero that grows in proportion to time, from none at time 0.

    Source    Drift of charge amplifiers in data sheets, 0.01 N/s, five times over: one that
        warms up.

    Attributes:
        force: Of the forces [N/s].
        moment: Of the moments [N m/s].
    """

    kind: ClassVar[str] = "plate_drift"
    force: PerAxis = key(0.05, "axes", "sign")
    moment: PerAxis = key(0.01, "axes", "sign")

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Time, (M, 1) [s]."""
        del signal, rng
        return time[:, None]


@dataclass(frozen=True)
class PlateRandomWalk(AddedWrench):
    """An error of the zero that wanders at random, from none at time 0.

    Source    Our own choice: after a second it is where the drift of 0.05 N/s would be.

    Attributes:
        force: Standard deviation of the forces after a second [N/sqrt(s)].
        moment: Standard deviation of the moments after a second [N m/sqrt(s)].
    """

    kind: ClassVar[str] = "plate_random_walk"
    force: PerAxis = key(0.05, "axes", least=0)
    moment: PerAxis = key(0.01, "axes", least=0)

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Random walk of variance one a second, (M, 6) [sqrt(s)]."""
        spread = np.sqrt(np.append(abs(time[0]), np.diff(time)))
        return np.cumsum(spread[:, None] * rng.normal(size=signal.shape), axis=0)


@dataclass(frozen=True)
class PlateColouredNoise(AddedWrench):
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
    force: PerAxis = key(0.5, "axes", least=0)
    moment: PerAxis = key(0.1, "axes", least=0)
    time_constant: float = key(0.3, positive=True)

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Noise of variance one, (M, 6)."""
        from scipy.signal import lfilter

        white = rng.normal(size=signal.shape)
        kept = np.exp(-_step(time) / self.time_constant)
        white[1:] *= np.sqrt(1 - kept**2)  # the first sample is as large as all others
        return np.asarray(lfilter([1.0], [1.0, -kept], white, axis=0))


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
    force: PerAxis = key(0.5, "axes", least=0)
    moment: PerAxis = key(0.1, "axes", least=0)
    lowest: float = key(0.01, positive=True)

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Noise of variance one, (M, 6)."""
        samples, step = len(signal), _step(time)
        around = 2 * samples  # so that the end forgets the start
        frequency = np.maximum(np.fft.rfftfreq(around, step), self.lowest)
        density = 1 / frequency
        # of a real signal the inner lines of the spectrum count twice
        twice = np.full(len(density), 2.0)
        twice[[0, -1]] = 1.0
        density *= around / (twice @ density)
        white = np.fft.rfft(rng.normal(size=(around, signal.shape[1])), axis=0)
        return np.fft.irfft(np.sqrt(density)[:, None] * white, around, axis=0)[:samples]


@dataclass(frozen=True)
class PlateHum(AddedWrench):
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
    force: PerAxis = key(2.0, "axes")
    moment: PerAxis = key(0.5, "axes")
    frequency: float = key(50.0, positive=True)
    phase: PerChannel | None = key(None, "channels", "phase")

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Sine of the mains, (M, 6)."""
        del signal, rng
        turn = 2 * np.pi * self.frequency * time[:, None] + np.asarray(self.phase or 0.0)
        return np.asarray(np.sin(turn))


def _step(time: Array) -> float:
    """Time between two samples [s]."""
    return float((time[-1] - time[0]) / (len(time) - 1))


@dataclass(frozen=True)
class PlateGain(GainFault, PlateFault):
    """Channels on wrong scales.

    Source    Accuracy of force plates and six-axis sensors in data sheets: 0.5 %.

    Attributes:
        error: Relative; 0.005 shows 0.5 % too much.
    """

    kind: ClassVar[str] = "plate_gain"
    place: ClassVar[StageOrder] = StageOrder.SENSOR
    error: PerChannel = key(0.005, "channels", "sign")


@dataclass(frozen=True)
class PlateCrosstalk(PlateFault):
    """Channels that show some of the others' loads, in proportion to their full scales.

    With D = diag(full scale) shown is (1 + D X D^-1) W. The off-diagonal entries of X are drawn
    between -size and size, unless `matrix` says what X is.

    Source    Crosstalk of six-component plates and sensors in data sheets: 1 to 2 % of full
        scale.

    Attributes:
        size: Largest entry, relative to full scale.
        matrix: X, six lists of six numbers: row by row, the channel that shows it; its diagonal
            are errors of the gains.
    """

    kind: ClassVar[str] = "plate_crosstalk"
    place: ClassVar[StageOrder] = StageOrder.SENSOR
    size: float = key(0.01, least=0, most=1)
    matrix: Matrix | None = key(None, "matrix")
    full_scale: tuple[float, ...] = hidden(FULL_SCALE)

    def sample(self, joints: int, rng: np.random.Generator) -> Self:
        """The same fault with a matrix."""
        if self.matrix is not None:
            return self
        mixed = self.size * rng.uniform(-1, 1, (6, 6)) * (1 - np.eye(6))
        return replace(self, matrix=mixed.tolist())

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench with some of every channel in every other, (M, 6) [N, N m]."""
        del time, rng
        scale = np.array(self.full_scale)
        mixing = self.size * (1 - np.eye(6)) if self.matrix is None else np.array(self.matrix)
        mixed: Array = signal + (signal / scale) @ mixing.T * scale
        return mixed


@dataclass(frozen=True)
class PlatePose(PlateFault):
    """A plate that is turned and shifted against the bedplate frame.

    The plate's frame has the origin p and the axes R, both in the bedplate frame; it shows
    R^T F and R^T (M - p x F), of robot and tare alike.

    Source    Alignment with square and ruler: 0.2 degrees, 1 mm.

    Attributes:
        rotation: Vector of the rotation R [rad].
        translation: p [m].
    """

    kind: ClassVar[str] = "plate_pose"
    place: ClassVar[StageOrder] = StageOrder.SENSOR
    rotation: PerAxis = key(3.5e-3, "axes", "sign")
    translation: PerAxis = key(1e-3, "axes", "sign")

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench in the plate's own frame, (M, 6) [N, N m]."""
        del time, rng
        vector, origin = (np.broadcast_to(v, 3) for v in (self.rotation, self.translation))
        X_BP = Transform(from_vector(vector), origin)
        return X_BP.inverse.wrench(signal)


@dataclass(frozen=True)
class PlateSaturation(PlateFault):
    """Saturation: a range too small for the motion, at whose ends channels stop.

    The range covers a share of each channel's swing in this recording, around its middle:
    amplifiers are set to zero with the robot on the plate.

    Source    A range chosen for nine tenths of the motion.

    Attributes:
        covered: Share of the swing between least and greatest value.
    """

    kind: ClassVar[str] = "plate_saturation"
    place: ClassVar[StageOrder] = StageOrder.RANGE
    covered: PerChannel = key(0.9, "channels", least=0)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench within the range, (M, 6) [N, N m]."""
        del time, rng
        low, high = signal.min(axis=0), signal.max(axis=0)
        cut = (1 - np.asarray(self.covered)) * (high - low) / 2
        return np.clip(signal, low + cut, high - cut)


@dataclass(frozen=True)
class PlateConverter(PlateFault):
    """An analog-to-digital converter: values in whole counts, within its range.

    Its range is `full_scale` of the instrument, to both sides.

    Source    12 bits, as data acquisition cards had; 16 are common now.

    Attributes:
        bits: Of a count, 1 to 32.
    """

    kind: ClassVar[str] = "plate_converter"
    place: ClassVar[StageOrder] = StageOrder.CONVERTER
    bits: int = key(12, least=1, most=32, whole=True)
    full_scale: tuple[float, ...] = hidden(FULL_SCALE)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench in whole counts, (M, 6) [N, N m]."""
        del time, rng
        half = 2 ** (self.bits - 1)
        count = np.array(self.full_scale) / half
        counted: Array = count * np.clip(np.round(signal / count), -half, half - 1)
        return counted


@dataclass(frozen=True)
class MeasuredTare(Fault):
    """A tare that is measured, not known: the mean of the plate at rest without the robot.

    The plate has the faults that it has in the recording (the same bias, the same crosstalk)
    and other noise. Its zero drifts and wanders in between.

    Source    Practice: five seconds, a minute before the robot is mounted and moves.

    Attributes:
        seconds: How long it is measured [s].
        before: How long before the recording that ends [s].
    """

    kind: ClassVar[str] = "measured_tare"
    signal: ClassVar[Signal] = "tare"
    place: ClassVar[StageOrder] = StageOrder.LINE
    seconds: float = key(5.0, positive=True, most=60)
    before: float = key(60.0, least=0)

    def instants(self, rate: float) -> Array:
        """When it is measured, with the recording's first sample at 0 [s].

        Args:
            rate: Samples a second [Hz].
        """
        samples = max(2, round(self.seconds * rate))
        return (np.arange(samples) - samples) / rate - self.before

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The mean, in every row, of what the plate shows at rest, (M, 6) [N, N m]."""
        del time, rng
        return np.broadcast_to(signal.mean(axis=0), signal.shape)


FAULTS: tuple[type[Fault], ...] = (
    PlateGain,
    PlateCrosstalk,
    PlatePose,
    PlateSaturation,
    PlateConverter,
    MeasuredTare,
    PlateBias,
    PlateDrift,
    PlateRandomWalk,
    PlateNoise,
    PlateColouredNoise,
    PlatePinkNoise,
    PlateHum,
)
"""All of this device."""
