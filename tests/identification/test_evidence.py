"""Whether a covariance can be one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.identification.estimate import Estimate
from testbed.identification.evidence import precise
from tests.helpers.runs import robot, run_of


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return run_of(robot("puma")).estimates["external"]


def with_covariance(estimate: Estimate, changed: Array) -> Estimate:
    return replace(estimate, covariance=changed)


def test_an_estimate_of_many_rows_is_precise(estimate: Estimate) -> None:
    assert precise(estimate)


def test_variances_are_not_negative(estimate: Estimate) -> None:
    wrong = estimate.covariance.copy()
    wrong[2, 2] *= -1
    assert not precise(with_covariance(estimate, wrong))


def test_nor_are_those_of_any_combination(estimate: Estimate) -> None:
    wrong = estimate.covariance.copy()
    wrong[0, 1] = wrong[1, 0] = 1.1 * np.sqrt(wrong[0, 0] * wrong[1, 1])
    assert not precise(with_covariance(estimate, wrong))


def test_what_is_known_exactly_has_no_variance(estimate: Estimate) -> None:
    sure = estimate.covariance.copy()
    sure[3], sure[:, 3] = 0.0, 0.0
    assert precise(with_covariance(estimate, sure))
