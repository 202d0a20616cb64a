"""Periodic motion of joints: a truncated Fourier series per joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.summary_table import Value
from testbed.core.dynamics.newton_euler import Motion


@dataclass(frozen=True, eq=False, repr=False)
class Fourier(Value):
    """Fourier series q_j(t) = offset_j + sum over k of sine_jk sin(k w t) + cosine_jk cos(k w t).

    Attributes:
        fundamental: Fundamental frequency w / (2 pi) [Hz].
        offset: Mean positions, (n,) [rad or m].
        sine: Sine coefficients, (n, harmonics) [rad or m].
        cosine: Cosine coefficients, (n, harmonics) [rad or m].
    """

    fundamental: float
    offset: Array
    sine: Array
    cosine: Array

    def __post_init__(self) -> None:
        n = len(self.offset)
        freeze_arrays(
            self, offset=(n,), sine=(n, None), cosine=(n, np.shape(self.sine)[-1])
        )

    def __repr__(self) -> str:
        n = len(self.offset)
        return f"<Fourier of {n} joints, {self.harmonics} harmonics of {self.fundamental:g} Hz>"

    @property
    def period(self) -> float:
        """Period of the motion [s]."""
        return 1.0 / self.fundamental

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return int(self.sine.shape[1])

    @property
    def coefficients(self) -> Array:
        """Offset, sine and cosine coefficients of each joint, (n, 2 harmonics + 1) [rad or m]."""
        return np.hstack([self.offset[:, None], self.sine, self.cosine])

    @staticmethod
    def from_coefficients(fundamental: float, coefficients: Array) -> Fourier:
        """Build the motion from an array of coefficients.

        Args:
            fundamental: Fundamental frequency [Hz].
            coefficients: Offset, sine and cosine coefficients of each joint, (n, 2 harmonics + 1)
                [rad or m].
        """
        last = 1 + coefficients.shape[1] // 2
        parts = coefficients[:, 0], coefficients[:, 1:last], coefficients[:, last:]
        return Fourier(fundamental, *parts)

    @property
    def duration(self) -> float:
        """Duration of one period [s]."""
        return self.period

    @property
    def fifth_derivative(self) -> Array:
        """Upper bounds of the absolute fifth time derivatives, (n,) [rad/s^5 or m/s^5]."""
        return self.bound(5)

    def bound(self, order: int) -> Array:
        """Upper bounds of absolute derivatives of given order, (n,) [rad/s^order or m/s^order].

        The bound is the sum of the amplitudes of the derivative's harmonics; for order 0, the
        absolute offset is added.
        """
        frequencies = 2 * np.pi * self.fundamental * np.arange(1, self.harmonics + 1)
        constant = 0.0 if order else np.abs(self.offset)
        return np.asarray(
            constant + np.hypot(self.sine, self.cosine) @ frequencies**order
        )

    def derivative(self, t: Array, order: int) -> Array:
        """Time derivative of the positions at times t, (M, n) [rad/s^order or m/s^order].

        Order 0 gives the positions.
        """
        return (
            fourier_basis(self.fundamental, self.harmonics, t, order)
            @ self.coefficients.T
        )

    def at(self, t: Array) -> Motion:
        """Exact positions, velocities and accelerations at times t, (M,) [s]."""
        return Motion(t, *(self.derivative(t, order) for order in range(3)))

    def path_time(self, t: Array) -> Array:
        """Path parameter at times t, (M,) [s]: the time itself."""
        return t

    def instants(self, count: int) -> Array:
        """Evenly spaced times of one period from 0, (count,) [s]."""
        return np.arange(count) * self.period / count

    def scaled(self, share: float, rest: Array) -> Fourier:
        """Motion with amplitudes scaled about a posture.

        Args:
            share: Scale factor; 0 gives a constant posture.
            rest: Centre of the scaling, (n,) [rad or m].
        """
        offset = rest + share * (self.offset - rest)
        return Fourier(self.fundamental, offset, share * self.sine, share * self.cosine)

    def rephased(self, rng: np.random.Generator) -> Fourier:
        """Motion with the same amplitudes and random phases, hence equal rms over a period.

        Args:
            rng: Random generator of the phases.
        """
        phase_shift = rng.uniform(0, 2 * np.pi, self.sine.shape)
        sine = self.sine * np.cos(phase_shift) - self.cosine * np.sin(phase_shift)
        cosine = self.sine * np.sin(phase_shift) + self.cosine * np.cos(phase_shift)
        return Fourier(self.fundamental, self.offset, sine, cosine)


def fourier_basis(
    fundamental: float, harmonics: int, t: Array, order: int = 0
) -> Array:
    """Derivatives of the Fourier basis functions at times t, (M, 2 harmonics + 1).

    The columns belong to the constant, the sines and the cosines, in this order.

    Args:
        fundamental: Fundamental frequency [Hz].
        harmonics: Number of harmonics.
        t: Times, (M,) [s].
        order: Order of the derivative; 0 for positions.
    """
    frequencies = 2 * np.pi * fundamental * np.arange(1, harmonics + 1)  # (K,)
    phase = np.multiply.outer(t, frequencies)  # (M, K)
    sine, cosine = np.sin(phase), np.cos(phase)
    derivatives = [(sine, cosine), (cosine, -sine), (-sine, -cosine), (-cosine, sine)]
    first, second = (frequencies**order * part for part in derivatives[order % 4])
    constant = np.full((len(t), 1), 0.0 if order else 1.0)
    return np.hstack([constant, first, second])
