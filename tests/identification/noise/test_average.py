"""Two models' answers together: between them, and no surer than either and their difference."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.identification.noise.autoregression import Autoregression, NoiseMaker
from testbed.identification.noise.average import averaged, averaged_fit
from testbed.identification.noise.fits import NoiseFit, whitened_fit
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums

NOISE = Autoregression(np.full((2, 1), 0.5), np.ones(2))
TRUTH = np.array([1.0, -2.0])


def one(values: Array, spread: float) -> NoiseFit:
    covariance = spread * np.eye(len(values))
    return NoiseFit(values, covariance, NOISE, NOISE, covariance)


def recorded(seed: int, noise: Autoregression, bias: float, rows: int = 300) -> LaggedProducts:
    rng = np.random.default_rng(seed)
    t = np.arange(rows)[:, None] / 10
    columns = 1.0 + np.sin(rng.uniform(0.2, 2.0, (2, 1, 2)) * t + rng.uniform(0, 6, (2, 1, 2)))
    measured = columns @ TRUTH[:, None] + NoiseMaker(noise, 1, rng).rows(rows) + bias
    sums = LaggedSums(6)
    sums.add(np.concatenate([columns, measured, np.ones_like(measured)], axis=2))
    return sums.finish()


def test_the_average_is_that_of_a_mixture() -> None:
    """Moments of draws, first which model and then from its distribution."""
    alone, beside = one(np.array([1.0, 2.0]), 0.5), one(np.array([2.0, 1.5, -1.0]), 2.0)
    rng, weight = np.random.default_rng(0), 0.3
    draws = np.zeros((400_000, 3))
    second = rng.random(len(draws)) < weight
    draws[:, :2] = alone.values + np.sqrt(0.5) * rng.normal(size=(len(draws), 2))
    draws[second] = beside.values + np.sqrt(2.0) * rng.normal(size=(second.sum(), 3))
    found = averaged(alone, beside, weight)
    np.testing.assert_allclose(found.values, draws.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(found.covariance, np.cov(draws.T), atol=0.02)


def test_a_clear_constant_is_taken_and_an_absent_one_hardly() -> None:
    clear = averaged_fit(recorded(0, NOISE, 5.0), None, whole=True)
    assert clear.weight > 0.99
    np.testing.assert_allclose(clear.directions @ clear.found.values[2:], 5.0, atol=1.0)
    weights = [averaged_fit(recorded(s, NOISE, 0.0), None, whole=True).weight for s in range(30)]
    assert np.median(weights) < 0.5


@pytest.mark.slow
def test_sigma_holds_where_a_choice_would_not() -> None:
    """Slow noise looks like a constant now and then, and a test takes it for one."""
    slow = Autoregression(np.full((2, 1), 0.97), np.ones(2))
    scores, chosen = [], []
    for seed in range(150):
        given = recorded(seed, slow, 0.0)
        answer = averaged_fit(given, None, whole=True)
        spread = np.sqrt(answer.found.covariance.diagonal()[:2])
        scores.append((answer.found.values[:2] - TRUTH) / spread)
        picked = whitened_fit(given) if answer.weight < 0.5 else None
        if picked is not None:
            chosen.append((picked.values[:2] - TRUTH) / np.sqrt(picked.covariance.diagonal()))
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.25
    assert (np.abs(scores) < 1.96).mean() > 0.9
    assert len(chosen) > 50


def test_few_rows_are_fitted_without_constants() -> None:
    answer = averaged_fit(recorded(0, NOISE, 5.0, rows=40), None, whole=True)
    assert answer.directions.shape == (2, 0)
    assert answer.weight == 0.0
    assert answer.found.values.shape == (2,)
