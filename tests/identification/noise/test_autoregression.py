"""Noise that is made is found again."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.identification.noise.autoregression import (
    LARGEST_ROOT,
    Autoregression,
    NoiseMaker,
    best_order,
    fit,
)

HIGHEST = 6


def moments(rows: Array) -> Array:
    """Of noise, (C, rows)."""
    shifted = [rows[:, HIGHEST - i : rows.shape[1] - i] for i in range(HIGHEST + 1)]
    return np.asarray(np.einsum("ict,jct->cij", np.array(shifted), np.array(shifted)))


def some_noise(seed: int) -> Autoregression:
    """Two channels, of three roots each, one pair of them complex."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(2):
        slow, pair = rng.uniform(0.5, 0.95), 0.7 * np.exp(1j * rng.uniform(0.5, 2.5))
        found.append(-np.real(np.poly([slow, pair, np.conj(pair)]))[1:])
    return Autoregression(np.array(found), rng.uniform(0.1, 10.0, 2))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_what_is_made_is_found_again(seed: int) -> None:
    noise = some_noise(seed)
    rows = NoiseMaker(noise, 1, np.random.default_rng(seed)).rows(200_000)[..., 0]
    found = moments(rows)
    assert best_order(found, rows.shape[1] - HIGHEST) in (3, 4, 5)
    np.testing.assert_allclose(fit(found, 3), noise.coefficients, atol=0.02)
    left = rows[:, 3:] - sum(
        noise.coefficients[:, i, None] * rows[:, 2 - i : rows.shape[1] - 1 - i] for i in range(3)
    )
    np.testing.assert_allclose(left.std(axis=1), noise.sigma, rtol=0.01)


def test_noise_is_the_same_for_any_cut() -> None:
    noise = some_noise(0)
    whole = NoiseMaker(noise, 3, np.random.default_rng(1)).rows(50)
    maker = NoiseMaker(noise, 3, np.random.default_rng(1))
    np.testing.assert_array_equal(np.concatenate([maker.rows(20), maker.rows(30)], 1), whole)


def test_noise_is_stationary_from_the_first_row() -> None:
    noise = Autoregression(np.array([[0.97]]), np.array([np.sqrt(1 - 0.97**2)]))
    rows = NoiseMaker(noise, 4000, np.random.default_rng(0)).rows(60)[0]
    np.testing.assert_allclose(rows.std(axis=1), 1.0, atol=0.06)


def test_growing_noise_is_held_to_one_that_forgets() -> None:
    rows = 1.05 ** np.arange(200)[None] + 1e-3 * np.random.default_rng(0).normal(size=(1, 200))
    found = Autoregression(fit(moments(rows), 2), np.ones(1))
    assert found.memory[0] <= -1 / np.log(LARGEST_ROOT) * (1 + 1e-9)


def test_memory_is_that_of_the_slowest_part() -> None:
    noise = Autoregression(np.array([[1.4, -0.45]]), np.ones(1))  # roots .9 and .5
    assert noise.memory[0] == pytest.approx(-1 / np.log(0.9))
    assert Autoregression(np.zeros((2, 0)), np.ones(2)).memory.tolist() == [0.0, 0.0]


def test_no_noise_is_no_error() -> None:
    assert not fit(np.zeros((2, HIGHEST + 1, HIGHEST + 1)), 3).any()
    assert best_order(np.zeros((2, HIGHEST + 1, HIGHEST + 1)), 100) == 1
