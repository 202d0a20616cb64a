"""Ridge regression is the minimum that it is said to be, and nothing where the data say all."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

import testbed as tb
from testbed.arrays import Array
from testbed.errors import SettingsError
from testbed.identification.ridge import WARNING, ridge
from tests.helpers.ideal import ideal
from tests.helpers.runs import noisy, robot


@pytest.mark.parametrize("seed", range(6))
def test_the_drawn_values_minimise_misfit_and_length(seed: int) -> None:
    """By a general minimiser, in the rows' own terms: columns of unit length, noise of one."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(40, 4)) @ rng.normal(size=(4, 4)) * [1.0, 30.0, 0.01, 5.0]
    y = rows @ rng.normal(size=4) + rng.normal(size=40)
    covariance: Array = np.asarray(np.linalg.inv(rows.T @ rows), dtype=np.float64)
    plain = np.asarray(covariance @ rows.T @ y, dtype=np.float64)
    length = np.linalg.norm(rows, axis=0)
    strength = 4 / np.sum((plain * length) ** 2)

    def cost(scaled: np.ndarray) -> float:
        misfit = y - rows / length @ scaled
        return float(misfit @ misfit + strength * scaled @ scaled)

    found = minimize(cost, plain * length, tol=1e-14).x / length
    values, spread = ridge(plain, covariance)
    np.testing.assert_allclose(values * length, found * length, rtol=1e-4, atol=1e-5)
    eigenvalues = np.linalg.eigvalsh((covariance - spread) * np.outer(length, length))
    assert eigenvalues.min() >= -1e-9 * eigenvalues.max()  # never less certain


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_an_estimate_by_ridge_is_drawn_and_says_so(name: str) -> None:
    tree = robot(name)
    recording = noisy(ideal(tree, duration=6.0))
    plain = tb.identify(tree, recording)
    drawn = tb.identify(tree, recording, settings=tb.Settings(ridge=True))
    values, _ = ridge(plain.values, plain.covariance)
    np.testing.assert_array_equal(drawn.values, values)
    assert (drawn.sigma <= plain.sigma * (1 + 1e-9)).all()
    assert WARNING in drawn.warnings
    assert WARNING not in plain.warnings


def test_ridge_is_true_or_false() -> None:
    with pytest.raises(SettingsError, match="ridge is true or false, found 'yes'"):
        tb.Settings(ridge="yes")  # type: ignore[arg-type]
