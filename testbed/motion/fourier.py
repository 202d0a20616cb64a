"""Periodic motion: a truncated Fourier series for every joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.summary_table import Value
from testbed.core.dynamics.newton_euler import Motion


@dataclass(frozen=True, eq=False, repr=False)
class Fourier(Value):
    """q_j(t) = offset_j + sum over k of sine_jk sin(k w t) + cosine_jk cos(k w t).

    Attributes:
        fundamental: w / (2 pi) [Hz].
        offset: (n,) [rad or m].
        sine: (n, harmonics) [rad or m].
        cosine: (n, harmonics) [rad or m].
    """

    fundamental: float
    offset: Array
    sine: Array
    cosine: Array

    def __post_init__(self) -> None:
        n = len(self.offset)
        freeze(self, offset=(n,), sine=(n, None), cosine=(n, np.shape(self.sine)[-1]))

    def __repr__(self) -> str:
        n = len(self.offset)
        return f"<Fourier of {n} joints, {self.harmonics} harmonics of {self.fundamental:g} Hz>"

    @property
    def period(self) -> float:
        """Time after which the motion repeats [s]."""
        return 1.0 / self.fundamental

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return int(self.sine.shape[1])

    @property
    def coefficients(self) -> Array:
        """Offset, sines and cosines joint by joint, (n, 2 harmonics + 1) [rad or m]."""
        return np.hstack([self.offset[:, None], self.sine, self.cosine])

    @staticmethod
    def of(fundamental: float, coefficients: Array) -> Fourier:
        """The motion of `coefficients`, (n, 2 harmonics + 1)."""
        last = 1 + coefficients.shape[1] // 2
        parts = coefficients[:, 0], coefficients[:, 1:last], coefficients[:, last:]
        return Fourier(fundamental, *parts)

    @property
    def duration(self) -> float:
        """Of one period [s]."""
        return self.period

    @property
    def fifth_derivative(self) -> Array:
        """A bound of the magnitude of the fifth derivative, (n,) [rad/s^5 or m/s^5]."""
        return self.bound(5)

    def bound(self, order: int) -> Array:
        """A bound of the magnitude of a derivative, (n,) [rad/s^order or m/s^order]."""
        pulses = 2 * np.pi * self.fundamental * np.arange(1, self.harmonics + 1)
        still = 0.0 if order else np.abs(self.offset)
        return np.asarray(still + np.hypot(self.sine, self.cosine) @ pulses**order)

    def derivative(self, t: Array, order: int) -> Array:
        """A derivative of the positions at times t, (M, n) [rad/s^order or m/s^order]."""
        return terms(self.fundamental, self.harmonics, t, order) @ self.coefficients.T

    def at(self, t: Array) -> Motion:
        """The motion at times t, (M,) [s]; derivatives are exact."""
        return Motion(t, *(self.derivative(t, order) for order in range(3)))

    def place(self, t: Array) -> Array:
        """Where on its path at times t, (M,), as a time [s]: it runs through it as it is."""
        return t

    def instants(self, count: int) -> Array:
        """Instants of a period, evenly spaced from 0, (count,) [s]."""
        return np.arange(count) * self.period / count

    def scaled(self, share: float, rest: Array) -> Fourier:
        """The same motion, smaller, about a posture, (n,): share 0 stays there."""
        offset = rest + share * (self.offset - rest)
        return Fourier(self.fundamental, offset, share * self.sine, share * self.cosine)

    def rephased(self, rng: np.random.Generator) -> Fourier:
        """Another motion with the same amplitudes: over a period every rms is the same."""
        turn = rng.uniform(0, 2 * np.pi, self.sine.shape)
        sine = self.sine * np.cos(turn) - self.cosine * np.sin(turn)
        cosine = self.sine * np.sin(turn) + self.cosine * np.cos(turn)
        return Fourier(self.fundamental, self.offset, sine, cosine)


def terms(fundamental: float, harmonics: int, t: Array, order: int = 0) -> Array:
    """What a derivative has of each coefficient at times t, (M, 2 harmonics + 1).

    Args:
        fundamental: Frequency at which the motion repeats [Hz].
        harmonics: Number of harmonics.
        t: (M,) [s].
        order: Of the derivative; 0 for positions.
    """
    pulses = 2 * np.pi * fundamental * np.arange(1, harmonics + 1)  # (K,)
    phase = np.multiply.outer(t, pulses)  # (M, K)
    sine, cosine = np.sin(phase), np.cos(phase)
    turns = [(sine, cosine), (cosine, -sine), (-sine, -cosine), (-cosine, sine)]
    first, second = (pulses**order * part for part in turns[order % 4])
    constant = np.full((len(t), 1), 0.0 if order else 1.0)
    return np.hstack([constant, first, second])
