"""Robots drawn by data and model file: they can exist, agree with the data, and keep the prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import testbed as tb
from benchmarks.sampling import factors, prior_robots
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.robots import (
    BODY,
    _log_prior,
    elliptical_slices,
)
from testbed.bodies.estimate_summary import estimate_of_summary, summary_of
from testbed.bodies.prior import prior_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.core.parameters.pseudo_inertia import coordinates
from testbed.core.robot.inertia import inertia_flaw
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot

UNIFORM = 1e-3
"""Chance of a test that fails although all is right."""


def test_slices_draw_a_gaussian_with_a_corner_cut_off() -> None:
    """If the sampler is wrong, every band that anybody makes of the robots is."""
    rng, correlated = np.random.default_rng(3), np.array([[1.0, 0.9], [0.9, 1.0]])

    def density(points: Array) -> Array:
        form = np.einsum("ni,ij,nj->n", points, np.linalg.inv(correlated), points)
        return np.where((points > 0.5).all(axis=1), -form / 2, -np.inf)

    found = elliptical_slices(density, rng.uniform(0.6, 2, (2000, 2)), 40, rng)
    exact = rng.multivariate_normal(np.zeros(2), correlated, 20_000)
    exact = exact[(exact > 0.5).all(axis=1)]
    for along in ([1, 0], [0, 1], [1, 1], [1, -1]):
        assert stats.ks_2samp(found @ along, exact @ along).pvalue > UNIFORM


def test_the_density_of_bodies_is_that_of_their_coordinates() -> None:
    """By the determinant of the derivatives, taken as differences."""
    rng, error = np.random.default_rng(5), 0.4

    def of(logs: Array) -> Array:
        root = factors(logs)
        return coordinates(root @ np.swapaxes(root, -1, -2))

    differences = []
    for logs in error * rng.normal(size=(6, 10)):
        steps = 1e-6 * np.eye(10)
        slope = np.array([(of(logs + d) - of(logs - d)) / 2e-6 for d in steps])
        by_hand = -(logs**2).sum() / error**2 / 2 - np.linalg.slogdet(slope)[1]
        root = factors(logs)
        differences.append(_log_prior((root @ root.T)[None, None], error)[0] - by_hand)
    np.testing.assert_allclose(differences, differences[0], atol=1e-6)


@pytest.mark.slow
def test_draws_can_exist_agree_with_the_data_and_are_the_files_elsewhere() -> None:
    """What data determine is theirs, sigma and correlation; an unseen mass keeps the file's."""
    file = robot("puma")
    prior, rng = prior_of(file), np.random.default_rng(1)
    truth = prior_robots(file, prior, 0.3, 1, rng).tree(0, file)
    estimate = tb.identify(file, measured(truth, 2, duration=10.0), "internal")
    found = tb.robots(file, [estimate], prior, 250, rng, ConsistencyOptions(prior_error=0.3))
    trees = [found.tree(k, file) for k in range(250)]
    assert all(inertia_flaw("", b.mass, b.central) is None for t in trees[:50] for b in t.inertias)
    assert estimate.drives is not None
    drawn = np.array([estimate.drives.values(tb.barycentric(t), t) for t in trees])
    white = np.linalg.inv(np.linalg.cholesky(estimate.covariance))
    z = (drawn - estimate.values) @ white.T
    assert 0.8 < (z.std(axis=0)).mean() < 1.1
    assert np.abs(z.mean(axis=0)).max() < 4
    mass = found.values[:, 0, 0]  # of the first body joint torques see nothing
    logs = np.log(mass / prior.standard[0, 0]) / 0.3
    assert found.share[0, 0] < 0.01
    assert found.share[:, BODY].min() > 0.9
    assert stats.kstest(logs, "norm").pvalue > UNIFORM
    again = tb.robots(file, [estimate], prior, 3, np.random.default_rng(4))
    same = tb.robots(file, [estimate], prior, 3, np.random.default_rng(4))
    np.testing.assert_array_equal(again.values, same.values)


@pytest.mark.slow
def test_draws_obey_what_is_known_and_a_summary_draws_the_same() -> None:
    file = robot("puma")
    prior = prior_of(file)
    estimate = tb.identify(file, measured(file, 2, duration=10.0))
    weighed = ConsistencyOptions(known={"mass/link3": 6.0})
    again = estimate_of_summary(file, summary_of(estimate))
    one, other = (
        tb.robots(file, [each], prior, 5, np.random.default_rng(4), weighed)
        for each in (estimate, again)
    )
    np.testing.assert_allclose(one.values[:, 2, 0], 6.0, rtol=1e-9)
    np.testing.assert_array_equal(one.values, other.values)
    with refuses(SettingsError, "other parameters"):
        estimate_of_summary(file, replace(summary_of(estimate), names=estimate.names[::-1]))
