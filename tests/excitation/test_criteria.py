"""Criteria are what they say, and their derivatives are right."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.excitation.criteria import CRITERIA, CriterionName, e_optimal
from testbed.excitation.information import _inverse

NAMES: tuple[CriterionName, ...] = ("a", "d", "e")


def covariance(seed: int, count: int = 6) -> np.ndarray:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, count)) * 10.0 ** rng.uniform(-2, 2, count)
    return np.asarray(root @ root.T + 1e-3 * np.eye(count))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(5))
def test_slopes_are_those_of_differences(name: CriterionName, seed: int) -> None:
    here, rng = covariance(seed), np.random.default_rng(seed + 100)
    turn = rng.normal(size=here.shape)
    step = 1e-5 * np.linalg.eigvalsh(here)[0] * (turn + turn.T)
    _, slope = CRITERIA[name](here)
    after, before = (CRITERIA[name](here + sign * step)[0] for sign in (1, -1))
    wanted = float(np.sum(slope * step))
    assert (after - before) / 2 == pytest.approx(wanted, rel=1e-4, abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_of_equal_axes_all_criteria_are_the_variance(name: CriterionName) -> None:
    value, _ = CRITERIA[name](0.04 * np.eye(7))
    assert value == pytest.approx(np.log(0.04))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("factor", [1e-8, 3.0, 1e8])
def test_noise_shifts_every_criterion_alike(name: CriterionName, factor: float) -> None:
    here = covariance(3)
    shift = CRITERIA[name](factor * here)[0] - CRITERIA[name](here)[0]
    assert shift == pytest.approx(np.log(factor))


@pytest.mark.parametrize("seed", range(5))
def test_the_smooth_largest_axis_is_near_the_largest(seed: int) -> None:
    here = covariance(seed)
    longest = np.log(np.linalg.eigvalsh(here)[-1])
    value, _ = e_optimal(here)
    assert longest - np.log(len(here)) / 8 - 1e-12 <= value <= longest + 1e-12


def spread(entries: list[list[float]]) -> np.ndarray | None:
    return _inverse(np.array(entries))


def test_what_is_no_information_has_no_inverse() -> None:
    """Infinite, about nothing, or contradicting itself; sizes may differ by many orders."""
    assert spread([[np.inf, 0], [0, 1]]) is None
    assert spread([[np.nan, 0], [0, 1]]) is None
    assert spread([[0, 0], [0, 1]]) is None
    assert spread([[1, 2], [2, 1]]) is None
    found = spread([[1e12, 1e2], [1e2, 1e-4]])
    assert found is not None
    np.testing.assert_allclose(found @ [[1e12, 1e2], [1e2, 1e-4]], np.eye(2), atol=1e-3)
