"""Noise in the columns draws least squares to zero; taken back, it does not, and sigma holds."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.identification.noise.autoregression import Autoregression, NoiseMaker
from testbed.identification.noise.dilution import undiluted
from testbed.identification.noise.fits import Fit, NoiseFit, weighted_fit, whitened_fit
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums

TRUTH = np.array([1.0, -2.0, 0.5])
START = np.array([0.7, -1.0, 0.0])
"""Residuals are what these leave, as in an estimate."""

SLOW = Autoregression(np.full((4, 1), 0.9), np.array([0.1, 0.4, 0.3, 0.2]))


SIZE: dict[Fit, Array] = {
    whitened_fit: np.array([0.015, 0.015, 0.02]),
    weighted_fit: np.array([0.15, 0.15, 0.2]),
}
"""Of noise in the columns that leads least squares astray: whitening leaves more of it."""


def problem(seed: int, size: Array, rows: int = 600) -> tuple[LaggedProducts, LaggedProducts]:
    """Slow columns seen with noise, (3,), and products of other noise of the same size."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) / 10
    waves = rng.uniform(0.1, 1.0, (4, 3))
    columns = np.sin(waves[:, None] * t[:, None] + rng.uniform(0, 6, (4, 1, 3)))
    measured = columns @ TRUTH[:, None] + NoiseMaker(SLOW, 1, rng).rows(rows)
    seen, made = (
        base + size * rng.normal(size=columns.shape) for base in (columns, np.zeros_like(columns))
    )
    ones = np.ones_like(measured)
    left, foretold = measured - seen @ START[:, None], made @ START[:, None]
    return (
        products(np.concatenate([seen, left, ones], axis=2)),
        products(np.concatenate([made, -foretold, 0 * ones], axis=2)),
    )


def products(block: Array) -> LaggedProducts:
    sums = LaggedSums(6)
    sums.add(block)
    return sums.finish()


def scores(found: NoiseFit) -> Array:
    return np.asarray(
        (START + found.values - TRUTH) / np.sqrt(np.maximum(found.covariance.diagonal(), 0.0))
    )


@pytest.mark.slow
@pytest.mark.parametrize("fit", [whitened_fit, weighted_fit])
def test_the_unknowns_are_right_on_average_and_sigma_is_their_spread(fit: Fit) -> None:
    """Without taking noise back, their mean is off by several sigma."""
    before, after = [], []
    for seed in range(60):
        given, made = problem(seed, SIZE[fit], rows=4000)
        plain = fit(given, None)
        better = undiluted(plain, made)
        assert not better.drowned(np.eye(3)).any()
        before.append(scores(plain))
        after.append(scores(better.found))
    assert np.abs(np.mean(before, axis=0)).max() > 2.0
    assert np.abs(np.mean(after, axis=0)).max() < 0.5
    assert 0.8 < np.sqrt(np.mean(np.square(after))) < 1.3


def test_nothing_is_taken_back_where_there_is_no_noise() -> None:
    given, made = problem(0, np.zeros(3))
    plain = whitened_fit(given)
    better = undiluted(plain, made)
    found = better.found
    np.testing.assert_allclose(found.values, plain.values, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, plain.covariance, rtol=1e-9)
    assert not better.drowned(np.eye(3)).any()


@pytest.mark.parametrize("drowning", range(3))
def test_an_unknown_that_is_drowned_is_named(drowning: int) -> None:
    """Its column is noise for the most part: no estimate runs away, no sigma shrinks."""
    size = np.full(3, 1e-3)
    size[drowning] = 30.0
    given, made = problem(1, size)
    plain = whitened_fit(given)
    better = undiluted(plain, made)
    found = better.found
    np.testing.assert_array_equal(better.drowned(np.eye(3)), np.arange(3) == drowning)
    assert np.isfinite(found.values).all()
    assert np.linalg.eigvalsh(found.covariance - plain.covariance).min() > -1e-12
    sure = np.arange(3) != drowning
    assert np.abs(scores(found)[sure]).max() < 5
