"""What data add to a model file: nothing where they say nothing, all where they say all.

If one fails, a file's numbers pass for measured ones, or measured ones for the file's.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import testbed as tb
from benchmarks.sampling import factors, prior_robots
from testbed.applications.analysis import analyse
from testbed.bodies.consistency.consistent import consistent, robot_of
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.robots import (
    BODY_PARAMETER_COUNT,
    _log_prior,
    elliptical_slice_samples,
)
from testbed.bodies.estimate_summary import estimate_of_summary
from testbed.bodies.linear_prior import LinearPrior, determined_by_data, fit_with_prior
from testbed.bodies.posterior import (
    WELL_CONDITIONED,
    Posterior,
    compute_posterior,
    corrected_row_parts,
)
from testbed.bodies.prediction_errors import PredictionErrors, errors_on_recording
from testbed.bodies.prior import PriorBodies, prior_of
from testbed.bodies.row_products import MIN_EXCESS_ROWS, RowProducts, row_parts
from testbed.bodies.verdict import WELL_CODE, verdict_of
from testbed.core.base.arrays import Array
from testbed.core.base.codec import from_json_values, to_json_values
from testbed.core.base.errors import SettingsError
from testbed.core.estimation.diagnostics.rigid_bodies import rigid_body_test
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.windows import DENSE_ROWS_PER_CUTOFF
from testbed.core.parameters.pseudo_inertia import (
    parameters,
    pseudo_inertia_coordinates,
    pseudo_inertias,
)
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.parameters.symbols import barycentric_from_standard
from testbed.core.recordings.metadata import Metadata
from testbed.core.robot.drive_torque import drive_torque
from testbed.core.robot.rigid_matter import inertia_flaw
from testbed.lab.experiment.evaluate import perturbed_robot
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.measured import measured, random_fourier
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot
from tests.helpers.strategies import Rng, few, rngs


def products(columns: Array, measured: Array, offset: bool = False) -> RowProducts:
    """Of rows, (C, k, p) and (C, k)."""
    ones = np.ones((*measured.shape, 1))
    every = np.concatenate([columns, ones, measured[..., None]], axis=2)
    names = tuple(f"x{k}" for k in range(columns.shape[2]))
    channels = tuple(f"c{k}" for k in range(len(measured)))
    return RowProducts(names, channels, every.swapaxes(1, 2) @ every, offset)


def prior_like(rng: Rng, p: int, noise: float, width: float = 1.0) -> LinearPrior:
    root = width * np.hstack([np.eye(p), 0.3 * rng.normal(size=(p, 2))])
    return LinearPrior(
        rng.normal(size=p), root, p, np.array([noise**2]), np.full(root.shape[1], -np.inf)
    )


@given(rngs)
def test_data_that_say_nothing_leave_the_file(rng: Rng) -> None:
    """Columns that do not move beside an unknown zero say as little as none."""
    prior = prior_like(rng, 3, 1e-3)
    still = np.broadcast_to(rng.normal(size=3), (1, 40, 3))
    for columns, offset in ((np.zeros((1, 40, 3)), False), (still, True)):
        y = rng.normal(size=(1, 40))
        values, covariance = fit_with_prior(products(columns, y, offset), prior)
        np.testing.assert_allclose(values, prior.mean, atol=1e-9)
        np.testing.assert_allclose(covariance, prior.root @ prior.root.T, atol=1e-9)


def test_the_variance_is_that_of_many_robots() -> None:
    """Robots drawn from the prior: errors are as large as is said.

    Noise and columns as the filter on rows leaves them: two rows say as much as one.
    """
    memory = 1 / 3
    rng = np.random.default_rng(7)
    prior, scale = prior_like(rng, 4, 1e-6), np.array([1, 0.3, 0.05, 0.01])
    z = []
    for _ in range(200):
        truth = prior.mean + prior.root @ rng.normal(size=6)
        columns, noise = rng.normal(size=(1, 300, 4)) * scale, rng.normal(size=300)
        for k in range(1, 300):
            noise[k] = memory * noise[k - 1] + np.sqrt(1 - memory**2) * noise[k]
            columns[0, k] += memory * (columns[0, k - 1] - columns[0, k])
        values, covariance = fit_with_prior(products(columns, columns @ truth + noise), prior)
        z.append(np.linalg.solve(np.linalg.cholesky(covariance), values - truth))
    size = np.sqrt(np.mean(np.square(z), axis=0))
    assert ((size > 0.75) & (size < 1.15)).all(), size


@given(rngs)
def test_what_a_prior_carries_to_another_parameter_is_not_the_datas(rng: Rng) -> None:
    """Two that the prior nearly holds together, one of which the data see."""
    columns = rng.normal(size=(1, 300, 1)) * [1.0, 1e-4]
    rows = products(columns, columns[..., 0] + 0.1 * rng.normal(size=(1, 300)))
    root = np.array([[1.0, 0.0], [0.999, 0.04]])
    prior = LinearPrior(np.zeros(2), root, 2, np.array([1e-6]), np.full(2, -np.inf))
    _, covariance = fit_with_prior(rows, prior)
    assert (np.diagonal(covariance) < 0.1 * prior.variance).all()
    assert determined_by_data(rows, prior).tolist() == [True, False]


@given(rngs, st.booleans())
def test_a_prior_without_end_is_least_squares_in_which_friction_never_drives(
    rng: Rng, offset: bool
) -> None:
    """Else slow motion foretells fast motion by negative viscous friction; beside a zero, too."""
    columns, truth = rng.normal(size=(1, 300, 4)), rng.normal(size=4)
    measured = columns @ truth + 0.1 * rng.normal(size=(1, 300)) + 5.0 * offset
    least = np.array([-np.inf, -np.inf, 0.0, 0.0])
    prior = LinearPrior(np.zeros(4), 1e3 * np.eye(4), 2, np.array([1e-6]), least)
    values, covariance = fit_with_prior(products(columns, measured, offset), prior)
    x, y = (each[0] - offset * each[0].mean(axis=0) for each in (columns, measured))
    slope = x.T @ (x @ values - y)  # of the squares: Karush, Kuhn and Tucker
    assert (values[2:] >= 0).all()
    assert (slope > -1e-2).all()
    np.testing.assert_allclose(slope[values > 0], 0, atol=1e-2)
    np.testing.assert_allclose(slope[:2], 0, atol=1e-2)
    assert (np.diagonal(covariance) < 1e-3 * prior.variance).all()


@given(rngs, st.sampled_from(["wrench", "torque"]))
@few(4)
def test_products_are_those_of_the_rows(rng: Rng, method: Signal) -> None:
    """Whatever the blocks: residuals of any values."""
    tree = random_robot(rng, 2).tree()
    recording = ideal(tree, duration=20.0, seed=int(rng.integers(99)))
    problem = Problem.from_recording(tree, recording, method, tb.Settings(cutoff=3.0))
    whole = row_parts(problem, problem.source, method == "wrench").total
    made = list(
        problem.passes(1, per_cutoff=DENSE_ROWS_PER_CUTOFF).rows(np.eye(len(problem.names)))
    )
    columns, y = (np.concatenate([each[k] for each in made], axis=1) for k in range(2))
    values, there = rng.normal(size=len(problem.names)), columns.any(axis=2)
    left = y - columns @ values
    if method == "wrench":
        left = left - there * (left.sum(axis=1) / np.maximum(there.sum(axis=1), 1))[:, None]
    square = (left**2).sum(axis=1)
    np.testing.assert_allclose(
        whole.residual_squares(values, whole.mean_residuals(values)), square, 1e-7, 1e-12
    )


def with_file(
    tree: tb.Tree,
    recording: tb.Recording,
    method: Signal = "torque",
    estimate: tb.Estimate | None = None,
    error: float | None = None,
) -> Posterior:
    """By a recording with the tree's bodies as prior."""
    settings = tb.Settings() if estimate is None else estimate.settings
    rows = corrected_row_parts(Problem.from_recording(tree, recording, method, settings), estimate)
    return compute_posterior(rows, tb.prior_of(tree), estimate, prior_error=error)


