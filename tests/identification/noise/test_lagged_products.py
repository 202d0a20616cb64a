"""Products with rows before: against sums over all rows at once."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums

LAGS = 4


def summed(rows: Array, cuts: list[int]) -> LaggedProducts:
    sums = LaggedSums(LAGS)
    for first, last in zip([0, *cuts], [*cuts, rows.shape[1]], strict=True):
        sums.add(rows[:, first:last])
    return sums.finish()


@pytest.mark.parametrize("count", [1, 3, LAGS, 5, 60])
def test_sums_are_those_of_all_pairs(count: int) -> None:
    """Fewer rows than lags among them; for any cut into blocks."""
    rng = np.random.default_rng(count)
    rows = rng.normal(size=(3, count, 5))
    for cuts in ([], [1], [count // 2], list(range(1, count))):
        found = summed(rows, cuts)
        assert found.rows == count
        for lag in range(LAGS + 1):
            pairs = zip(rows[:, lag:].swapaxes(0, 1), rows.swapaxes(0, 1), strict=False)
            expected = sum(now[:, :, None] * before[:, None] for now, before in pairs)
            np.testing.assert_allclose(found.products[lag], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("order", range(LAGS + 1))
def test_whitened_products_are_products_of_whitened_rows(order: int) -> None:
    """The first rows, which have too few before them, left out exactly."""
    rng = np.random.default_rng(order)
    rows, a = rng.normal(size=(3, 50, 5)), rng.uniform(-0.5, 0.5, (3, order))
    white = rows[:, order:].copy()
    for i in range(order):
        white -= a[:, i, None, None] * rows[:, order - 1 - i : 49 - i]
    expected = white.swapaxes(1, 2) @ white
    np.testing.assert_allclose(summed(rows, [7, 8, 30]).whitened(a), expected, rtol=1e-12)


def test_combined_columns_have_the_products_of_combined_rows() -> None:
    rng = np.random.default_rng(0)
    rows, maps = rng.normal(size=(3, 40, 5)), rng.normal(size=(3, 5, 2))
    found, expected = summed(rows, []).combined(maps), summed(rows @ maps, [])
    for name in ("products", "first", "last"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)


@pytest.mark.parametrize("order", range(LAGS + 1))
def test_rows_after_a_pause_have_no_rows_before(order: int) -> None:
    """Whitened products and moments are sums of those of each sequence; short ones among them."""
    rng = np.random.default_rng(order)
    a, sums = rng.uniform(-0.5, 0.5, (3, order)), LaggedSums(LAGS)
    each = [rng.normal(size=(3, count, 5)) for count in (20, LAGS, 9, 33)]
    for rows in each:
        sums.pause()
        sums.add(rows[:, :3])
        sums.add(rows[:, 3:])
    found, apart = sums.finish(), [summed(rows, []) for rows in each]
    assert found.after(order) == sum(one.after(order) for one in apart)
    np.testing.assert_allclose(found.whitened(a), sum(one.whitened(a) for one in apart), rtol=1e-11)
    inner = rng.normal(size=(5, 5))
    inner += inner.T
    expected = sum(one.moments(inner, order) for one in apart)
    np.testing.assert_allclose(found.moments(inner, order), expected, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("order", range(LAGS + 1))
def test_moments_are_sums_over_the_same_rows(order: int) -> None:
    rng = np.random.default_rng(order)
    rows, inner = rng.normal(size=(3, 30, 5)), rng.normal(size=(5, 5))
    inner += inner.T
    found = summed(rows, [11]).moments(inner, order)
    for i in range(order + 1):
        for j in range(order + 1):
            both = (rows[:, order - lag : 30 - lag] for lag in (i, j))
            expected = np.einsum("ctp,pq,ctq->c", next(both), inner, next(both))
            np.testing.assert_allclose(found[:, i, j], expected, rtol=1e-9, atol=1e-10)
