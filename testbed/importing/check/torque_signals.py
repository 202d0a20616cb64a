"""Joint torques and motion of a log through one low-pass, at few instants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.recordings.channels import ChannelFault, left_out
from testbed.core.recordings.recording import Recording
from testbed.importing.check.remedies import Hypothesis, corrected

CUTOFF = 4.0
"""Corner of the low-pass [Hz]; a seventh of the rate where the recording is slower."""

A_SECOND, MOST, LEAST = 8.0, 240, 12
"""Instants a second at most, in all at most, and least of which a recording has a use."""

DRY, STRIBECK = 0.03, 0.15
"""Parts of a joint's largest speed over which dry friction changes its sense, and Stribeck's
friction falls."""

CONSTANT = 0.5
"""Part of the samples at one value from which a channel shows nothing."""


@dataclass(frozen=True, eq=False)
class TorqueSignals:
    """Signals of n joints at T instants.

    Attributes:
        q: Positions, (T, n) [rad or m].
        qd: Velocities, (T, n).
        qdd: Accelerations, (T, n).
        friction: Viscous, dry, rotor's and Stribeck's torques, each of about unit size, (T, n, 4).
        counted: Whether a torque counts, (T, n).
        filtered: Torques at all samples, (M, n) [N m or N].
        at: Samples of the instants, (T,).
        rate: Of the samples [Hz].
        pinned: Whether measured velocities bear out order and senses of the positions.
    """

    q: Array
    qd: Array
    qdd: Array
    friction: Array
    counted: NDArray[np.bool_]
    filtered: Array
    at: NDArray[np.intp]
    rate: float
    pinned: bool

    @property
    def torque(self) -> Array:
        """Torques at the instants, (T, n) [N m or N]."""
        return self.filtered[self.at]

    def delayed(self, delay: float, lag: float = 0.0) -> Array:
        """Torques with a delay and a first-order lag removed, (T, n) [N m or N].

        Args:
            delay: Of the torques [s].
            lag: Time constant of their low-pass [s].
        """
        torque = self.filtered
        if lag:
            torque = torque + lag * _derivative(torque, self.rate)
        return _interpolated(torque, self.at + delay * self.rate)

    def thinned(self, count: int) -> TorqueSignals:
        """Signals thinned to a maximum number of instants.

        Args:
            count: Of instants.
        """
        step = max(1, -(-len(self.at) // count))
        return replace(
            self,
            q=self.q[::step],
            qd=self.qd[::step],
            qdd=self.qdd[::step],
            friction=self.friction[::step],
            counted=self.counted[::step],
            at=self.at[::step],
        )

    def corrected(self, *hypotheses: Hypothesis) -> TorqueSignals:
        """Signals corrected by hypotheses, applied in order.

        Args:
            hypotheses: About columns of positions and torques.
        """
        signals = self
        for each in hypotheses:
            signals = _CORRECTIONS.get(each.kind, _with_positions)(signals, each)
        return signals


def torque_signals(
    recording: Recording, faults: Sequence[ChannelFault] = ()
) -> TorqueSignals | None:
    """Low-passed torque and motion signals; None for a recording too short.

    Args:
        recording: In the order of the robot's joints.
        faults: Of its channels; their samples do not count.
    """
    rate = recording.rate
    cutoff = min(CUTOFF, rate / 7)
    edge = int(rate / cutoff)
    inside = recording.samples - 2 * edge
    step = max(rate / A_SECOND, inside / MOST, 1.0)
    if inside < LEAST * step:
        return None
    at = np.unique(np.arange(edge, edge + inside, step).astype(int))
    low_pass = partial(_filtered, rate=rate, cutoff=cutoff)
    q = low_pass(recording.position)
    qd = _derivative(q, rate)
    qdd = _derivative(qd, rate)
    return TorqueSignals(
        q[at],
        qd[at],
        qdd[at],
        _friction(qd, qdd, low_pass)[at],
        _counted(recording, faults, at, edge),
        low_pass(recording.measured("torque")),
        at,
        rate,
        "velocity" in recording.signals,
    )


def _filtered(signal: Array, rate: float, cutoff: float) -> Array:
    """A signal through a low-pass without delay, (M, n)."""
    from scipy.signal import butter, sosfiltfilt

    low_pass = butter(3, cutoff / (rate / 2), output="sos")
    pad = min(3 * int(rate / cutoff), len(signal) - 2)
    return np.asarray(sosfiltfilt(low_pass, signal, axis=0, padlen=pad))


def _friction(qd: Array, qdd: Array, low_pass: Callable[[Array], Array]) -> Array:
    """Viscous, dry, rotor's and Stribeck's torques of about unit size, (M, n, 4)."""
    fastest = np.percentile(np.abs(qd), 98, axis=0) + 1e-9
    sense = np.tanh(qd / (DRY * fastest))
    slow = sense * np.exp(-((qd / (STRIBECK * fastest)) ** 2))
    rotor = qdd / (np.sqrt((qdd**2).mean(axis=0)) + 1e-9)
    return np.stack([qd / fastest, low_pass(sense), rotor, low_pass(slow)], axis=-1)


def _counted(
    recording: Recording,
    faults: Sequence[ChannelFault],
    at: NDArray[np.intp],
    reach: int,
) -> NDArray[np.bool_]:
    """Mask of valid torques, without dead channels and faulty samples, (T, n)."""
    alive = [not _constant(each) for each in recording.measured("torque").T]
    counted = np.tile(alive, (len(at), 1))
    channels = [f"torque/{name}" for name in recording.names]
    for k, spans in enumerate(left_out(faults, channels, (), reach)):
        begin, end = (spans + np.array([-reach, reach])).T
        spoiled = (at[:, None] >= begin) & (at[:, None] < end)
        counted[:, k] &= ~spoiled.any(axis=1)
    return counted


def _constant(channel: Array) -> bool:
    """Whether a channel is at one value at most samples, (M,)."""
    return bool((channel == np.median(channel)).mean() > CONSTANT)


def _derivative(signal: Array, rate: float) -> Array:
    """Central differences of fourth order, (M, n)."""
    slope = np.gradient(signal, axis=0)
    slope[2:-2] = (8 * (signal[3:-1] - signal[1:-3]) - (signal[4:] - signal[:-4])) / 12
    return np.asarray(slope * rate)


def _interpolated(signal: Array, at: AnyArray) -> Array:
    """A signal, (M, n), between its samples, held beyond its ends, (T, n)."""
    samples = np.arange(len(signal))
    return np.column_stack([np.interp(at, samples, each) for each in signal.T])


def _with_positions(signals: TorqueSignals, hypothesis: Hypothesis) -> TorqueSignals:
    """Signals with other positions."""
    zero = np.zeros(signals.q.shape[1])
    still = np.zeros_like(signals.q[:1])
    constant = corrected(hypothesis, still, zero)
    q, qd, qdd = (
        corrected(hypothesis, each, zero)
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


def _with_order(signals: TorqueSignals, hypothesis: Hypothesis) -> TorqueSignals:
    """Signals with the torques in another order."""
    order = list(hypothesis.values)
    return replace(
        signals,
        filtered=signals.filtered[:, order],
        counted=signals.counted[:, order],
    )


def _with_factors(signals: TorqueSignals, hypothesis: Hypothesis) -> TorqueSignals:
    """Signals with torques of other senses or sizes."""
    factors = np.ones(signals.filtered.shape[1])
    factors[list(hypothesis.joints)] = np.divide(1.0, hypothesis.values or -1.0)
    return replace(signals, filtered=signals.filtered * factors)


def _with_delay(signals: TorqueSignals, hypothesis: Hypothesis) -> TorqueSignals:
    """Signals with the torques' delay removed."""
    (delay,) = hypothesis.values
    later = np.arange(len(signals.filtered)) + delay * signals.rate
    return replace(signals, filtered=_interpolated(signals.filtered, later))


def _unchanged(signals: TorqueSignals, _: Hypothesis) -> TorqueSignals:
    """The same signals."""
    return signals


_CORRECTIONS = {
    "torque_order": _with_order,
    "torque_sign": _with_factors,
    "torque_size": _with_factors,
    "delay": _with_delay,
    "gravity": _unchanged,
    "spring": _unchanged,
}