def wrong_puma(error: float = 0.3) -> tb.Tree:
    return perturbed_robot(robot("puma"), error, np.random.default_rng(3))


@cache
def added(
    speed: float, method: Signal, error: float | None = None
) -> tuple[tb.Estimate, Posterior]:
    """To a wrong file of the PUMA, by twenty seconds of it."""
    wrong, recording = wrong_puma(), measured(robot("puma"), 5, speed=speed)
    estimate = tb.identify(wrong, recording, method)
    return estimate, with_file(wrong, recording, method, estimate, error)


def by_name(found: Posterior) -> dict[str, tuple[float, float]]:
    """Values and their sigmas."""
    return dict(zip(found.names, zip(found.values, found.sigma, strict=True), strict=True))


def test_where_the_data_determine_all_nothing_moves() -> None:
    estimate, found = added(1.0, "wrench")
    assert not found.used
    assert found.determined == estimate.names
    np.testing.assert_array_equal(found.values, estimate.values)
    np.testing.assert_array_equal(found.covariance, estimate.covariance)


def test_a_file_that_says_nothing_leaves_least_squares_with_their_noise() -> None:
    """Well-conditioned torques: values and covariance of correlated noise, friction positive."""
    estimate, found = added(1.0, "torque", error=30.0)
    assert found.used
    assert estimate.condition < WELL_CONDITIONED
    assert (np.abs(found.values - estimate.values) < 0.01 * estimate.sigma).all()
    np.testing.assert_allclose(found.sigma, estimate.sigma, rtol=1e-2)


