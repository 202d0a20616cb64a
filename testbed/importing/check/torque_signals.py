"""Low-pass filtered joint torques and motion of a log, at a limited number of instants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.recordings.channels import ChannelFault, excluded_samples
from testbed.core.recordings.recording import Recording
from testbed.importing.check.remedies import Hypothesis, corrected_positions

CUTOFF = 4.0
"""Cutoff of the low-pass filter [Hz], at most a seventh of the sampling rate."""

MAX_INSTANTS_PER_SECOND, MAX_INSTANTS, MIN_INSTANTS = 8.0, 240, 12
"""Largest number of instants per second, largest number in all, and least number for a usable
recording."""

DRY_SPEED_SHARE, STRIBECK_SPEED_SHARE = 0.03, 0.15
"""Speeds, relative to a joint's largest speed, over which dry friction changes sign, and Stribeck
friction decays."""

MAX_CONSTANT_SHARE = 0.5
"""Share of samples at one value from which a channel is dead."""


@dataclass(frozen=True, eq=False)
class TorqueSignals:
    """Signals of n joints at T instants, from M samples.

    Attributes:
        q: Positions, (T, n) [rad or m].
        qd: Velocities, (T, n) [rad/s or m/s].
        qdd: Accelerations, (T, n) [rad/s^2 or m/s^2].
        friction: Viscous, dry, rotor and Stribeck torques, each of about unit size, (T, n, 4).
        valid: Mask of valid torques, (T, n).
        low_passed_torque: Low-pass filtered torques at all samples, (M, n) [N m or N].
        sample_indices: Indices of the instants' samples, (T,).
        rate: Sampling rate [Hz].
        has_measured_velocity: True if measured velocities confirm order and signs of the positions.
    """

    q: Array
    qd: Array
    qdd: Array
    friction: Array
    valid: NDArray[np.bool_]
    low_passed_torque: Array
    sample_indices: NDArray[np.intp]
    rate: float
    has_measured_velocity: bool

    @property
    def torque(self) -> Array:
        """Torques at the instants, (T, n) [N m or N]."""
        return self.low_passed_torque[self.sample_indices]

    def delayed(self, delay: float, lag: float = 0.0) -> Array:
        """Torques with a delay and a first-order lag removed, (T, n) [N m or N].

        Args:
            delay: Delay of the torques [s].
            lag: Time constant of the first-order lag of the torques [s].
        """
        torque = self.low_passed_torque
        if lag:
            torque = torque + lag * _derivative(torque, self.rate)
        return _interpolation(torque, self.sample_indices + delay * self.rate)

    def thinned(self, count: int) -> TorqueSignals:
        """Signals thinned to a maximum number of instants.

        Args:
            count: Largest number of instants.
        """
        step = max(1, -(-len(self.sample_indices) // count))
        return replace(
            self,
            q=self.q[::step],
            qd=self.qd[::step],
            qdd=self.qdd[::step],
            friction=self.friction[::step],
            valid=self.valid[::step],
            sample_indices=self.sample_indices[::step],
        )

    def with_corrections(self, *hypotheses: Hypothesis) -> TorqueSignals:
        """Signals corrected by hypotheses, applied in order.

        Args:
            hypotheses: Hypotheses on positions and torques.
        """
        signals = self
        for each in hypotheses:
            signals = _CORRECTIONS.get(each.kind, _with_corrected_positions)(
                signals, each
            )
        return signals


def torque_signals(
    recording: Recording, faults: Sequence[ChannelFault] = ()
) -> TorqueSignals | None:
    """Low-pass filtered torque and motion signals; None for too short a recording.

    The signals are limited to 4 Hz and taken at 8 instants per second, at most 240, without the
    filter's transients at both ends; fewer than 12 instants are too few. Velocities and
    accelerations are derivatives of the positions.

    Args:
        recording: Recording in the robot's order of joints.
        faults: Faults of channels; faulty samples are marked invalid.
    """
    rate = recording.rate
    cutoff = min(CUTOFF, rate / 7)
    margin = int(rate / cutoff)
    usable_count = recording.samples - 2 * margin
    step = max(rate / MAX_INSTANTS_PER_SECOND, usable_count / MAX_INSTANTS, 1.0)
    if usable_count < MIN_INSTANTS * step:
        return None
    at = np.unique(np.arange(margin, margin + usable_count, step).astype(int))
    low_pass = partial(_low_passed, rate=rate, cutoff=cutoff)
    q = low_pass(recording.position)
    qd = _derivative(q, rate)
    qdd = _derivative(qd, rate)
    return TorqueSignals(
        q[at],
        qd[at],
        qdd[at],
        _friction_columns(qd, qdd, low_pass)[at],
        _valid_mask(recording, faults, at, margin),
        low_pass(recording.measured("torque")),
        at,
        rate,
        "velocity" in recording.signals,
    )


def _low_passed(signal: Array, rate: float, cutoff: float) -> Array:
    """Zero-phase low-pass of a signal, with the squared gain of a Butterworth filter, (M, n).

    The signal is continued point-symmetrically at both ends: the deviations from the line between
    its ends are a sine series, whose coefficients are multiplied by the gain.

    Args:
        signal: Samples, (M, n).
        rate: Sampling rate [Hz].
        cutoff: Cutoff frequency of the third-order Butterworth filter [Hz].
    """
    from scipy.fft import dst, idst  # scipy.signal takes a second

    count = len(signal) - 1
    filtered = np.linspace(signal[0], signal[-1], count + 1)
    warped = np.tan(np.pi * np.arange(1, count) / (2 * count))
    relative = warped / np.tan(np.pi * cutoff / rate)
    series = dst((signal - filtered)[1:-1], 1, axis=0)
    filtered[1:-1] += idst(series / (1 + relative[:, None] ** 6), 1, axis=0)
    return filtered


def _friction_columns(
    qd: Array, qdd: Array, low_pass: Callable[[Array], Array]
) -> Array:
    """Viscous, dry, rotor and Stribeck torques of about unit size, (M, n, 4).

    With v the 98th percentile of a joint's speed, the columns are: qd / v; the smoothed sign
    tanh(qd / (0.03 v)); qdd divided by its rms; and this sign times exp(-(qd / (0.15 v))^2). Dry
    and Stribeck torques are low-pass filtered.
    """
    fastest = np.percentile(np.abs(qd), 98, axis=0) + 1e-9
    sense = np.tanh(qd / (DRY_SPEED_SHARE * fastest))
    stribeck = sense * np.exp(-((qd / (STRIBECK_SPEED_SHARE * fastest)) ** 2))
    rotor = qdd / (np.sqrt((qdd**2).mean(axis=0)) + 1e-9)
    return np.stack([qd / fastest, low_pass(sense), rotor, low_pass(stribeck)], axis=-1)


def _valid_mask(
    recording: Recording,
    faults: Sequence[ChannelFault],
    at: NDArray[np.intp],
    reach: int,
) -> NDArray[np.bool_]:
    """Mask of valid torques, without dead channels and faulty samples, (T, n).

    Args:
        recording: Recording in the robot's order of joints.
        faults: Faults of channels.
        at: Indices of the instants' samples, (T,).
        reach: Half-length of the filter in samples.
    """
    is_alive = [not _is_constant(each) for each in recording.measured("torque").T]
    valid = np.tile(is_alive, (len(at), 1))
    channels = [f"torque/{name}" for name in recording.names]
    for k, spans in enumerate(excluded_samples(faults, channels, (), reach)):
        begin, end = (spans + np.array([-reach, reach])).T
        is_faulty = (at[:, None] >= begin) & (at[:, None] < end)
        valid[:, k] &= ~is_faulty.any(axis=1)
    return valid


def _is_constant(channel: Array) -> bool:
    """Test whether a channel, (M,), has one value at more than half of the samples."""
    return bool((channel == np.median(channel)).mean() > MAX_CONSTANT_SHARE)


def _derivative(signal: Array, rate: float) -> Array:
    """Time derivative of a signal by fourth-order central differences, (M, n)."""
    slope = np.gradient(signal, axis=0)
    slope[2:-2] = (8 * (signal[3:-1] - signal[1:-3]) - (signal[4:] - signal[:-4])) / 12
    return np.asarray(slope * rate)


def _interpolation(signal: Array, at: AnyArray) -> Array:
    """Signal, (T, n), interpolated linearly at fractional samples; constant beyond its ends."""
    samples = np.arange(len(signal))
    return np.column_stack([np.interp(at, samples, each) for each in signal.T])


def _with_corrected_positions(
    signals: TorqueSignals, hypothesis: Hypothesis
) -> TorqueSignals:
    """Signals with positions, derivatives and friction columns corrected by a hypothesis."""
    zero = np.zeros(signals.q.shape[1])
    still = np.zeros_like(signals.q[:1])
    constant = corrected_positions(hypothesis, still, zero)
    q, qd, qdd = (
        corrected_positions(hypothesis, each, zero)
        for each in (signals.q, signals.qd, signals.qdd)
    )
    friction = signals.friction
    if hypothesis.kind == "position_order":
        friction = friction[:, list(hypothesis.values)]
    elif hypothesis.kind == "position_sign":
        friction = friction.copy()
        friction[:, list(hypothesis.joints)] *= -1
    return replace(
        signals, q=q, qd=qd - constant, qdd=qdd - constant, friction=friction
    )


def _with_torque_order(signals: TorqueSignals, hypothesis: Hypothesis) -> TorqueSignals:
    """Signals with the torques in another order."""
    order = list(hypothesis.values)
    return replace(
        signals,
        low_passed_torque=signals.low_passed_torque[:, order],
        valid=signals.valid[:, order],
    )


def _with_torque_factors(
    signals: TorqueSignals, hypothesis: Hypothesis
) -> TorqueSignals:
    """Signals with torque signs reversed or torque scale factors removed."""
    factors = np.ones(signals.low_passed_torque.shape[1])
    factors[list(hypothesis.joints)] = np.divide(1.0, hypothesis.values or -1.0)
    return replace(signals, low_passed_torque=signals.low_passed_torque * factors)


def _with_delay_removed(
    signals: TorqueSignals, hypothesis: Hypothesis
) -> TorqueSignals:
    """Signals with the delay of the torques removed."""
    (delay,) = hypothesis.values
    instants = np.arange(len(signals.low_passed_torque)) + delay * signals.rate
    return replace(
        signals, low_passed_torque=_interpolation(signals.low_passed_torque, instants)
    )


def _identity(signals: TorqueSignals, _: Hypothesis) -> TorqueSignals:
    """Unchanged signals."""
    return signals


_CORRECTIONS = {
    "torque_order": _with_torque_order,
    "torque_sign": _with_torque_factors,
    "torque_size": _with_torque_factors,
    "delay": _with_delay_removed,
    "gravity": _identity,
    "spring": _identity,
}
