"""Errors of encoders and of torques that drives report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.lab.instruments.fault import EncoderFault, Fault, GainFault, StageOrder, TorqueFault
from testbed.lab.kind_table import PerJoint, each_joint, key


class NoiseFault(Fault):
    """White noise of standard deviation `sigma`, joint by joint."""

    sigma: PerJoint

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Signal with noise, (M, n)."""
        del time
        return signal + each_joint(self.sigma) * rng.normal(size=signal.shape)


class OffsetFault(Fault):
    """Constant `error` of a signal, joint by joint."""

    error: PerJoint

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Signal plus the error, (M, n)."""
        del time, rng
        return signal + each_joint(self.error)


@dataclass(frozen=True)
class EncoderNoise(NoiseFault, EncoderFault):
    """White noise on positions, besides that of `measurement.encoder_noise`.

    Source    Interpolation noise of encoders of the 16-bit class.

    Attributes:
        sigma: Standard deviation [rad or m].
    """

    kind: ClassVar[str] = "encoder_noise"
    place: ClassVar[StageOrder] = StageOrder.NOISE
    sigma: PerJoint = key(1e-4, "joints", least=0)


@dataclass(frozen=True)
class EncoderResolution(EncoderFault):
    """Positions rounded to the nearest count.

    Source    16 bits a turn: 9.6e-5 rad.

    Attributes:
        count: Least count; 0 for none [rad or m].
    """

    kind: ClassVar[str] = "encoder_resolution"
    place: ClassVar[StageOrder] = StageOrder.CONVERTER
    count: PerJoint = key(1e-4, "joints", least=0)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Positions in whole counts, (M, n) [rad or m]."""
        del time, rng
        count = each_joint(self.count)
        step = np.where(count > 0, count, 1.0)
        return np.where(count > 0, step * np.round(signal / step), signal)


@dataclass(frozen=True)
class EncoderInstantSampling(EncoderFault):
    """Positions at the first instant of each sample, while all else is the mean over it.

    What a controller's counter does: it latches. Against a plate that averages, positions are
    half a sampling time early. Exact for smooth motions (`first_instants`).

    Source    How counters work; no size.
    """

    kind: ClassVar[str] = "encoder_instant_sampling"
    place: ClassVar[StageOrder] = StageOrder.CLOCK

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Positions at instants, (M, n) [rad or m], of means over samples."""
        del rng
        return first_instants(signal, time)


@dataclass(frozen=True)
class EncoderZeroError(OffsetFault, EncoderFault):
    """A constant error of the positions: wrong zeros.

    Source    An arm zeroed by eye at engraved marks: 0.2 degrees.

    Attributes:
        error: What is shown too much [rad or m].
    """

    kind: ClassVar[str] = "encoder_zero_error"
    place: ClassVar[StageOrder] = StageOrder.SENSOR
    error: PerJoint = key(3.5e-3, "joints", "sign")


@dataclass(frozen=True)
class EncoderGain(GainFault, EncoderFault):
    """Positions on a wrong scale: a wrong gear ratio or pitch.

    Source    A ratio typed with two digits, 1 %.

    Attributes:
        error: Relative; 0.01 shows 1 % too much.
    """

    kind: ClassVar[str] = "encoder_gain"
    place: ClassVar[StageOrder] = StageOrder.SENSOR
    error: PerJoint = key(0.01, "joints", "sign")


@dataclass(frozen=True)
class EncoderEccentricity(EncoderFault):
    """Eccentric discs: an error that repeats with every turn.

    Shown is q + amplitude sin(2 pi q / period + phase). A sliding joint has the period of its
    screw's or belt's turn.

    Source    10 um at a radius of 25 mm, as data sheets of ring encoders allow on mounting.

    Attributes:
        amplitude: Of the wave [rad or m].
        period: Of the wave [rad or m].
        phase: Of the wave at q = 0; drawn if left out [rad].
    """

    kind: ClassVar[str] = "encoder_eccentricity"
    place: ClassVar[StageOrder] = StageOrder.SENSOR
    amplitude: PerJoint = key(4e-4, "joints")
    period: PerJoint = key(2 * np.pi, "joints", positive=True)
    phase: PerJoint | None = key(None, "joints", "phase")

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Positions with the wave, (M, n) [rad or m]."""
        del time, rng
        turn = 2 * np.pi * signal / each_joint(self.period) + each_joint(self.phase or 0.0)
        return signal + each_joint(self.amplitude) * np.sin(turn)


def first_instants(means: Array, time: Array) -> Array:
    """A signal at the first instant of each sample, from its means over the samples.

    The means' sum is the signal's integral at the samples' edges, exactly; the spline through
    it is differentiated there.

    Args:
        means: (M, k).
        time: Of the samples' first instants, uniform, (M,) [s].
    """
    from scipy.interpolate import make_interp_spline

    step = (time[-1] - time[0]) / (len(time) - 1)
    middle = means.mean(axis=0)
    edges = np.append(time, time[-1] + step)
    sums = np.cumsum(np.vstack([np.zeros_like(middle), means - middle]), axis=0) * step
    spline = make_interp_spline(edges, sums, k=min(5, len(time)))
    found: Array = spline.derivative()(time) + middle
    return found


@dataclass(frozen=True)
class TorqueConstantError(GainFault, TorqueFault):
    """Torques reported with wrong torque constants.

    Source    Tolerances of motors' torque constants in data sheets: 5 to 10 %.

    Attributes:
        error: Relative: 0.08 reports 8 % too much.
    """

    kind: ClassVar[str] = "torque_constant_error"
    place: ClassVar[StageOrder] = StageOrder.SENSOR
    error: PerJoint = key(0.05, "joints", "sign")


@dataclass(frozen=True)
class TorqueOffset(OffsetFault, TorqueFault):
    """A constant error of the reported torques.

    Source    Zero error of Hall-effect current sensors in data sheets: 0.5 to 1 % of their
        range, of joints of 100 N m.

    Attributes:
        error: What is reported too much [N m or N].
    """

    kind: ClassVar[str] = "torque_offset"
    place: ClassVar[StageOrder] = StageOrder.NOISE
    error: PerJoint = key(1.0, "joints", "sign")


@dataclass(frozen=True)
class TorqueNoise(NoiseFault, TorqueFault):
    """White noise on the reported torques, besides that of `measurement.torque_noise`.

    Source    Noise of current sensors in data sheets: 0.5 % of their range.

    Attributes:
        sigma: Standard deviation [N m or N].
    """

    kind: ClassVar[str] = "torque_noise"
    place: ClassVar[StageOrder] = StageOrder.NOISE
    sigma: PerJoint = key(0.5, "joints", least=0)


FAULTS: tuple[type[Fault], ...] = (
    EncoderInstantSampling,
    EncoderZeroError,
    EncoderGain,
    EncoderEccentricity,
    EncoderNoise,
    EncoderResolution,
    TorqueConstantError,
    TorqueOffset,
    TorqueNoise,
)
"""All of this device."""