@pytest.mark.slow
def test_where_they_do_not_the_file_is_not_made_worse() -> None:
    """Slow motion, torques: nearer to the truth than least squares, and fast motion, too."""
    estimate, found = added(0.1, "torque")
    truth = estimate.minimal.values(tb.barycentric(robot("puma")))
    errors = [np.abs(each[: found.count] - truth) for each in (found.values, estimate.values)]
    assert np.median(errors[0] / errors[1]) < 0.2
    assert len(found.determined) < found.count
    assert ((found.share >= 0) & (found.share <= 1)).all()
    assert 0.15 < found.prior_error < 0.6
    assert not found.worse_channels("posterior")
    problem = Problem.from_recording(
        robot("puma"), measured(robot("puma"), 6), "torque", estimate.settings
    )
    models = found.models | {"plain": estimate.values}
    fast = errors_on_recording(problem, problem.source, models)
    assert {d.code for d in fast.worse_channels("plain")} == {"estimate.worse-than-file"}
    assert not [*fast.worse_channels("posterior")]
    again = from_json_values(Posterior, to_json_values(found), {})
    np.testing.assert_array_equal(again.values, found.values)
    assert again.errors[0].best_method == found.errors[0].best_method


def test_what_is_known_is_known_with_the_file_too() -> None:
    """Slow motion: a total mass exactly, a first moment by its sigma, whatever the file says."""
    slow = measured(robot("puma"), 5, speed=0.1)
    settings = tb.Settings(known={"mass": 21.0, "mb*1y": (1.44, 1e-3)})
    estimate = tb.identify(wrong_puma(), slow, settings=settings)
    found = with_file(wrong_puma(), slow, "wrench", estimate)
    value = by_name(found)
    np.testing.assert_allclose(value["mbar1"], (21.0, 0.0), atol=1e-5)
    assert abs(value["mb*1y"][0] - 1.44) < 3e-3
    assert 0 < value["mb*1y"][1] <= 1e-3
    prior = dict(zip(found.names, found.prior_sigma, strict=True))
    np.testing.assert_allclose((prior["mbar1"], prior["mb*1y"]), (0, 1e-3), rtol=1e-3, atol=1e-9)


def test_the_true_file_leaves_noise_of_another_recording() -> None:
    """And the wrong one more; a plate's zero is the recording's own."""
    tree = robot("puma")
    _, found = added(1.0, "wrench", error=0.5)
    moved = plus(measured(tree, 6), wrench=[9.0, 0, 0, 0, 0, 2.0])
    problem = Problem.from_recording(tree, moved, "wrench")
    truth = problem.minimal.values(tb.barycentric(tree))
    errors = errors_on_recording(problem, problem.source, {**found.models, "truth": truth})
    assert (errors.residual["truth"] < 0.12).all()
    assert (errors.residual["refitted"] > errors.residual["truth"]).all()
    assert errors.residual["file"][0] > 8
    assert list(errors.worse_channels("posterior")) == []


