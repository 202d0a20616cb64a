"""The least of a quadratic function within bounds: what its conditions say, and another solver."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from testbed.arrays import Array
from testbed.sanity.bounded import bounded

Problem = tuple[Array, Array, Array, Array]


def problem(seed: int, *, flat: float = 1e-9) -> Problem:
    """A matrix nearly singular, as bodies of a robot make it, and bounds that matter."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 40))
    rows = rng.normal(size=(int(rng.integers(1, 60)), k)) @ rng.normal(size=(k, k))
    rows /= np.linalg.norm(rows, axis=0)
    low = rng.normal(size=k)
    high = low + rng.exponential(size=k)
    high[rng.random(k) < 0.3] = np.inf
    return rows.T @ rows + flat * np.eye(k), rows.T @ rng.normal(size=len(rows)), low, high


def cost(normal: Array, vector: Array, x: Array) -> float:
    return float(x @ normal @ x / 2 - vector @ x)


@pytest.mark.parametrize("seed", range(60))
def test_nothing_pulls_but_against_a_bound(seed: int) -> None:
    normal, vector, low, high = problem(seed)
    x = bounded(normal, vector, low, high, np.full(len(low), np.nan))
    assert (low <= x).all()
    assert (x <= high).all()
    pull = vector - normal @ x
    size = 1e-9 * (1 + np.abs(x).max())
    assert (pull[x > low] > -size).all()
    assert (pull[x < high] < size).all()


@pytest.mark.parametrize("seed", range(60))
def test_it_is_as_low_as_another_solver_comes(seed: int) -> None:
    normal, vector, low, high = problem(seed, flat=1e-3)
    x = bounded(normal, vector, low, high, np.full(len(low), np.nan))
    root = np.linalg.cholesky(normal).T
    other = lsq_linear(root, np.linalg.solve(root.T, vector), (low, high), tol=1e-14).x
    assert cost(normal, vector, x) <= cost(normal, vector, other) + 1e-9
    assert np.abs(x - other).max() < 1e-3


@pytest.mark.parametrize("seed", range(20))
def test_any_guess_gives_the_same(seed: int) -> None:
    normal, vector, low, high = problem(seed, flat=1e-3)
    none = bounded(normal, vector, low, high, np.full(len(low), np.nan))
    for guess in (low, np.where(np.isinf(high), low, high), none, np.zeros(len(low))):
        np.testing.assert_allclose(bounded(normal, vector, low, high, guess), none, atol=1e-9)


def test_without_bounds_it_is_the_solution() -> None:
    normal, vector, low, _ = problem(3, flat=0.1)
    far = np.full(len(low), 1e6)
    x = bounded(normal, vector, -far, far, np.full(len(low), np.nan))
    np.testing.assert_allclose(normal @ x, vector, atol=1e-9)
