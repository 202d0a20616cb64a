"""Spectra: power is neither lost nor found."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.reporting.spectrum import SEGMENT, rms_within, spectrum


@pytest.mark.parametrize("rate", [50.0, 1000.0])
@pytest.mark.parametrize("samples", [300, SEGMENT, 40 * SEGMENT])
def test_parseval(rate: float, samples: int) -> None:
    """The power over all frequencies is the variance."""
    noise = 3.0 * np.random.default_rng(1).normal(size=samples)
    frequency, density = spectrum(noise, rate)
    total = rms_within(frequency, density, 0.0, np.inf)
    assert total == pytest.approx(noise.std(), rel=0.15 if samples == 300 else 0.03)
    low, high = (rms_within(frequency, density, *band) for band in ((0, 7.0), (7.0, np.inf)))
    assert np.hypot(low, high) == pytest.approx(total, rel=1e-12)


def test_white_noise_is_flat_and_its_density_is_known() -> None:
    rate, sigma = 1000.0, 2.0
    _, density = spectrum(sigma * np.random.default_rng(2).normal(size=200 * SEGMENT), rate)
    inner = density[5:-5]
    np.testing.assert_allclose(inner, sigma * np.sqrt(2 / rate), rtol=0.35)
    assert np.sqrt(np.mean(inner**2)) == pytest.approx(sigma * np.sqrt(2 / rate), rel=0.01)


def test_a_tone_stands_at_its_frequency_with_its_power() -> None:
    rate, tone = 500.0, 31.0
    time = np.arange(20 * SEGMENT) / rate
    frequency, density = spectrum(5.0 + 4.0 * np.sin(2 * np.pi * tone * time), rate)
    assert frequency[density.argmax()] == pytest.approx(tone, abs=rate / SEGMENT)
    assert rms_within(frequency, density, tone - 2, tone + 2) == pytest.approx(
        4 / np.sqrt(2), rel=0.01
    )
    assert rms_within(frequency, density, 0, tone - 2) < 0.01  # the mean counts nowhere


def test_very_short_signals_have_a_spectrum() -> None:
    frequency, density = spectrum(np.array([1.0, -1.0, 1.0]), 10.0)
    assert len(frequency) == len(density) == 1
    assert rms_within(frequency, density, 0.0, np.inf) == 0.0
