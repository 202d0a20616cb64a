"""Gaussians of named parameters, against rows of a regression stacked and solved at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.core.base.arrays import Array
from testbed.core.base.gaussian import Gaussian
from tests.helpers.strategies import Rng, rngs


def regression(rows: Array, measured: Array) -> Gaussian:
    """Least squares with noise of variance one."""
    covariance = np.asarray(np.linalg.inv(rows.T @ rows), dtype=float)
    names = tuple(f"x{k}" for k in range(rows.shape[1]))
    return Gaussian(names, ("",) * len(names), covariance @ rows.T @ measured, covariance)


@given(rngs, st.integers(2, 6), st.integers(1, 3))
def test_conditions_are_rows_and_marginals_are_combinations(rng: Rng, p: int, k: int) -> None:
    rows, more = rng.normal(size=(p + 5, p)), rng.normal(size=(k, p))
    measured, added = rng.normal(size=p + 5), rng.normal(size=k)
    before = regression(rows, measured)
    after = before.conditional(more, added, np.eye(k))
    both = regression(np.vstack([rows, more]), np.append(measured, added))
    np.testing.assert_allclose(after.values, both.values, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(after.covariance, both.covariance, rtol=1e-7, atol=1e-9)
    exact = before.conditional(more[:1], added[:1])
    assert more[0] @ exact.values == pytest.approx(added[0])
    assert more[0] @ exact.covariance @ more[0] == pytest.approx(0, abs=1e-9)
    names = before.names[1::-1]
    one, other = before.marginal(names), before.transform(np.eye(p)[[1, 0]], names, ("", ""))
    np.testing.assert_array_equal(one.values, other.values)
    np.testing.assert_allclose(one.covariance, other.covariance)


def test_what_is_not_identifiable_has_no_sigma_and_no_draws() -> None:
    made = Gaussian(("a", "b", "c"), ("kg",) * 3, np.arange(3.0), np.diag([1.0, 4.0, 9.0]), ("b",))
    assert made.sigma.tolist() == [1.0, np.inf, 3.0]
    sums = made.transform(np.array([[1.0, 0, 1], [1, 1, 0]]), ("a+c", "a+b"), ("kg", "kg"))
    assert sums.unidentifiable == ("a+b",)
    assert sums.sigma[0] == pytest.approx(np.sqrt(10))
    draws = made.sample(4000, seed=3)
    np.testing.assert_array_equal(draws, made.sample(4000, seed=3))
    assert np.isnan(draws[:, 1]).all()
    np.testing.assert_allclose(draws[:, [0, 2]].std(axis=0), [1, 3], rtol=0.05)
