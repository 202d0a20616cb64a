"""Whether rigid bodies can have an estimate's parameters: proved, and never of those that can."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import testbed as tb
from testbed.arrays import Array
from testbed.identification.estimate import METHODS, Estimate, Method
from testbed.identification.rigid_bodies import MODEL_ERROR, possibility
from testbed.parameters.barycentric import to_barycentric
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.paths import GOLDEN
from tests.helpers.robots import random_robot

pytestmark = pytest.mark.slow


def estimate_of(tree: tb.Tree, method: Method, seed: int = 0) -> Estimate:
    settings = replace(EXACT, terms=("coulomb", "rotor"))
    return tb.identify(tree, ideal(tree, seed=seed), method, settings=settings)


def having(estimate: Estimate, values: Array, relative: float) -> Estimate:
    """The estimate with other minimal parameters, of a relative sigma."""
    base = estimate.base
    largest = {u: np.abs(values[[u == v for v in base.units]]).max() for u in set(base.units)}
    sigma = relative * np.array([max(largest[unit], 1e-3) for unit in base.units])
    whole, covariance = np.array(estimate.values), np.array(estimate.covariance)
    whole[: len(values)] = values
    covariance[: len(values), : len(values)] = np.diag(sigma**2)
    spread = np.sqrt(np.diagonal(covariance))
    return replace(estimate, values=whole, covariance=covariance, sigma=spread)


def random_bodies(tree: tb.Tree, rng: np.random.Generator, thin: bool) -> Array:
    """Barycentric parameters of rigid bodies, (n, 10); thin: points, rods and nothing at all."""
    found = []
    for _ in range(tree.n):
        points = rng.normal(size=(rng.integers(0, 3) if thin else 8, 3)) * 0.3
        masses = rng.uniform(0.1, 2.0, len(points))
        moment = masses @ points
        second = np.einsum("k,ka,kb->ab", masses, points, points)
        inertia = np.trace(second) * np.eye(3) - second
        tensor = inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        found.append([masses.sum(), *moment, *tensor])
    return np.asarray(to_barycentric(tree, np.array(found)))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("thin", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_no_robot_is_called_impossible(seed: int, thin: bool, method: Method) -> None:
    """Point masses and missing bodies lie on the cone's edge; noise moves them beyond it."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 1 + seed % 6).tree()
    estimate = estimate_of(tree, method)
    for relative in (1e-9, 1e-3, 0.1):
        values = estimate.base.matrix @ random_bodies(tree, rng, thin).ravel()
        there = having(estimate, values, relative)
        noise = np.linalg.cholesky(there.base.covariance + 1e-300 * np.eye(len(values)))
        noisy = having(estimate, values + noise @ rng.normal(size=len(values)), relative)
        for each in (there, noisy):
            assert not possibility(each).impossible


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(6))
def test_mirrored_robots_are_impossible(seed: int, method: Method) -> None:
    """All parameters negated; the nearest that is possible is possible.

    To 5 %: bodies of no inertia with a first moment come nearer the heavier they are.
    """
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 2 + seed % 4).tree()
    estimate = estimate_of(tree, method)
    values = -estimate.base.matrix @ random_bodies(tree, rng, False).ravel()
    found = possibility(having(estimate, values, 1e-3))
    assert found.impossible
    assert found.distance > found.limit
    assert not possibility(having(estimate, found.nearest, 0.05)).impossible


@pytest.mark.parametrize("seed", range(6))
def test_no_robot_is_nearer_than_proved(seed: int) -> None:
    """Whatever robot is drawn, heavy or light, is at least that far away, in the same sigmas."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 2 + seed % 4).tree()
    estimate = estimate_of(tree, "external")
    values = estimate.base.matrix @ random_bodies(tree, rng, False).ravel()
    values *= rng.choice([-1.0, 1.0], len(values))
    wrong = having(estimate, values, 1e-2)
    found = possibility(wrong)
    scale = np.abs(wrong.base.values)
    for unit in set(wrong.base.units):
        same = np.array([each == unit for each in wrong.base.units])
        scale[same] = np.maximum(scale[same], 0.1 * scale[same].max())
    sigma = np.sqrt(np.diagonal(wrong.base.covariance) + (MODEL_ERROR * scale) ** 2)
    for _ in range(300):
        other = rng.lognormal(0, 1) * random_bodies(tree, rng, bool(rng.integers(2)))
        far = np.linalg.norm((estimate.base.matrix @ other.ravel() - values) / sigma)
        assert far >= found.distance - 1e-6
    left = float(np.linalg.norm((found.nearest - values) / sigma))
    assert left == pytest.approx(found.distance, rel=1e-6, abs=1e-6)


def test_a_rotor_may_add_to_an_inertia_and_never_take_from_it(puma: tb.Tree) -> None:
    """K*1zz+rotor/waist above what any body has is a rotor; below zero is nothing."""
    estimate = estimate_of(puma, "internal")
    k = estimate.base.names.index("K*1zz+rotor/waist")
    for value, impossible in ((1e4, False), (-5.0, True)):
        values = np.array(estimate.base.values)
        values[k] = value
        assert possibility(having(estimate, values, 1e-3)).impossible == impossible


def test_the_limit_is_five_sigmas_of_all_parameters(puma: tb.Tree) -> None:
    estimate = estimate_of(puma, "external")
    count = len(estimate.base.values)
    expected = stats.chi2.isf(2 * stats.norm.sf(5.0), count)
    assert possibility(estimate).limit == pytest.approx(np.sqrt(expected), rel=1e-12)


@pytest.mark.parametrize("robot", ["humanoid_pelvis", "kuka_lwr4"])
@pytest.mark.slow
def test_large_robots_are_told_alike(robot: str) -> None:
    """Thirty joints."""
    tree = tb.load_tree(GOLDEN / f"robots/{robot}.urdf", weld_root=True)
    for method in METHODS:
        estimate = estimate_of(tree, method)
        assert not possibility(having(estimate, estimate.base.values, 1e-3)).impossible
        mirrored = having(estimate, -estimate.base.values, 1e-3)
        assert possibility(mirrored).impossible
