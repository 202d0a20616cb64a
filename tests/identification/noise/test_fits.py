"""Fits from products are the fits of the rows themselves, and their sigmas hold."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.identification.noise.autoregression import Autoregression, NoiseMaker
from testbed.identification.noise.biases import carrying_constants, constants, square_of_last
from testbed.identification.noise.fits import Fit, weighted_fit, whitened_fit
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums

TRUTH = np.array([1.0, -2.0, 0.5])


def problem(seed: int, noise: Autoregression, rows: int = 400, drop: float = 0.0) -> Array:
    """Slow columns, and what they and noise make of TRUTH: (C, rows, 5) with ones."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) / 10
    channels = len(noise.sigma)
    waves = rng.uniform(0.1, 2.0, (channels, len(TRUTH)))
    columns = np.sin(waves[:, None] * t[:, None] + rng.uniform(0, 6, (channels, 1, len(TRUTH))))
    made = NoiseMaker(noise, 1, rng).rows(rows)
    kept = rng.random((channels, rows, 1)) >= drop
    return np.concatenate([columns, columns @ TRUTH[:, None] + made, np.ones_like(made)], 2) * kept


def products(block: Array, lags: int = 6) -> LaggedProducts:
    sums = LaggedSums(lags)
    sums.add(block)
    return sums.finish()


WHITE = Autoregression(np.zeros((4, 0)), np.array([0.1, 1.0, 0.3, 2.0]))
SLOW = Autoregression(np.full((4, 1), 0.9), np.array([0.1, 1.0, 0.3, 2.0]))


@pytest.mark.parametrize("seed", range(3))
def test_the_whitened_fit_is_least_squares_of_whitened_rows(seed: int) -> None:
    block = problem(seed, SLOW)
    found = whitened_fit(products(block))
    a, p = found.noise.coefficients, found.noise.order
    white = block[:, p:] - sum(a[:, i, None, None] * block[:, p - 1 - i : -1 - i] for i in range(p))
    rows = (white / found.noise.sigma[:, None, None]).reshape(-1, 5)
    expected, *_ = np.linalg.lstsq(rows[:, :3], rows[:, 3], rcond=None)
    # the weights of the last round but one made the values
    np.testing.assert_allclose(found.values, expected, rtol=1e-3)
    np.testing.assert_allclose(
        found.covariance, np.linalg.inv(rows[:, :3].T @ rows[:, :3]), rtol=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize("noise", [WHITE, SLOW], ids=["white", "slow"])
def test_sigma_is_the_spread(noise: Autoregression) -> None:
    """Over 300 repetitions; rows that are missing only make it larger."""
    for fit, drop in ((whitened_fit, 0.0), (weighted_fit, 0.0), (weighted_fit, 0.3)):
        scores = []
        for seed in range(300):
            found = fit(products(problem(seed, noise, drop=drop), 20 if drop else 6), None)
            scores.append((found.values - TRUTH) / np.sqrt(np.diagonal(found.covariance)))
        spread = np.sqrt(np.mean(np.square(scores)))
        assert spread < (1.15 if fit is whitened_fit or noise is WHITE else 1.4)
        assert spread > 0.9


@pytest.mark.slow
def test_whitening_makes_better_estimates_under_slow_noise() -> None:
    """Columns of many frequencies, some of which the noise has little of."""

    def some(seed: int) -> LaggedProducts:
        block, rng = problem(seed, SLOW), np.random.default_rng([seed, 1])
        columns = block[..., :3] + rng.normal(size=(4, 400, 3))
        block[..., 3] += (columns - block[..., :3]) @ TRUTH
        return products(np.concatenate([columns, block[..., 3:]], axis=2))

    def error(fit: Fit) -> float:
        found = [fit(some(seed), None).values for seed in range(60)]
        return float(np.sqrt(np.mean(np.square(np.array(found) - TRUTH))))

    assert error(whitened_fit) < 0.7 * error(weighted_fit)


def test_the_order_is_small_for_white_noise_and_not_for_coloured() -> None:
    orders = [whitened_fit(products(problem(seed, WHITE))).noise.order for seed in range(20)]
    assert np.median(orders) == 1
    pair = np.real(np.poly(0.9 * np.exp([0.5j, -0.5j])))
    waves = Autoregression(np.tile(-pair[1:], (4, 1)), np.ones(4))
    assert min(whitened_fit(products(problem(s, waves))).noise.order for s in range(20)) >= 2


def test_constants_are_found_apart_from_the_parameters() -> None:
    """Those that a parameter imitates are not told; the others are, to their sigmas."""
    block = problem(0, WHITE, rows=2000)
    block[2, :, 0] = 1.0  # the first parameter is a constant in channel 2
    block[:, :, 0] *= np.array([0.0, 0.0, 1.0, 0.0])[:, None]
    bias = np.array([0.3, -1.0, 0.2, 3.0])
    block[..., 3] = block[..., :3] @ TRUTH + bias[:, None]
    block[..., 3] += NoiseMaker(WHITE, 1, np.random.default_rng(5)).rows(2000)[..., 0]
    given = products(block)
    there = constants(given)
    assert there.directions.shape == (4, 3)
    assert np.abs(there.directions[2]).max() < 1e-6
    part = np.abs(there.hidden[0])
    assert part.argmax() == 0
    assert part[1:].max() < 1e-6 * part[0]
    found = whitened_fit(carrying_constants(given, there.directions))
    told = there.directions @ found.values[3:]
    np.testing.assert_allclose(told[[0, 1, 3]], bias[[0, 1, 3]], atol=0.2)
    assert square_of_last(found, 3) > 1000
    assert square_of_last(found, 0) == 0.0


@pytest.mark.slow
def test_no_constants_are_significant_where_there_are_none() -> None:
    squares = []
    for seed in range(100):
        given = products(problem(seed, WHITE))
        directions = constants(given).directions
        found = whitened_fit(carrying_constants(given, directions))
        squares.append(square_of_last(found, directions.shape[1]))
    assert np.mean(squares) == pytest.approx(4.0, abs=1.0)  # chi-square of four


def test_perfect_rows_give_the_truth() -> None:
    silent = Autoregression(np.zeros((4, 0)), np.zeros(4))
    for fit in (whitened_fit, weighted_fit):
        found = fit(products(problem(1, silent)), None)
        np.testing.assert_allclose(found.values, TRUTH, rtol=1e-12)
        assert np.isfinite(found.covariance).all()
