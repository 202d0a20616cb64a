"""Doubt by counts is what replicas of them do to an estimate by weighted least squares."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.identification.noise.autoregression import Autoregression
from testbed.identification.noise.count_doubt import CountDoubt
from testbed.identification.noise.fits import NoiseFit

CHANNELS, ROWS, COUNT, REPLICAS = 3, 40, 4, 5


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_spread_of_estimates_from_replicas(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(CHANNELS, ROWS, COUNT))
    made = rng.normal(size=(CHANNELS, ROWS, REPLICAS))
    sigma = rng.uniform(0.5, 5.0, CHANNELS)
    weights = np.repeat(1 / sigma, ROWS)[:, None]
    flat, moved = columns.reshape(-1, COUNT) * weights, made.reshape(-1, REPLICAS) * weights
    covariance = np.asarray(np.linalg.inv(flat.T @ flat), dtype=np.float64)
    noise = Autoregression(np.zeros((CHANNELS, 0)), sigma)
    doubt = CountDoubt(NoiseFit(np.zeros(COUNT), covariance, noise, noise, covariance), COUNT)
    for part in (slice(0, 17), slice(17, ROWS)):
        doubt.add(columns[:, part], made[:, part])
    found, share = doubt.found()
    estimates, *_ = np.linalg.lstsq(flat, moved, rcond=None)
    np.testing.assert_allclose(found, estimates @ estimates.T / REPLICAS, rtol=1e-10)
    assert share == pytest.approx(float((moved**2).mean()))


def test_without_counts_there_is_none() -> None:
    noise = Autoregression(np.zeros((1, 0)), np.ones(1))
    doubt = CountDoubt(NoiseFit(np.zeros(2), np.eye(2), noise, noise, np.eye(2)), 2)
    doubt.add(np.ones((1, 9, 2)), np.zeros((1, 9, 0)))
    found, share = doubt.found()
    assert not found.any()
    assert share == 0.0
