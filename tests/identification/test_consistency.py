"""Bodies that can exist: nearest by their definition, whatever the units, and as they are asked."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import testbed as tb
from testbed.arrays import Array
from testbed.experiment.wrong_prior import wrong_bodies
from testbed.identification.conditions import conditions
from testbed.identification.consistency import Consistent, consistent, robot_of, stated_by
from testbed.identification.consistent_warnings import warnings_of
from testbed.identification.estimate import METHODS, Estimate, Method
from testbed.identification.evidence import evidence, terms_of
from testbed.identification.prior_choice import consistent_by_held_out
from testbed.identification.wishes import METRICS, Metric, Wishes
from testbed.parameters.prior import Prior, prior_of
from testbed.parameters.pseudo_inertia import (
    coordinates,
    matrices,
    of_coordinates,
    parameters,
    standard_of_coordinates,
)
from testbed.recordings.source import Source, Stretch, open_source
from testbed.reporting.consistent_table import consistent_lines
from testbed.robot.friction import ROTOR
from testbed.robot.inertia import NOTHING, Inertia
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.measured import measured
from tests.helpers.paths import REAL
from tests.helpers.robots import random_robot
from tests.helpers.runs import ROBOTS, robot


def prior_for(tree: tb.Tree, seed: int = 7, error: float = 0.3) -> Prior:
    return prior_of(wrong_bodies(tree, error, np.random.default_rng(seed)))


def estimates_of(tree: tb.Tree, seed: int = 1, seconds: float = 10.0) -> list[Estimate]:
    recording = measured(tree, seed, duration=seconds)
    return [tb.identify(tree, recording, method) for method in METHODS]


def divergence(standard: Array, prior: Array) -> float:
    """Of bodies from others, by its definition."""
    total = 0.0
    for own, other in zip(matrices(standard), matrices(prior), strict=True):
        part = np.linalg.solve(other, own)
        total += float(np.trace(part) - np.linalg.slogdet(part)[1] - 4)
    return total


def cost(found: Array, estimate: Estimate, prior: Prior, error: float, metric: Metric) -> float:
    """What is to be least, by its definition, for estimates without terms of joints."""
    gap = estimate.minimal.standard_matrix @ found.ravel() - estimate.values
    fit = gap @ np.linalg.solve(estimate.covariance, gap) / 2
    if metric == "log-det":
        return float(fit + divergence(found, prior.standard) / error**2)
    away = 0.0
    for own, other in zip(matrices(found), matrices(prior.standard), strict=True):
        root = np.linalg.cholesky(other)
        part = np.linalg.solve(root, np.linalg.solve(root, own).T)
        away += float(((part - np.eye(4)) ** 2).sum())
    return float(fit + away / error**2 / 2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_no_search_from_elsewhere_finds_anything_better(seed: int) -> None:
    """A witness without cones, barriers or Newton: triangular factors, by BFGS."""
    tree = random_robot(np.random.default_rng(seed), 2).tree()
    estimate = estimates_of(tree, seed, 5.0)[0]
    loose = replace(estimate, covariance=100 * estimate.covariance, sigma=10 * estimate.sigma)
    prior = prior_for(tree)
    found = consistent(tree, [loose], prior, Wishes(prior_error=0.5))

    def of(numbers: Array) -> Array:
        lower = np.zeros((tree.n, 4, 4))
        lower[:, *np.tril_indices(4)] = numbers.reshape(tree.n, 10)
        roots = np.linalg.cholesky(matrices(prior.standard))
        return parameters(roots @ lower @ np.swapaxes(lower, 1, 2) @ np.swapaxes(roots, 1, 2))

    start = np.tile(np.eye(4)[np.tril_indices(4)], tree.n)
    start = start + 0.2 * np.random.default_rng(seed).normal(size=len(start))
    best = minimize(
        lambda x: cost(of(x), loose, prior, 0.5, "log-det"), start, options={"gtol": 1e-7}
    )
    ours = cost(np.array(found.standard), loose, prior, 0.5, "log-det")
    assert ours <= best.fun + 1e-9 * abs(best.fun)
    assert ours == pytest.approx(best.fun, rel=1e-4, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("seed", range(4))
def test_no_possible_bodies_nearby_are_better(metric: Metric, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 3).tree()
    estimate, prior = estimates_of(tree, seed, 5.0)[0], prior_for(tree)
    found = consistent(tree, [estimate], prior, Wishes(metric=metric))
    here = cost(np.array(found.standard), estimate, prior, 0.5, metric)
    for size in (1e-4, 1e-2):
        for _ in range(50):
            change = np.eye(4) + size * rng.normal(size=(tree.n, 4, 4))
            bodies = change @ matrices(found.standard) @ np.swapaxes(change, 1, 2)
            there = cost(parameters(bodies), estimate, prior, 0.5, metric)
            assert there >= here - 1e-6 * abs(here)


@pytest.mark.parametrize("name", ROBOTS)
def test_perfect_data_and_the_true_bodies_give_the_true_bodies(name: str) -> None:
    tree = robot(name)
    estimates = [tb.identify(tree, ideal(tree), method, settings=EXACT) for method in METHODS]
    found = consistent(tree, estimates, prior_of(tree))
    own = robot_of(found, tree)
    for body, truth in zip(own.inertias, tree.inertias, strict=True):
        assert body.mass == pytest.approx(truth.mass, rel=1e-5)
        np.testing.assert_allclose(body.tensor, truth.tensor, atol=1e-4 * truth.tensor.max())
    for joint, true in zip(own.joints, tree.joints, strict=True):
        assert joint.coulomb == pytest.approx(true.coulomb, abs=1e-5)
        assert joint.viscous == pytest.approx(true.viscous, abs=1e-5)
    assert found.warnings == ()


@pytest.mark.slow
@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("seed", range(6))
def test_every_body_can_exist(metric: Metric, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 3 + 2 * seed).tree()
    found = consistent(tree, estimates_of(tree, seed), prior_for(tree), Wishes(metric=metric))
    assert found.unsettled < 1e-2
    assert (np.linalg.eigvalsh(matrices(found.standard)) > 0).all()
    assert (found.eigenvalues > 0).all()
    assert (found.margin > (1e-2 if metric == "log-det" else 1e-8)).all()
    assert (found.coefficients >= -1e-12).all()
    assert ((found.told >= 0) & (found.told <= 1)).all()


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_grams_and_tonnes_are_alike(scale: float) -> None:
    tree = robot("ur5")
    estimate, prior = estimates_of(tree)[0], prior_for(tree)
    scaled = replace(
        estimate,
        values=scale * estimate.values,
        sigma=scale * estimate.sigma,
        covariance=scale**2 * estimate.covariance,
    )
    heavy = replace(prior, standard=scale * prior.standard)
    one, other = consistent(tree, [estimate], prior), consistent(tree, [scaled], heavy)
    np.testing.assert_allclose(other.standard, scale * one.standard, rtol=1e-5, atol=1e-7 * scale)
    np.testing.assert_allclose(other.eigenvalues, one.eigenvalues, rtol=1e-4)
    np.testing.assert_allclose(other.told, one.told, atol=1e-5)


@pytest.mark.slow
def test_better_data_tell_more_of_every_parameter() -> None:
    tree = robot("gantry")
    estimate = estimates_of(tree)[0]
    loose = replace(estimate, covariance=100 * estimate.covariance, sigma=10 * estimate.sigma)
    true = prior_of(tree)
    precise, vague = (consistent(tree, [each], true) for each in (estimate, loose))
    assert (precise.told >= vague.told - 0.02).all()
    assert precise.told.mean() > vague.told.mean() + 0.05
    assert (precise.sigma <= 1.05 * vague.sigma + 1e-12).all()


@pytest.mark.slow
def test_what_no_force_shows_stays_the_model_files() -> None:
    """Of a first link that turns about an upright axis, joint torques tell one inertia."""
    tree, prior = robot("puma"), prior_of(robot("puma"))
    found = consistent(tree, [estimates_of(tree)[1]], prior)
    unseen = [0, 2, 3, 4, 6, 8]  # m my mz Ixx Iyy Iyz; its x-z moments are regrouped with link 2's
    assert found.told[0, unseen].max() < 0.4
    kept, given = found.standard[0, 0], prior.standard[0, 0]
    assert kept == pytest.approx(given, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_the_trees_own_bodies_are_not_looked_at(method: Method) -> None:
    tree = robot("puma")
    estimate = estimates_of(tree)[METHODS.index(method)]
    prior = prior_for(tree)
    false = wrong_bodies(tree, 0.9, np.random.default_rng(0)).without_friction()
    one, other = (consistent(each, [estimate], prior) for each in (tree, false))
    np.testing.assert_array_equal(one.standard, other.standard)
    np.testing.assert_array_equal(one.coefficients, other.coefficients)


@pytest.mark.parametrize("method", METHODS)
def test_known_zeros_stay_as_far_as_forces_tell_them(method: Method) -> None:
    tree = robot("puma")
    recording = measured(tree, 3, duration=10.0)
    settings = tb.Settings(zeros=True)
    estimate = tb.identify(tree, recording, method, settings=settings)
    found = consistent(tree, [estimate], prior_for(tree))
    told = evidence(tree, estimate, terms_of([estimate]))
    x = np.concatenate([found.standard.ravel(), found.coefficients])
    assert len(told.zero) > 3
    assert np.abs(told.zero @ x).max() < 1e-3
    whole = tb.minimal_set(tree, estimate.minimal.model)
    own = robot_of(found, tree)
    forces = tb.base_wrench if method == "external" else tb.joint_forces
    motion = tb.Motion(np.arange(20.0), *np.random.default_rng(0).normal(size=(3, 20, tree.n)))
    theta = estimate.minimal.lift @ found.bent[0].values[: estimate.minimal.count]
    lifted = whole.lift @ whole.matrix @ theta
    assert np.isfinite(lifted).all()
    by_zeros = tb.regressor(tree, motion, whole) @ (whole.matrix @ theta)
    np.testing.assert_allclose(
        forces(own, motion).ravel(), by_zeros.ravel(), atol=1e-3 * np.abs(by_zeros).max()
    )


def test_wishes_are_obeyed() -> None:
    tree, prior = robot("puma"), prior_for(robot("puma"))
    names = [joint.body for joint in tree.joints]
    total = float(sum(body.mass for body in tree.inertias))
    extent = np.tile([[-0.1, -0.5, -1.0], [0.1, 0.5, 1.0]], (3, 1, 1))
    wishes = Wishes(
        known={f"mass/{names[1]}": 4.5, "mass": [total, 1e-4]},
        symmetric={names[2]: "yz", names[0]: ["yz", "xz"]},
        centres_in_shapes=True,
    )
    boxed = replace(prior, extent=extent)
    found = consistent(tree, estimates_of(tree), boxed, wishes)
    assert found.standard[1, 0] == pytest.approx(4.5, rel=1e-9)
    assert found.sigma[1, 0] == found.told[1, 0] == 0
    assert found.standard[:, 0].sum() == pytest.approx(total, abs=1e-3)
    mx, ixy, ixz = 1, 5, 7
    np.testing.assert_allclose(found.standard[2, [mx, ixy, ixz]], 0, atol=1e-12)
    np.testing.assert_allclose(found.standard[0, [1, 2, 5, 7, 8]], 0, atol=1e-12)
    centres = found.standard[:, 1:4] / found.standard[:, :1]
    assert (centres >= extent[:, 0] - 1e-9).all()
    assert (centres <= extent[:, 1] + 1e-9).all()


def test_a_box_that_leaves_the_centre_out_binds() -> None:
    tree, prior = robot("puma"), prior_of(robot("puma"))
    least, greatest = np.tile([[-9.0], [9.0]], (1, 3))
    extent = np.tile([least, greatest], (3, 1, 1))
    extent[2, 1, 2] = 0.25  # of 0.303
    found = consistent(
        tree, estimates_of(tree), replace(prior, extent=extent), Wishes(centres_in_shapes=True)
    )
    assert found.standard[2, 3] / found.standard[2, 0] == pytest.approx(0.25, abs=1e-5)
    assert any("greatest z" in each for each in found.binding)


@pytest.mark.parametrize(
    ("said", "named"),
    [
        ({"known": {"mass/a": -1.0}}, "known.mass/a = -1 kg"),
        ({"known": {"mass": 3, "mass/a": 2, "mass/b": [2, 0.1]}}, "mass/a + mass/b make 4 kg"),
        ({"known": {"weight": 3}}, "known.weight"),
        ({"symmetric": {"a": "xx"}}, "'xx'"),
        ({"prior_error": 0.0}, "prior_error"),
        ({"metric": "euclid"}, "euclid"),
    ],
)
def test_impossible_wishes_are_named(said: dict[str, Any], named: str) -> None:
    with pytest.raises(tb.TestbedError, match=named.replace("+", r"\+").replace("/", "/")):
        Wishes(**said)


def test_wishes_that_no_bodies_obey_are_named() -> None:
    """All masses known, and a total that is another; a symmetric body and a box beside it."""
    tree, prior = robot("puma"), prior_of(robot("puma"))
    names = [joint.body for joint in tree.joints]
    estimate = estimates_of(tree)[0]
    masses = {f"mass/{name}": 1.0 for name in names}
    with pytest.raises(tb.TestbedError, match="mass = 9 kg") as said:
        consistent(tree, [estimate], prior, Wishes(known={**masses, "mass": 9.0}))
    assert all(f"mass/{name}" in str(said.value) for name in names)
    extent = np.array(prior.extent)
    extent[2] = [[0.1] * 3, [0.2] * 3]
    beside = replace(prior, extent=extent)
    wishes = Wishes(symmetric={names[2]: "yz"}, centres_in_shapes=True)
    with pytest.raises(tb.TestbedError, match="symmetric about yz") as said:
        consistent(tree, [estimate], beside, wishes)
    assert "least x of the mass centre" in str(said.value)
    with pytest.raises(tb.TestbedError, match="'nobody'"):
        consistent(tree, [estimate], prior, Wishes(known={"mass/nobody": 1.0}))


@pytest.mark.slow
def test_data_that_no_bodies_have_are_said() -> None:
    tree = robot("ur5")
    estimate = estimates_of(tree)[0]
    mirrored = replace(estimate, values=-estimate.values)
    found = consistent(tree, [mirrored], prior_of(tree))
    assert any("contradicts physics" in line for line in found.warnings)
    assert found.bent[0].distance > 100
    torques = estimates_of(robot("puma"))[1]
    backwards = replace(torques, values=np.where(
        [name.startswith("coulomb") for name in torques.names], -torques.values, torques.values
    ))  # fmt: skip
    rubbing = consistent(robot("puma"), [backwards], prior_of(robot("puma")))
    assert any("cannot be negative" in line for line in rubbing.warnings)
    assert (rubbing.coefficients >= 0).all()
    fine = consistent(tree, [estimate], prior_of(tree))
    assert fine.warnings == ()


def test_an_estimate_without_a_covariance_is_left_out() -> None:
    """With hardly more rows than unknowns, variances of combinations are below zero."""
    tree = robot("puma")
    plate, torques = estimates_of(tree)
    covariance = np.array(torques.covariance)
    first = covariance[:2, :2]
    first[0, 1] = first[1, 0] = 1.01 * np.sqrt(first[0, 0] * first[1, 1])
    hollow = replace(torques, covariance=covariance)
    found = consistent(tree, [plate, hollow], prior_of(tree))
    assert [each.method for each in found.bent] == ["external"]
    assert any("left out" in line for line in found.warnings)
    with pytest.raises(tb.TestbedError, match="longer or richer"):
        consistent(tree, [hollow], prior_of(tree))


@pytest.mark.slow
def test_torques_with_wrong_constants_do_not_spoil_what_the_plate_tells() -> None:
    tree = robot("puma")
    recording = measured(tree, 4, duration=20.0)
    torque = recording.measured("torque") * np.array([1.08, 0.94, 1.04])
    wrong = replace(recording, torque=torque)
    estimates = [tb.identify(tree, wrong, method) for method in METHODS]
    prior = prior_for(tree)
    both, alone = (consistent(tree, used, prior) for used in (estimates, estimates[:1]))
    assert both.bent[1].widened > 3
    assert any("contradicts the internal" in line for line in both.warnings)
    gap = (both.bent[0].values - alone.bent[0].values) / estimates[0].sigma
    assert np.abs(gap).max() < 2


@pytest.mark.slow
def test_held_out_data_choose_how_far_a_model_file_is_trusted() -> None:
    tree = robot("ur5")
    source = open_source(measured(tree, 5, duration=8.0))

    def identified(part: Source, method: Method) -> Estimate:
        return tb.identify(tree, part, method)

    estimates = [identified(source, "external")]
    chosen = {}
    for error in (0.0, 1.5):
        prior = prior_for(tree, 3, error)
        wishes = Wishes(prior_error="chosen")
        found = consistent_by_held_out(tree, estimates, prior, wishes, source, identified)
        assert min(found.tried, key=lambda e: found.tried[e]) == found.prior_error
        chosen[error] = found.prior_error
        (said,) = [line for line in consistent_lines(found) if line.startswith("Held-out data")]
        assert all(f"{each:g}: " in said for each in found.tried)
        assert not any("Held-out" in line for line in consistent_lines(replace(found, tried={})))
    assert chosen[0.0] <= 0.2 < chosen[1.5]
    short = Stretch(source, 0, 150)
    with pytest.raises(tb.TestbedError, match="give a number"):
        consistent_by_held_out(tree, estimates, prior, wishes, short, identified)


@pytest.mark.slow
def test_bodies_of_a_robot_with_held_fingers() -> None:
    lock = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
    tree = tb.load_tree(REAL / "panda_description/urdf/panda.urdf", lock=lock)
    found = consistent(tree, estimates_of(tree, 2, 20.0), prior_for(tree))
    assert (found.eigenvalues > 0).all()
    truth = sum(body.mass for body in tree.inertias)
    assert found.standard[:, 0].sum() == pytest.approx(truth, rel=0.01)


@pytest.mark.slow
def test_what_consistent_bodies_say_can_be_validated() -> None:
    tree = robot("puma")
    estimates = estimates_of(tree)
    found = consistent(tree, estimates, prior_for(tree))
    unseen = measured(tree, 11, duration=10.0)
    for estimate in estimates:
        seen = tb.validate(tree, unseen, stated_by(found, estimate))
        assert (seen.ratio < 1.5).all()


def test_a_prior_is_of_bodies_that_can_be() -> None:
    tree = robot("puma")
    flat = Inertia.about_centre(2.0, [0.1, 0, 0], np.diag([0.1, 0.2, 0.4]))  # 0.4 > 0.1 + 0.2
    point = Inertia.about_centre(1.0, [0.0, 0, 0.3], np.zeros((3, 3)))
    broken = replace(tree, inertias=(flat, point, NOTHING))
    prior = prior_of(broken)
    assert prior.massive == (0, 1)
    assert (np.linalg.eigvalsh(matrices(prior.standard[:2])) > 0).all()
    np.testing.assert_allclose(prior.standard[0, :4], [2.0, 0.2, 0, 0], atol=1e-12)
    assert len(prior.warnings) == 2
    nothing = prior_of(tree.without_inertias())
    assert nothing.massive == (0, 1, 2)
    assert any("no body a mass" in line for line in nothing.warnings)
    fine = prior_of(tree)
    np.testing.assert_allclose(fine.standard, tb.standard(tree), atol=1e-12)


@pytest.mark.slow
def test_links_without_matter_get_none() -> None:
    tree = robot("random")
    bodies = (*tree.inertias[:1], NOTHING, *tree.inertias[2:])
    bare = replace(tree, inertias=bodies)
    found = consistent(bare, estimates_of(bare), prior_of(bare))
    np.testing.assert_array_equal(found.standard[1], 0.0)
    assert any("has no matter" in line for line in found.warnings)


def test_conditions_count_friction_and_rotors() -> None:
    tree = robot("ur5")
    recording = measured(tree, 1, duration=10.0)
    settings = tb.Settings(terms=("coulomb", "viscous", "offset", "rotor"))
    estimate = tb.identify(tree, recording, "internal", settings=settings)
    asked = conditions(tree, prior_of(tree), Wishes(), terms_of([estimate]))
    assert len(asked.bounds.names) == 3 * tree.n
    found = consistent(tree, [estimate], prior_of(tree))
    kinds = [term.law.kind for term in found.terms]
    rotors = found.coefficients[[kind == "rotor" for kind in kinds]]
    assert (rotors >= 0).all()
    assert len(rotors) == tree.n
    assert any("no place for offset/" in line for line in found.warnings)


@pytest.mark.slow
def test_rotors_that_would_count_twice_are_said() -> None:
    tree = robot("puma").with_joints({"elbow": {"rotor_inertia": 0.5}})
    estimates = estimates_of(tree)
    assert any(
        "count twice" in line for line in consistent(tree, estimates, prior_of(tree)).warnings
    )
    settings = tb.Settings(terms=("coulomb", "viscous", "rotor"))
    told = tb.identify(tree, measured(tree, 1, duration=10.0), "internal", settings=settings)
    found = consistent(tree, [estimates[0], told], prior_of(tree))
    assert found.warnings == ()
    rotors = {
        t.joint: v for t, v in zip(found.terms, found.coefficients, strict=True) if t.law == ROTOR
    }
    assert rotors[2] == pytest.approx(0.5, rel=0.1)


def test_pseudo_inertias_there_and_back() -> None:
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(5, 4, 4))
    bodies = roots @ np.swapaxes(roots, 1, 2)
    np.testing.assert_allclose(matrices(parameters(bodies)), bodies, atol=1e-13)
    np.testing.assert_allclose(of_coordinates(coordinates(bodies)), bodies, atol=1e-13)
    size = (coordinates(bodies) ** 2).sum(axis=1)
    np.testing.assert_allclose(size, (bodies**2).sum(axis=(1, 2)))
    ones = np.einsum("nij,j->ni", standard_of_coordinates(roots), coordinates(np.eye(4)))
    np.testing.assert_allclose(ones, parameters(bodies), atol=1e-13)
    for body in bodies:
        inertia = Inertia.of_pseudo(body)
        np.testing.assert_allclose(inertia.pseudo, body, atol=1e-13)


@pytest.mark.slow
def test_the_same_bits_again() -> None:
    tree = robot("puma")
    estimates, prior = estimates_of(tree), prior_for(tree)
    one, other = (consistent(tree, estimates, prior) for _ in range(2))
    assert isinstance(one, Consistent)
    np.testing.assert_array_equal(one.standard, other.standard)
    np.testing.assert_array_equal(one.told, other.told)


def test_what_is_widened_by_more_than_three_sigmas_is_said() -> None:
    tree = robot("puma")
    estimate = tb.identify(tree, ideal(tree), "internal")
    for widened, sure in ((2.9, False), (3.1, True)):
        names = estimate.names
        moved = SimpleNamespace(
            distance=0.0, names=names, widened=widened, sigmas=np.zeros(len(names))
        )
        said = [line for line in warnings_of([estimate], [moved], 0.0) if "widened" in line]
        assert bool(said) is sure
    sigmas = np.arange(len(names), dtype=float)
    far = SimpleNamespace(distance=1e3, names=names, widened=1.0, sigmas=-sigmas)
    (told,) = [line for line in warnings_of([estimate], [far], 0.0) if "moved most" in line]
    assert f"moved most are {names[-1]} by {-sigmas[-1]:+.3g} sigma, {names[-2]} by" in told
