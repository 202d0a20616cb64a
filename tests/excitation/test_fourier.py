"""A motion is what its series says, and its derivatives are exact."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.excitation.fourier import Fourier


def series(rng: np.random.Generator, n: int = 3) -> Fourier:
    return Fourier(0.2, rng.normal(size=n), *rng.normal(size=(2, n, 4)))


@pytest.mark.parametrize("seed", range(5))
def test_velocity_and_acceleration_are_derivatives(seed: int) -> None:
    motion, h = series(np.random.default_rng(seed)), 1e-4
    t = np.linspace(0, 5, 40)
    before, now, after = (motion.at(t + step) for step in (-h, 0, h))
    np.testing.assert_allclose((after.q - before.q) / (2 * h), now.qd, atol=1e-4)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * h), now.qdd, atol=1e-3)


def test_a_motion_repeats_after_its_period() -> None:
    motion = series(np.random.default_rng(0))
    assert motion.period == 5.0
    t = np.linspace(0, 5, 20)
    np.testing.assert_allclose(motion.at(t).q, motion.at(t + motion.period).q, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_spectrum_of_one_period_shows_the_coefficients(seed: int) -> None:
    """Offset, cosines and sines are the real, real and negative imaginary parts of the FFT."""
    motion = series(np.random.default_rng(seed))
    samples = 64
    times = np.arange(samples) / samples * motion.period
    lines = np.fft.rfft(motion.at(times).q, axis=0) / samples
    np.testing.assert_allclose(lines[0].real, motion.offset, atol=1e-12)
    np.testing.assert_allclose(2 * lines[1:5].real.T, motion.cosine, atol=1e-12)
    np.testing.assert_allclose(-2 * lines[1:5].imag.T, motion.sine, atol=1e-12)
    np.testing.assert_allclose(lines[5:], 0, atol=1e-12)


def test_times_stay_with_their_samples() -> None:
    t = np.array([3.0, 1.0, 2.0])
    motion = series(np.random.default_rng(0)).at(t)
    np.testing.assert_array_equal(motion.t, t)
    assert motion.q.shape == motion.qd.shape == motion.qdd.shape == (3, 3)
