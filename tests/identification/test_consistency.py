"""Bodies that can exist, nearest by their definition; robots drawn by data and model file."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import testbed as tb
from benchmarks.sampling import factors, prior_robots
from testbed.bodies.consistency.consistent import consistent, robot_of
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.robots import BODY, _log_prior, elliptical_slices
from testbed.bodies.estimate_summary import estimate_of_summary, summary_of
from testbed.bodies.prior import Prior, prior_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.core.estimation.diagnostics.rigid_bodies import rigid_body_test
from testbed.core.estimation.estimate import METHODS, Estimate, Method
from testbed.core.parameters.pseudo_inertia import coordinates, matrices, parameters
from testbed.core.parameters.symbols import to_barycentric
from testbed.core.robot.rigid_matter import inertia_flaw
from testbed.lab.experiment.evaluate import wrong_bodies
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot
from tests.helpers.strategies import Rng, few, rngs


def prior_for(tree: tb.Tree, seed: int = 7, error: float = 0.3) -> Prior:
    """A model file that is wrong by so much."""
    return prior_of(wrong_bodies(tree, error, np.random.default_rng(seed)))


@cache
def estimate_of(name: str, method: Method = "external") -> Estimate:
    """From ten seconds with the usual noise."""
    return tb.identify(robot(name), measured(robot(name), 1, duration=10.0), method)


def cost(found: Array, estimate: Estimate, prior: Prior, error: float) -> float:
    """What is to be least, by its definition, for estimates without terms of joints."""
    gap = estimate.minimal.standard_matrix @ found.ravel() - estimate.values
    fit, away = gap @ np.linalg.solve(estimate.covariance, gap) / 2, 0.0
    for own, other in zip(matrices(found), matrices(prior.standard), strict=True):
        part = np.linalg.solve(other, own)
        away += float(np.trace(part) - np.linalg.slogdet(part)[1] - 4)
    return float(fit + away / error**2)


@pytest.mark.slow
def test_no_possible_bodies_nearby_are_better() -> None:
    """The problem is convex: what no neighbour betters is the least. And every body can exist."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        tree = random_robot(rng, 3).tree()
        estimate, prior = tb.identify(tree, measured(tree, seed, duration=5.0)), prior_for(tree)
        if seed:
            estimate = replace(estimate, covariance=100 * estimate.covariance)
        found = consistent(tree, [estimate], prior, ConsistencyOptions(prior_error=0.5))
        here = cost(np.array(found.standard), estimate, prior, 0.5)
        for size in (1e-4, 1e-2):
            for _ in range(50):
                change = np.eye(4) + size * rng.normal(size=(tree.n, 4, 4))
                bodies = change @ matrices(found.standard) @ np.swapaxes(change, 1, 2)
                there = cost(parameters(bodies), estimate, prior, 0.5)
                assert there >= here - 1e-6 * abs(here)
        assert found.unsettled < 1e-2
        assert (np.linalg.eigvalsh(matrices(found.standard)) > 0).all()
        assert (found.eigenvalues[:, 0] > 0).all()
        assert ((found.data_share >= 0) & (found.data_share <= 1)).all()


def test_perfect_data_and_the_true_bodies_give_the_true_bodies() -> None:
    """Friction and rotors, too; the tree's own bodies are not looked at, but the prior's."""
    tree = robot("puma").with_joints({"elbow": {"rotor_inertia": 0.5}})
    settings = replace(EXACT, terms=("coulomb", "viscous", "rotor"))
    estimates = [tb.identify(tree, ideal(tree), method, settings=settings) for method in METHODS]
    found = consistent(tree, estimates, prior_of(tree))
    own = robot_of(found, tree)
    for body, truth in zip(own.inertias, tree.inertias, strict=True):
        assert body.mass == pytest.approx(truth.mass, rel=1e-5)
        np.testing.assert_allclose(body.tensor, truth.tensor, atol=1e-4 * truth.tensor.max())
    for key in ("coulomb", "viscous", "rotor_inertia"):
        data_share, true = ([getattr(j, key) for j in each.joints] for each in (own, tree))
        np.testing.assert_allclose(data_share, true, rtol=1e-5, atol=1e-4)
    assert found.diagnostics == ()
    assert (found.coefficients >= 0).all()
    false = wrong_bodies(tree, 0.9, np.random.default_rng(0)).without_friction()
    other = consistent(false, estimates, prior_of(tree))
    np.testing.assert_array_equal(other.standard, found.standard)
    np.testing.assert_array_equal(other.coefficients, found.coefficients)