def with_last_joint(tree: tb.Tree, speed: float, seed: int) -> tb.Recording:
    """Torques of the UR5 whose last joint is at most so fast [rad/s]."""
    rng = np.random.default_rng(seed)
    motion, size = random_fourier(tree, rng, 1.0), np.ones((tree.n, 1))
    size[-1] = speed / np.abs(motion.at(np.arange(0, 20, 0.01)).qd[:, -1]).max()
    slower = replace(motion, sine=size * motion.sine, cosine=size * motion.cosine)
    states = slower.at(np.arange(0, 20, 1 / 200))
    torque = tb.joint_forces(tree, states) + drive_torque(tree, states.qd, states.qdd)
    noise = rng.normal(size=(2, *states.q.shape))
    return tb.Recording(tree.names, states.t, states.q + 1e-4 * noise[0], torque + 0.1 * noise[1])


@pytest.mark.parametrize("speed", [0.033, 0.035, 0.04, 0.05])
def test_a_joint_of_which_few_rows_count_determines_nothing(speed: float) -> None:
    """Its friction alone would explain them: what only it shows is the file's."""
    tree = robot("ur5")
    friction = {name: 1.03 + 0.11 * k for k, name in enumerate(tree.names)}
    tree = tree.with_joints({k: {"coulomb": f, "viscous": f} for k, f in friction.items()})
    wrong = perturbed_robot(tree, 0.2, np.random.default_rng(0))
    truth = tb.minimal_set(tree, "torque").values(tb.barycentric(tree))
    for seed in range(3):
        found = with_file(wrong, with_last_joint(tree, speed, seed))
        (held_out,) = (each for each in found.errors if each.of == "like")
        own = [k for k, name in enumerate(found.names) if name.endswith(tree.names[-1])]
        few_rows = bool(held_out.rows[-1] < len(own) + MIN_EXCESS_ROWS)
        doubts = {each.code for each in verdict_of([], [found])}
        assert ("verdict.few-rows" in doubts) == few_rows
        assert found.prior_error < 1
        if few_rows:
            np.testing.assert_allclose(found.share[own], 0, atol=1e-9)
            np.testing.assert_allclose(found.values[own], found.file[own], rtol=1e-9)
            assert np.isnan([each[-1] for each in held_out.residual.values()]).all()
            assert len(found.determined) < found.count
        z = (found.values[: found.count] - truth) / found.sigma[: found.count]
        assert np.sqrt(np.mean(z**2)) < 1.6


def test_friction_is_the_datas_whatever_the_file_says() -> None:
    """A placeholder of 10 N m s/rad at a joint of a tenth of a newton metre."""
    tree = robot("ur5").with_joints({name: {"viscous": 0.1} for name in robot("ur5").names})
    said = tree.with_joints({name: {"viscous": 10.0, "coulomb": 1.0} for name in tree.names})
    value = by_name(with_file(said, measured(tree, 5, noise=0.1)))
    for name in tree.names:
        number, sigma = value[f"viscous/{name}"]
        assert abs(number - 0.1) < 4 * sigma + 1e-3


sizes = st.floats(0.01, 20)


@given(sizes, sizes, sizes, st.floats(0.01, 12), st.booleans())
def test_a_verdict_is_well_only_where_held_out_parts_bear_it_out(
    refitted: float, plain: float, own: float, error: float, default: bool
) -> None:
    """Witness: the four numbers compared one by one; `--plain` is held by its own.

    Of one joint whose torque is 10 N m; differences are no chance.
    """
    left = {"file": 9.0, "refitted": refitted, "plain": plain, "posterior": own}
    sure = {each: dict.fromkeys(left, np.zeros(1)) for each in ("refitted", "plain")}
    signal, rows = np.array([10.0]), np.array([100.0])
    residual = {name: np.array([size]) for name, size in left.items()}
    errors = PredictionErrors("torque", "like", ("a",), ("N m",), rows, signal, residual, sure)
    _, made = added(1.0, "torque", error=0.5)
    found = replace(made, used=True, prior_error=error, errors=(errors,))
    model = "posterior" if default else "plain"
    wanted = {
        "estimate.worse-than-plain": default and own > max(1.2 * plain, np.hypot(plain, 0.05)),
        "estimate.worse-than-file": left[model] > max(1.05 * refitted, np.hypot(refitted, 0.05)),
        "verdict.residual": left[model] > 2.0,
        "verdict.file": default and error > 1,
    }
    said = verdict_of([], [found], model)
    codes = [each.code for each in said]
    assert codes == [WELL_CODE] or set(codes) == {code for code, holds in wanted.items() if holds}
    assert (codes == [WELL_CODE]) == (not any(wanted.values()))
    levels = [each.level for each in said]
    assert levels == sorted(levels)  # errors before warnings


