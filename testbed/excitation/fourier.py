"""Periodic motion: a truncated Fourier series for every joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array, readonly
from testbed.dynamics.motion import Motion


@dataclass(frozen=True, eq=False)
class Fourier:
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
        object.__setattr__(self, "offset", readonly(self.offset, (n,), "offset"))
        object.__setattr__(self, "sine", readonly(self.sine, (n, None), "sine"))
        object.__setattr__(self, "cosine", readonly(self.cosine, self.sine.shape, "cosine"))

    @property
    def period(self) -> float:
        """Time after which the motion repeats [s]."""
        return 1.0 / self.fundamental

    def at(self, t: Array) -> Motion:
        """The motion at times t, (M,) [s]; derivatives are exact."""
        pulses = 2 * np.pi * self.fundamental * np.arange(1, self.sine.shape[1] + 1)  # (K,)
        phase = np.multiply.outer(t, pulses)  # (M, K)
        s, c = np.sin(phase), np.cos(phase)
        q = self.offset + s @ self.sine.T + c @ self.cosine.T
        qd = (c * pulses) @ self.sine.T - (s * pulses) @ self.cosine.T
        qdd = -(s * pulses**2) @ self.sine.T - (c * pulses**2) @ self.cosine.T
        return Motion(t, q, qd, qdd)