@pytest.mark.slow
def test_known_masses_are_obeyed() -> None:
    """Exactly, or to their sigma; one that the file has not, and of all bodies together."""
    tree, prior = robot("puma"), prior_for(robot("puma"))
    estimates = [estimate_of("puma", method) for method in METHODS]
    names, total = [joint.body for joint in tree.joints], sum(b.mass for b in tree.inertias)
    for sigma, near in ((1e-4, 1e-3), (0.0, 1e-9)):
        options = ConsistencyOptions(known={f"mass/{names[1]}": 4.5, "mass": [total, sigma]})
        found = consistent(tree, estimates, prior, options)
        assert found.standard[1, 0] == pytest.approx(4.5, rel=1e-9)
        assert found.sigma[1, 0] == found.data_share[1, 0] == 0
        assert found.standard[:, 0].sum() == pytest.approx(total, abs=near)
        assert found.unsettled < 1e-2


def test_impossible_wishes_name_what_contradicts() -> None:
    for words, culprit in (
        ({"known": {"mass/a": -1.0}}, "mass/a"),
        ({"prior_error": 0.0}, "prior_error"),
    ):
        with refuses(tb.TestbedError, culprit):
            ConsistencyOptions(**words)
    tree, estimate, prior = robot("puma"), estimate_of("puma"), prior_of(robot("puma"))
    names = [joint.body for joint in tree.joints]
    light = replace(prior, standard=prior.standard * [[1], [1], [0]])
    for bodies, options, culprits in (
        (prior, ConsistencyOptions(known={f"mass/{n}": 1.0 for n in names} | {"mass": 9.0}), names),
        (prior, ConsistencyOptions(known={"mass/nobody": 1.0}), ["nobody"]),
        (light, ConsistencyOptions(known={f"mass/{names[2]}": 2.0}), [f"mass/{names[2]}"]),
    ):
        with refuses(tb.TestbedError, *culprits):
            consistent(tree, [estimate], bodies, options)


@pytest.mark.slow
def test_data_that_no_bodies_have_are_said() -> None:
    """Mirrored ones, friction below zero, wrong torque constants, covariances that are none."""
    tree, prior = robot("puma"), prior_of(robot("puma"))
    plate, torques = (estimate_of("puma", method) for method in METHODS)
    dry = np.array([name.startswith("coulomb") for name in torques.names])
    backwards = replace(torques, values=np.where(dry, -torques.values, torques.values))
    scaled = replace(torques, values=1.06 * torques.values)
    hollow = replace(torques, covariance=-torques.covariance)
    mirrored = replace(plate, values=-plate.values)
    data_share = [(mirrored,), (backwards,), (plate, scaled), (plate, hollow)]
    wrong, rubbing, both, without = found = [consistent(tree, each, prior) for each in data_share]
    assert all(each.diagnostics for each in found)
    assert wrong.bent[0].distance > 100
    assert (rubbing.coefficients >= 0).all()
    alone = consistent(tree, [plate], prior)
    assert alone.diagnostics == ()
    assert both.bent[1].widened > 3
    assert (np.abs(both.bent[0].values - alone.bent[0].values) / plate.sigma).max() < 2
    assert [each.method for each in without.bent] == ["external"]
    with refuses(tb.TestbedError):
        consistent(tree, [hollow], prior)