def verdict_on(recording: tb.Recording) -> list[tb.Diagnostic]:
    """With a file of the PUMA that is 15 % off."""
    wrong = wrong_puma(0.15)
    estimate = tb.identify(wrong, recording, "torque")
    return [*verdict_of([estimate], [with_file(wrong, recording, estimate=estimate)])]


def test_clean_data_are_well_and_data_of_another_scale_are_not() -> None:
    """A driver that multiplies the torques of some joints: the file as prior contradicts them."""
    clean = measured(robot("puma"), 5, speed=0.3, noise=0.1)
    scaled = replace(clean, torque=clean.measured("torque") * [1.5, 1.0, 1.0])
    well, other = ({each.code for each in verdict_on(data)} for data in (clean, scaled))
    assert well == {WELL_CODE}
    assert other == {"verdict.file", "model-error.corrected"}


@pytest.mark.parametrize(("push", "noise"), [(0.0, 1.0), (0.0, 4.0), (25.0, 1.0)])
def test_a_push_is_named_with_its_joint_and_its_time(push: float, noise: float) -> None:
    """Two of twenty seconds; neither clean data nor noise of larger size is an episode."""
    clean = measured(robot("puma"), 6, speed=0.5, noise=noise)
    during = (clean.time > 11.0) & (clean.time < 13.0)
    pushed = plus(clean, torque=push * np.outer(during, [0.0, 1.0, 0.0]))
    said = [each for each in verdict_on(pushed) if each.code == "verdict.episode"]
    assert bool(said) == bool(push)
    if push:
        times = [float(each) for each in re.findall(r"[0-9.]+", said[0].text)]
        assert clean.names[1] in said[0].subject
        assert any(abs(time - 10.0) < 0.1 for time in times)


def test_a_simulated_recording_has_no_prior() -> None:
    """Its model file is the truth."""
    tree = robot("puma")
    recording = measured(tree, 5, duration=5.0)
    real = replace(recording, metadata=Metadata(mapping={}))
    made = [analyse(tree, each, methods=["wrench"]).posterior for each in (recording, real)]
    assert [set(each) for each in made] == [set(), {"wrench"}]


def prior_for(tree: tb.Tree, seed: int = 7, error: float = 0.3) -> PriorBodies:
    """A model file that is wrong by so much."""
    return prior_of(perturbed_robot(tree, error, np.random.default_rng(seed)))


@cache
def estimate_of(name: str, method: Signal = "wrench") -> Estimate:
    """From ten seconds with the usual noise."""
    return tb.identify(robot(name), measured(robot(name), 1, duration=10.0), method)


def cost(found: Array, estimate: Estimate, prior: PriorBodies, error: float) -> float:
    """What is to be least, by its definition, for estimates without terms of joints."""
    gap = estimate.minimal.standard_matrix @ found.ravel() - estimate.values
    fit, away = gap @ np.linalg.solve(estimate.covariance, gap) / 2, 0.0
    for own, other in zip(pseudo_inertias(found), pseudo_inertias(prior.standard), strict=True):
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
                bodies = change @ pseudo_inertias(found.standard) @ np.swapaxes(change, 1, 2)
                there = cost(parameters(bodies), estimate, prior, 0.5)
                assert there >= here - 1e-6 * abs(here)
        assert found.unsettled < 1e-2
        assert (np.linalg.eigvalsh(pseudo_inertias(found.standard)) > 0).all()
        assert (found.eigenvalues[:, 0] > 0).all()
        assert ((found.data_share >= 0) & (found.data_share <= 1)).all()


