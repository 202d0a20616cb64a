"""What the plate's mechanics and electronics do to the wrench that it feels, and to its tare."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from testbed.arrays import Array
from testbed.errors import SettingsError
from testbed.instruments.fault import (
    FULL_SCALE,
    Fault,
    Matrix,
    PerAxis,
    PerChannel,
    Place,
    Rig,
    Signal,
    each_channel,
)
from testbed.kind_table import hidden, key
from testbed.robot.inertia import from_vector


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


_MOST_SAMPLES = 1e6
"""Of a tare: they are held in memory."""


@dataclass(frozen=True)
class PlateGain(Fault):
    """Channels on wrong scales.

    Source    Accuracy of force plates and six-axis sensors in data sheets: 0.5 %.

    Attributes:
        error: Relative; 0.005 shows 0.5 % too much.
    """

    kind: ClassVar[str] = "plate_gain"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.SENSOR
    error: PerChannel = key(0.005, "channels", "sign")

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench on wrong scales, (M, 6) [N, N m]."""
        del time, rng
        scaled: Array = (1 + np.asarray(self.error)) * signal
        return scaled


@dataclass(frozen=True)
class PlateCrosstalk(Fault):
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
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.SENSOR
    size: float = key(0.01, least=0, most=1)
    matrix: Matrix | None = key(None, "matrix")
    full_scale: tuple[float, ...] = hidden(FULL_SCALE)

    def sample(self, rig: Rig, rng: np.random.Generator) -> Self:
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
class PlatePose(Fault):
    """A plate that is turned and shifted against the bedplate frame.

    The plate's frame has the origin p and the axes R, both in the bedplate frame; it shows
    R^T F and R^T (M - p x F), of robot and tare alike.

    Source    Alignment with square and ruler: 0.2 degrees, 1 mm.

    Attributes:
        rotation: Vector of the rotation R [rad].
        translation: p [m].
    """

    kind: ClassVar[str] = "plate_pose"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.SENSOR
    rotation: PerAxis = key(3.5e-3, "axes", "sign")
    translation: PerAxis = key(1e-3, "axes", "sign")

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench in the plate's own frame, (M, 6) [N, N m]."""
        del time, rng
        vector, origin = (np.broadcast_to(v, 3) for v in (self.rotation, self.translation))
        return in_frame(signal, vector, origin)


@dataclass(frozen=True)
class PlateOriginHeight(Fault):
    """Moments about a point above or below the origin: a cover not counted, a wrong data sheet.

    Source    [BS90] and data sheets: origins of force plates lie 30 to 60 mm below the cover,
        and are known to some millimetres.

    Attributes:
        height: Of the true origin over the supposed one [m].
    """

    kind: ClassVar[str] = "plate_origin_height"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.SENSOR
    height: float = key(5e-3)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench about the other origin, (M, 6) [N, N m]."""
        del time, rng
        return in_frame(signal, np.zeros(3), np.array([0.0, 0.0, self.height]))


@dataclass(frozen=True)
class PlateSaturation(Fault):
    """Saturation: a range too small for the motion, at whose ends channels stop.

    By default the range covers a share of each channel's swing in this recording, around its
    middle: amplifiers are set to zero with the robot on the plate. `limit` gives it instead.

    Source    A range chosen for nine tenths of the motion.

    Attributes:
        covered: Share of the swing between least and greatest value.
        limit: Largest absolute value that is shown instead [N, N m].
    """

    kind: ClassVar[str] = "plate_saturation"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.RANGE
    covered: PerChannel = key(0.9, "channels", least=0)
    limit: PerChannel | None = key(None, "channels", positive=True)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The wrench within the range, (M, 6) [N, N m]."""
        del time, rng
        if self.limit is not None:
            limit = np.asarray(self.limit)
            return np.clip(signal, -limit, limit)
        low, high = signal.min(axis=0), signal.max(axis=0)
        cut = (1 - np.asarray(self.covered)) * (high - low) / 2
        return np.clip(signal, low + cut, high - cut)


@dataclass(frozen=True)
class PlateConverter(Fault):
    """An analog-to-digital converter: values in whole counts, within its range.

    Its range is `full_scale` of the instrument, to both sides.

    Source    12 bits, as data acquisition cards had; 16 are common now.

    Attributes:
        bits: Of a count, 1 to 32.
    """

    kind: ClassVar[str] = "plate_converter"
    signal: ClassVar[Signal] = "wrench"
    place: ClassVar[Place] = Place.CONVERTER
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
    place: ClassVar[Place] = Place.LINE
    seconds: float = key(5.0, positive=True)
    before: float = key(60.0, least=0)

    def check_rate(self, rate: float) -> None:
        """Whether its samples have room."""
        if self.seconds * rate > _MOST_SAMPLES:
            raise SettingsError(
                f"{self.kind}: {self.seconds:g} s at {rate:g} Hz are more than {_MOST_SAMPLES:.0e} "
                "samples; measure for a shorter time"
            )

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
        mean: Array = np.broadcast_to(signal.mean(axis=0), signal.shape)
        return mean


def in_frame(wrench: Array, rotation: Array, origin: Array) -> Array:
    """A wrench as a frame shows it that lies elsewhere.

    Args:
        wrench: (M, 6) [N, N m], bedplate axes, about its origin.
        rotation: Rotation vector of the frame, (3,) [rad].
        origin: Of the frame, (3,) [m], bedplate axes.
    """
    force, moment = wrench[:, :3], wrench[:, 3:]
    turn = from_vector(rotation)
    return np.hstack([force @ turn, (moment - np.cross(origin, force)) @ turn])


FAULTS: tuple[type[Fault], ...] = (
    PlateGain,
    PlateCrosstalk,
    PlatePose,
    PlateOriginHeight,
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