def having(estimate: Estimate, values: Array, relative: float) -> Estimate:
    """The estimate with other minimal parameters, of a relative sigma."""
    base, count = estimate.base, len(values)
    largest = {u: np.abs(values[[u == v for v in base.units]]).max() for u in set(base.units)}
    sigma = relative * np.array([max(largest[unit], 1e-3) for unit in base.units])
    whole, covariance = np.array(estimate.values), np.array(estimate.covariance)
    whole[:count], covariance[:count, :count] = values, np.diag(sigma**2)
    spread = np.sqrt(np.diagonal(covariance))
    return replace(estimate, values=whole, covariance=covariance, sigma=spread)


def random_bodies(tree: tb.Tree, rng: Rng, thin: bool) -> Array:
    """Barycentric parameters of rigid bodies, (10 n,); thin: points, rods and nothing at all."""
    found = []
    for _ in range(tree.n):
        points = rng.normal(size=(rng.integers(0, 3) if thin else 8, 3)) * 0.3
        masses = rng.uniform(0.1, 2.0, len(points))
        second = np.einsum("k,ka,kb->ab", masses, points, points)
        inertia = np.trace(second) * np.eye(3) - second
        tensor = inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        found.append([masses.sum(), *masses @ points, *tensor])
    return np.asarray(to_barycentric(tree, np.array(found))).ravel()


@pytest.mark.slow
@few(8)
@given(rngs, st.integers(2, 6), st.sampled_from(METHODS))
def test_robots_are_possible_and_mirrored_ones_not(rng: Rng, joints: int, method: Method) -> None:
    """Point masses lie on the cone's edge, noise moves them beyond it; the nearest is possible."""
    tree = random_robot(rng, joints).tree()
    settings = replace(EXACT, terms=("coulomb", "rotor"))
    estimate = tb.identify(tree, ideal(tree), method, settings=settings)
    maps = estimate.base.matrix
    for relative, thin in ((1e-9, True), (1e-3, False), (0.1, True)):
        there = having(estimate, maps @ random_bodies(tree, rng, thin), relative)
        sigma = there.sigma[: len(maps)]
        noisy = having(estimate, there.base.values + sigma * rng.normal(size=len(sigma)), relative)
        assert not rigid_body_test(there).impossible
        assert not rigid_body_test(noisy).impossible
    mirrored = -maps @ random_bodies(tree, rng, False)
    found = rigid_body_test(having(estimate, mirrored, 1e-3))
    assert found.impossible
    assert found.distance > found.limit
    limit = np.sqrt(stats.chi2.isf(2 * stats.norm.sf(5.0), len(mirrored)))
    assert found.limit == pytest.approx(limit, rel=1e-12)
    assert not rigid_body_test(having(estimate, found.nearest, 0.05)).impossible
    assert np.linalg.norm(found.nearest - mirrored) > 0
    for _ in range(100):  # no robot is nearer than proved
        other = rng.lognormal(0, 1) * maps @ random_bodies(tree, rng, bool(rng.integers(2)))
        far = np.linalg.norm((other - mirrored) / np.linalg.norm(found.nearest - mirrored))
        assert far > 0.2


def test_a_rotor_may_add_to_an_inertia_and_never_take_from_it() -> None:
    """K*1zz+rotor/waist above what any body has is a rotor; below zero is nothing."""
    tree, settings = robot("puma"), replace(EXACT, terms=("coulomb", "rotor"))
    estimate = tb.identify(tree, ideal(tree), "internal", settings=settings)
    k = estimate.base.names.index("K*1zz+rotor/waist")
    for value, impossible in ((1e4, False), (-5.0, True)):
        values = np.array(estimate.base.values)
        values[k] = value
        assert rigid_body_test(having(estimate, values, 1e-3)).impossible == impossible


# robots drawn by data and model file

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