def test_perfect_data_and_the_true_bodies_give_the_true_bodies() -> None:
    """Friction and rotors, too; the tree's own bodies are not looked at, but the prior's."""
    tree = robot("puma").with_joints({"elbow": {"rotor_inertia": 0.5}})
    settings = replace(EXACT, terms=("coulomb", "viscous", "rotor"))
    estimates = [tb.identify(tree, ideal(tree), method, settings=settings) for method in SIGNALS]
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
    false = perturbed_robot(tree, 0.9, np.random.default_rng(0)).without_friction()
    other = consistent(false, estimates, prior_of(tree))
    np.testing.assert_array_equal(other.standard, found.standard)
    np.testing.assert_array_equal(other.coefficients, found.coefficients)


@pytest.mark.slow
def test_known_masses_are_obeyed() -> None:
    """Exactly, or to their sigma; one that the file has not, and of all bodies together."""
    tree, prior = robot("puma"), prior_for(robot("puma"))
    estimates = [estimate_of("puma", method) for method in SIGNALS]
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
    plate, torques = (estimate_of("puma", method) for method in SIGNALS)
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
    assert [each.method for each in without.bent] == ["wrench"]
    with refuses(tb.TestbedError):
        consistent(tree, [hollow], prior)


def having(estimate: Estimate, values: Array, relative: float) -> Estimate:
    """The estimate with other minimal parameters, of a relative sigma."""
    base, count = estimate.base, len(values)
    largest = {u: np.abs(values[[u == v for v in base.units]]).max() for u in set(base.units)}
    sigma = relative * np.array([max(largest[unit], 1e-3) for unit in base.units])
    whole, covariance = np.array(estimate.values), np.array(estimate.covariance)
    whole[:count], covariance[:count, :count] = values, np.diag(sigma**2)
    return replace(estimate, values=whole, covariance=covariance)


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
    return np.asarray(barycentric_from_standard(tree, np.array(found))).ravel()


@pytest.mark.slow
@few(8)
@given(rngs, st.integers(2, 6), st.sampled_from(SIGNALS))
def test_robots_are_possible_and_mirrored_ones_not(rng: Rng, joints: int, method: Signal) -> None:
    """Point masses lie on the cone's edge, noise moves them beyond it; the nearest is possible."""
    tree = random_robot(rng, joints).tree()
    settings = replace(EXACT, terms=("coulomb", "rotor"))
    estimate = tb.identify(tree, ideal(tree), method, settings=settings)
    maps = estimate.minimal.matrix
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
    estimate = tb.identify(tree, ideal(tree), "torque", settings=settings)
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

    found = elliptical_slice_samples(density, rng.uniform(0.6, 2, (2000, 2)), 40, rng)
    exact = rng.multivariate_normal(np.zeros(2), correlated, 20_000)
    exact = exact[(exact > 0.5).all(axis=1)]
    for along in ([1, 0], [0, 1], [1, 1], [1, -1]):
        assert stats.ks_2samp(found @ along, exact @ along).pvalue > UNIFORM


def test_the_density_of_bodies_is_that_of_their_coordinates() -> None:
    """By the determinant of the derivatives, taken as differences."""
    rng, error = np.random.default_rng(5), 0.4

    def of(logs: Array) -> Array:
        root = factors(logs)
        return pseudo_inertia_coordinates(root @ np.swapaxes(root, -1, -2))

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
    estimate = tb.identify(file, measured(truth, 2, duration=10.0), "torque")
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
    assert found.share[:, BODY_PARAMETER_COUNT].min() > 0.9
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
    again = estimate_of_summary(file, estimate)
    one, other = (
        tb.robots(file, [each], prior, 5, np.random.default_rng(4), weighed)
        for each in (estimate, again)
    )
    np.testing.assert_allclose(one.values[:, 2, 0], 6.0, rtol=1e-9)
    np.testing.assert_array_equal(one.values, other.values)
    with refuses(SettingsError, "other parameters"):
        estimate_of_summary(file, replace(estimate, names=estimate.names[::-1]))
