"""What repeats with the motion, or comes late, is told from noise; chance is not taken for it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from testbed.arrays import Array
from testbed.identification.diagnosis import UNLIKELY
from testbed.identification.noise.autoregression import Autoregression, NoiseMaker
from testbed.identification.noise.fits import weighted_fit
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums
from testbed.identification.noise.late import Lateness, lateness
from testbed.identification.noise.repetition import Repetition, RepetitionSums
from testbed.identification.period import period_of
from tests.helpers.strategies import rngs

WHITE = Autoregression(np.zeros((6, 0)), np.arange(1.0, 7.0))
COLOURED = Autoregression(np.tile([0.6, 0.2], (6, 1)), np.ones(6))


def made(noise: Autoregression, rows: int, seed: int) -> Array:
    """Noise, (C, rows)."""
    return NoiseMaker(noise, 1, np.random.default_rng(seed)).rows(rows)[..., 0]


def repetition(noise: Autoregression, left: Array, cut: int = 10**9) -> Repetition | None:
    """What is found in residuals of a motion with a period of 100 rows, 10 s."""
    sums = RepetitionSums(noise, 100, 10.0)
    for first in range(0, left.shape[1], cut):
        sums.add(left[:, first : first + cut])
    return sums.found()


def test_chances_of_repetition_are_no_smaller_than_they_say() -> None:
    """Else every fourth good recording is called wrong; nor are they useless."""
    for noise in (WHITE, COLOURED):
        found = [repetition(noise, made(noise, 200, seed)) for seed in range(150)]
        chances = np.array([each.chance for each in found if each is not None])
        for level in (0.05, 0.5, 0.95):
            share = np.mean(chances < level)
            assert share < level + 4 * np.sqrt(level * (1 - level) / len(chances))
        assert np.mean(chances < 0.5) > 0.2
        assert repetition(noise, made(noise, 104, 1)) is None  # too few rows
    alone = Autoregression(np.zeros((1, 0)), np.ones(1))
    for seed in range(9):  # of one channel: by the normal law, for two looks
        one = repetition(alone, made(alone, 200, seed))
        assert one is not None
        assert one.chance == pytest.approx(min(1.0, 2 * stats.norm.sf(10 * one.share[0])))


@pytest.mark.parametrize(("noise", "periods"), [(WHITE, 2), (COLOURED, 5)])
def test_what_repeats_is_found_with_its_share(noise: Autoregression, periods: int) -> None:
    """In one channel twice as large as its noise, four fifths repeat; however rows are cut."""
    alone = Autoregression(noise.coefficients, np.where(np.arange(6) == 2, noise.sigma, 0.0))
    left = made(noise, 100 * periods, 3) + 2 * np.tile(made(alone, 100, 5), periods)
    whole = repetition(noise, left)
    assert whole is not None
    assert (whole.period, whole.chance < 1e-4) == (10.0, True)
    shares = np.array(whole.share)
    assert abs(shares[2] - 0.8) < 0.1
    assert (np.abs(np.delete(shares, 2)) < 0.4).all()
    for cut in (1, 7, 150):
        again = repetition(noise, left, cut)
        assert again is not None
        np.testing.assert_allclose(again.share, shares, rtol=1e-11)


@given(rngs, st.integers(200, 2000), st.integers(1, 8))
def test_the_period_of_a_motion_is_found(
    rng: np.random.Generator, period: int, joints: int
) -> None:
    """Of a Fourier series seen by encoders, beside joints that stand still; where it is over."""
    phase = 2 * np.pi * np.arange(2 * period + 7)[:, None, None] / period * np.arange(1, 6)
    size = rng.normal(size=(2, joints, 5))
    wave = (size[0] * np.sin(phase) + size[1] * np.cos(phase)).sum(axis=2)
    still = np.zeros((len(wave), 1))
    seen = np.hstack([wave, still, still]) + 1e-3 * rng.normal(size=(len(wave), joints + 2))
    seen[:, -1] = 0.0
    assert period_of(seen) == pytest.approx(period, abs=2)
    assert period_of(seen[: int(1.4 * period)]) is None
    assert period_of(np.cumsum(rng.normal(size=(3000, 2)), axis=0)) is None
    turning = np.array([[1.0], [-1.0]] * 10)
    assert period_of(turning) == 2
    for odd in (turning[:3], np.ones((20, 2))):  # too few samples to repeat, and rest
        assert period_of(odd) is None


TRUE = np.array([3.0, -2.0, 0.5])


def late_by(delay: float, seed: int, gaps: float = 0.0, slow: float = 0.0) -> LaggedProducts:
    """Two channels of slow columns at 10 Hz, measured late; noise that goes on to next rows."""
    rng, time = np.random.default_rng(seed), np.arange(600) / 10
    waves, phases = rng.uniform(0.1, 0.8, (2, 1, 3)), rng.uniform(0, 6, (2, 1, 3))
    columns, moved = (
        np.sin(2 * np.pi * waves * at[:, None] + phases) for at in (time, time - delay)
    )
    noise = Autoregression(np.full((2, 1), slow), np.full(2, 0.05 * np.sqrt(1 - slow**2)))
    measured = (moved @ TRUE)[..., None] + NoiseMaker(noise, 1, rng).rows(600)
    kept = rng.random((2, 600, 1)) >= gaps
    sums = LaggedSums(6)
    sums.add(np.concatenate([columns, measured, np.ones_like(measured)], axis=2) * kept)
    return sums.finish()


def delay_in(given: LaggedProducts, start: Array) -> Lateness:
    """As an estimate goes about it: residuals are those of a first solution."""
    moved = np.eye(5)
    moved[:3, 3] = -start
    left = given.combined(moved)
    late = lateness(left, weighted_fit(left), start, 1.0, 10.0)
    assert late is not None
    return late


def test_a_delay_is_found_from_anywhere() -> None:
    """Differences over two rows are a little less than slopes: it seems a little more."""
    for delay in (0.02, -0.02, 0.005):
        for start in (np.zeros(3), TRUE):
            late = delay_in(late_by(delay, 1), start)
            assert late.delay == pytest.approx(delay, rel=0.15, abs=3 * late.sigma)
            assert abs(late.z) > UNLIKELY
    beside_gaps = delay_in(late_by(0.02, 2, gaps=0.1), np.zeros(3))
    assert beside_gaps.z > UNLIKELY
    assert 0 < beside_gaps.delay < 0.025


def test_chance_makes_no_delays() -> None:
    """Nor do rows that were dropped, or noise that goes on: a good recording would be shifted."""
    for gaps, slow in ((0.1, 0.0), (0.0, 0.6)):
        z = [delay_in(late_by(0.0, seed, gaps, slow), TRUE).z for seed in range(30)]
        assert 0.6 < np.std(z) < 1.3
        assert np.max(np.abs(z)) < UNLIKELY
