"""Noise is found as it was made; fits by products are fits of the rows, and say what they know."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.arrays import Array
from testbed.identification.noise.autoregression import (
    LARGEST_ROOT,
    Autoregression,
    NoiseMaker,
    best_order,
    fit,
)
from testbed.identification.noise.average import averaged, averaged_fit
from testbed.identification.noise.biases import carrying_constants, constants, square_of_last
from testbed.identification.noise.dilution import undiluted
from testbed.identification.noise.fits import Fit, NoiseFit, weighted_fit, whitened_fit
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums
from tests.helpers.strategies import rngs

LAGS = 6
TRUTH = np.array([1.0, -2.0, 0.5])
SIGMA = np.array([0.1, 1.0, 0.3, 2.0])
WHITE = Autoregression(np.zeros((4, 0)), SIGMA)
SLOW = Autoregression(np.full((4, 1), 0.9), SIGMA)


def products(*sequences: Array, cut: int = 10**9) -> LaggedProducts:
    """Of rows, (C, M, p) each, that were not recorded in one."""
    sums = LaggedSums(LAGS)
    for rows in sequences:
        sums.pause()
        for first in range(0, rows.shape[1], cut):
            sums.add(rows[:, first : first + cut])
    return sums.finish()


def problem(seed: int, noise: Autoregression, rows: int = 400) -> Array:
    """Slow columns, and what they and noise make of TRUTH: (C, rows, 5) with ones."""
    rng, t = np.random.default_rng(seed), np.arange(rows) / 10
    waves, phases = rng.uniform(0.1, 2.0, (4, 3)), rng.uniform(0, 6, (4, 1, 3))
    columns = np.sin(waves[:, None] * t[:, None] + phases)
    made = NoiseMaker(noise, 1, rng).rows(rows)
    return np.concatenate([columns, columns @ TRUTH[:, None] + made, np.ones_like(made)], axis=2)


def whitened(rows: Array, a: Array) -> Array:
    """What of rows does not follow from those before, (C, M - order, p)."""
    p, last = a.shape[1], rows.shape[1]
    parts = (a[:, i, None, None] * rows[:, p - 1 - i : last - 1 - i] for i in range(p))
    return np.asarray(rows[:, p:] - sum(parts))


def moments(rows: Array) -> Array:
    """Of noise, (C, rows)."""
    part = np.array([rows[:, LAGS - i : rows.shape[1] - i] for i in range(LAGS + 1)])
    return np.asarray(np.einsum("ict,jct->cij", part, part))


def test_what_is_made_is_found_again() -> None:
    """Two channels of three roots, one pair of them complex; else whitening whitens nothing."""
    roots = ([0.9, 0.7 * np.exp(1j), 0.7 * np.exp(-1j)], [0.6, 0.7 * np.exp(2j), 0.7 * np.exp(-2j)])
    noise = Autoregression(
        np.array([-np.real(np.poly(each))[1:] for each in roots]), np.array([0.2, 5.0])
    )
    rows = NoiseMaker(noise, 1, np.random.default_rng(0)).rows(100_000)[..., 0]
    assert best_order(moments(rows), rows.shape[1] - LAGS) in (3, 4, 5)
    np.testing.assert_allclose(fit(moments(rows), 3), noise.coefficients, atol=0.03)
    left = whitened(rows[..., None], noise.coefficients)[..., 0]
    np.testing.assert_allclose(left.std(axis=1), noise.sigma, rtol=0.02)
    np.testing.assert_allclose(noise.memory, -1 / np.log([0.9, 0.7]))
    pieces = NoiseMaker(noise, 1, np.random.default_rng(0))
    cut = np.concatenate([pieces.rows(20), pieces.rows(30)], axis=1)[..., 0]
    np.testing.assert_array_equal(cut, rows[:, :50])


def test_noise_that_no_model_has_is_met() -> None:
    """It is stationary from its first row, never grows, and may be absent."""
    lasting = Autoregression(np.array([[0.97]]), np.array([np.sqrt(1 - 0.97**2)]))
    rows = NoiseMaker(lasting, 4000, np.random.default_rng(0)).rows(60)[0]
    np.testing.assert_allclose(rows.std(axis=1), 1.0, atol=0.06)
    growing = 1.05 ** np.arange(200)[None] + 1e-3 * np.random.default_rng(0).normal(size=(1, 200))
    held = Autoregression(fit(moments(growing), 2), np.ones(1))
    assert 0 < held.memory[0] <= -1 / np.log(LARGEST_ROOT) * (1 + 1e-9)
    assert not fit(np.zeros((2, LAGS + 1, LAGS + 1)), 3).any()
    assert not WHITE.memory.any()


@given(rngs, st.lists(st.integers(LAGS, 40), min_size=1, max_size=4), st.integers(1, 50))
def test_products_are_those_of_the_rows(
    rng: np.random.Generator, counts: list[int], cut: int
) -> None:
    """However they are cut; rows after a pause have none before. Else long recordings differ."""
    each = [rng.normal(size=(3, count, 5)) for count in counts]
    found, maps = products(*each, cut=cut), rng.normal(size=(3, 5, 2))
    inner = rng.normal(size=(5, 5))
    inner += inner.T
    combined = products(*(rows @ maps for rows in each))
    assert found.rows == sum(counts)
    for order in range(LAGS + 1):
        long = [rows for rows in each if rows.shape[1] > order]
        assert found.after(order) == sum(rows.shape[1] - order for rows in long)
        a = rng.uniform(-0.5, 0.5, (3, order))
        parts = (whitened(rows, a) for rows in long)
        white = sum((part.swapaxes(1, 2) @ part for part in parts), np.zeros((3, 5, 5)))
        np.testing.assert_allclose(found.whitened(a), white, atol=1e-10)
        wanted = np.zeros((3, order + 1, order + 1))
        for rows in long:
            part = np.array([rows[:, order - i : rows.shape[1] - i] for i in range(order + 1)])
            wanted += np.einsum("ictp,pq,jctq->cij", part, inner, part)
        np.testing.assert_allclose(found.moments(inner, order), wanted, atol=1e-9)
    np.testing.assert_allclose(found.combined(maps).whitened(a), combined.whitened(a), atol=1e-10)


def test_the_whitened_fit_is_least_squares_of_whitened_rows() -> None:
    block = problem(0, SLOW)
    found = whitened_fit(products(block))
    white = whitened(block, found.noise.coefficients) / found.noise.sigma[:, None, None]
    rows = white.reshape(-1, 5)
    expected, *_ = np.linalg.lstsq(rows[:, :3], rows[:, 3], rcond=None)
    np.testing.assert_allclose(found.values, expected, rtol=1e-3)  # weights of a round before
    normal = rows[:, :3].T @ rows[:, :3]
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal), rtol=1e-9)


def test_constants_are_found_apart_from_the_parameters() -> None:
    """Those that a parameter imitates are not told; the others are, to their sigmas."""
    block, bias = problem(0, WHITE, rows=2000), np.array([0.3, -1.0, 0.2, 3.0])
    block[..., 0] = np.array([0.0, 0.0, 1.0, 0.0])[:, None]  # a constant in channel 2
    made = NoiseMaker(WHITE, 1, np.random.default_rng(5)).rows(2000)[..., 0]
    block[..., 3] = block[..., :3] @ TRUTH + bias[:, None] + made
    there = constants(products(block))
    assert there.directions.shape == (4, 3)
    assert np.abs(there.directions[2]).max() < 1e-6
    hidden = np.abs(there.hidden[0])
    assert hidden[1:].max() < 1e-6 * hidden[0]
    found = whitened_fit(carrying_constants(products(block), there.directions))
    told = there.directions @ found.values[3:]
    np.testing.assert_allclose(told[[0, 1, 3]], bias[[0, 1, 3]], atol=0.2)
    there_is = np.linalg.solve(found.covariance[3:, 3:], found.values[3:]) @ found.values[3:]
    assert square_of_last(found, 3) == pytest.approx(there_is)


def slow_columns(seed: int, size: Array, rows: int = 4000) -> tuple[LaggedProducts, LaggedProducts]:
    """Columns seen with noise, (3,), and products of other noise of the same size."""
    rng, start = np.random.default_rng(seed), np.array([0.7, -1.0, 0.0])
    block = problem(seed, Autoregression(np.full((4, 1), 0.9), 0.3 * np.sqrt(SIGMA)), rows)
    seen = block[..., :3] + size * rng.normal(size=(4, rows, 3))
    made, ones = size * rng.normal(size=seen.shape), block[..., 4:]
    left = block[..., 3:4] - seen @ start[:, None]
    noise = np.concatenate([made, -made @ start[:, None], 0 * ones], axis=2)
    return products(np.concatenate([seen, left, ones], axis=2)), products(noise)


@pytest.mark.parametrize(("fits", "size"), [(whitened_fit, 0.015), (weighted_fit, 0.2)])
def test_what_noise_of_the_columns_draws_to_zero_comes_back(fits: Fit, size: float) -> None:
    """Else an estimate of many rows is wrong by several of its sigmas."""
    left, before, after = TRUTH - np.array([0.7, -1.0, 0.0]), [], []

    def scores(found: NoiseFit) -> Array:
        return np.asarray((found.values - left) / np.sqrt(np.diagonal(found.covariance)))

    for seed in range(12):
        rows, made = slow_columns(seed, np.full(3, size))
        plain = fits(rows, None)
        better = undiluted(plain, made)
        assert not better.drowned(np.eye(3)).any()
        before.append(scores(plain))
        after.append(scores(better.found))
    assert np.abs(np.mean(before, axis=0)).max() > 2.0
    assert np.abs(np.mean(after, axis=0)).max() < 1.2
    assert 0.6 < np.sqrt(np.mean(np.square(after))) < 1.5


def test_columns_without_noise_stay_and_drowned_ones_are_named() -> None:
    """No estimate runs away, no sigma shrinks."""
    for size in ([0.0, 0.0, 0.0], [30.0, 1e-3, 1e-3], [1e-3, 1e-3, 30.0]):
        rows, made = slow_columns(1, np.array(size), 600)
        plain = whitened_fit(rows)
        better = undiluted(plain, made)
        np.testing.assert_array_equal(better.drowned(np.eye(3)), np.array(size) > 1)
        added = better.found.covariance - plain.covariance
        assert np.linalg.eigvalsh(added).min() > -1e-12
        assert np.isfinite(better.found.values).all()
        if not any(size):
            np.testing.assert_allclose(better.found.values, plain.values, rtol=1e-12)


def test_two_models_answers_are_averaged_as_a_mixture() -> None:
    """The covariance of a mixture by its definition; a constant that is clear is taken."""
    means = np.array([1.0, 2.0, 0.0]), np.array([2.0, 1.5, -1.0])
    spreads = np.diag([0.5, 0.5, 0.0]), 2.0 * np.eye(3)
    alone, beside = (
        NoiseFit(mean[:k], spread[:k, :k], WHITE, WHITE, spread[:k, :k])
        for k, mean, spread in zip((2, 3), means, spreads, strict=True)
    )
    found = averaged(alone, beside, 0.3)
    mean = 0.7 * means[0] + 0.3 * means[1]
    second = 0.7 * (spreads[0] + np.outer(means[0], means[0]))
    second += 0.3 * (spreads[1] + np.outer(means[1], means[1]))
    np.testing.assert_allclose(found.values, mean)
    np.testing.assert_allclose(found.covariance, second - np.outer(mean, mean), atol=1e-12)
    shifted = problem(0, WHITE)
    shifted[..., 3] += 5.0
    clear = averaged_fit(products(shifted), None, whole=True)
    assert clear.weight > 0.99
    np.testing.assert_allclose(clear.directions @ clear.found.values[3:], 5.0, atol=1.0)
    weights = [averaged_fit(products(problem(s, WHITE)), None, whole=True).weight for s in range(9)]
    assert np.median(weights) < 0.5
    few = averaged_fit(products(shifted[:, :40]), None, whole=True)
    assert (few.directions.shape, few.weight) == ((4, 0), 0.0)
