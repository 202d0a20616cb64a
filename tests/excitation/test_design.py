"""Designed motions tell more than random ones, respect all limits, and are the same again."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize

import testbed as tb
from testbed.errors import InfeasibleMotion
from testbed.excitation.barrier_search import minimise
from testbed.excitation.clearance import watched
from testbed.excitation.collision_model import collision_model
from testbed.excitation.criteria import CRITERIA
from testbed.excitation.design import Wish, _problem, _start, criterion, design
from testbed.excitation.fourier import Fourier
from testbed.excitation.information import Instrument, information_of, relative_scale
from testbed.excitation.limit_terms import EffortTerm, PlateRange, PlateTerm, SmoothTerm
from testbed.excitation.limits import limits_of, motor_efforts
from testbed.excitation.prediction import Pipeline, moving, predict
from testbed.excitation.proof import Proof, Rules, prove
from testbed.excitation.random_motion import random_motion
from testbed.excitation.sampled_rows import SampledRows
from testbed.parameters.rules import Model
from testbed.robot.visuals.appearance import load_appearance
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.runs import robot

PLATE = np.repeat([0.5, 0.1], 3)
ALL = Pipeline(rate=1.0, span=1.0, band=np.inf, resting=0.0, reach=0.0)


@cache
def rows_of(name: str) -> dict[Model, SampledRows]:
    tree = robot(name)
    models: tuple[Model, ...] = ("reaction", "dynamic")
    return {model: SampledRows(tree, tb.minimal_set(tree, model)) for model in models}


def wish(
    name: str,
    instrument: Instrument = "plate",
    *,
    clear: bool = False,
    starts: int = 2,
    seed: int = 0,
) -> Wish:
    tree = robot(name)
    limits = limits_of(tree)
    plate = PlateRange(np.array([1e3, 1e3, 3e3, 1e3, 1e3, 1e3]))
    terms: list[SmoothTerm] = [PlateTerm(plate, tb.pedestal_wrench(tree), 0.95)]
    if np.isfinite(limits.effort).any():
        terms.append(EffortTerm(tree, limits, 0.95))
    collision, clearance = None, np.zeros(0)
    if clear:
        every = collision_model(tree, load_appearance(tree).shapes)
        seen = watched(every, limits, 0.02, np.random.default_rng(0))
        collision, clearance = seen.collision, seen.clearance
    rules = Rules(tree, limits, 0.95, tuple(terms), collision, clearance)
    noise = np.full(tree.n, 0.5)
    information = information_of(tree, rows_of(name), instrument, PLATE, noise)
    return Wish(rules, information, rows_of(name), ((0.2, 4),), starts, np.inf, seed)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry", "random"])
def test_a_design_tells_more_than_random_motions_and_is_proven(name: str) -> None:
    asked = wish(name, starts=1)
    found = design(asked)
    assert found.complete
    assert found.proof.holds
    rng = np.random.default_rng(5)
    tree, limits = asked.rules.tree, asked.rules.limits
    drawn = [random_motion(tree, limits, 0.2, 4, rng) for _ in range(10)]
    others = [criterion(asked, motion) for motion in drawn]
    assert found.value < min(others) - np.log(1.3**2)
    fine = found.motion.at(np.linspace(0, found.motion.period, 20_001))
    assert (np.abs(fine.qd) <= 0.95 * limits.velocity).all()
    assert (np.abs(fine.qdd) <= 0.95 * limits.acceleration).all()
    assert (fine.q >= limits.low).all()
    assert (fine.q <= limits.high).all()
    assert (np.abs(motor_efforts(tree, fine)) <= 0.95 * limits.effort + 1e-9).all()


@pytest.mark.slow
def test_a_proof_that_fails_between_samples_is_had_by_a_finer_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A search that looks too rarely, under a plate's ranges that bind."""
    monkeypatch.setattr("testbed.excitation.design.INSTANTS", 20)
    monkeypatch.setattr("testbed.excitation.design.DENSITY", 4)
    asked = wish("gantry", starts=1, seed=2)
    tight = PlateRange(np.array([150.0, 150, 300, 100, 100, 30]))
    plate = PlateTerm(tight, tb.pedestal_wrench(asked.rules.tree), 0.95)
    rules = replace(asked.rules, terms=(plate, *asked.rules.terms[1:]))
    asked = replace(asked, rules=rules)
    only_smaller = design(asked)
    assert only_smaller.value > only_smaller.searches[0].end + 0.01  # it had to swing less
    monkeypatch.setattr("testbed.excitation.design.SMALLER", (1.0,))
    refined = design(asked)
    assert refined.proof.holds
    assert refined.value < only_smaller.value


@pytest.mark.slow
def test_searches_are_the_same_again_and_seeds_differ() -> None:
    first, again, other = (design(wish("puma", seed=seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.motion.sine, again.motion.sine)
    assert first.searches == again.searches
    assert np.abs(first.motion.sine - other.motion.sine).max() > 1e-3
    assert first.value == pytest.approx(min(s.end for s in first.searches), abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_another_solver_finds_hardly_better(seed: int) -> None:
    """SciPy's SLSQP from the same start, with the same limits."""
    problem, x = _start(wish("puma", seed=seed), 0)
    ours = minimise(problem, x)
    other = minimize(
        lambda z: problem.inside(z).value,
        x,
        jac=lambda z: problem.point(z).gradient,
        method="SLSQP",
        constraints={
            "type": "ineq",
            "fun": lambda z: -problem.inside(z).limits,
            "jac": lambda z: (
                -np.stack([problem.point(z).jacobian.times(e) for e in np.eye(len(z))], axis=1)
            ),
        },
        options={"maxiter": 40, "ftol": 1e-4},
    )
    start = problem.inside(x).value
    assert ours.value < start - np.log(1.5**2)
    assert ours.value < other.fun + 0.3  # different local minima: sigma within 16 %


@pytest.mark.parametrize("instrument", ["plate", "joints", "both"])
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_slopes_of_criterion_and_limits_are_those_of_differences(
    name: str, instrument: Instrument
) -> None:
    for criterion_name in CRITERIA:
        asked = wish(name, instrument)
        asked = replace(asked, information=replace(asked.information, criterion=criterion_name))
        problem, x = _start(asked, 0)
        rng = np.random.default_rng(0)
        along = rng.normal(size=len(x))
        along /= np.linalg.norm(along)
        point = problem.point(x)
        step = 3e-4
        value, limits = 0.0, np.zeros_like(point.limits)
        for k, weight in enumerate((4 / 5, -1 / 5, 4 / 105, -1 / 280), start=1):  # of order 8
            for sign in (1, -1):
                there = problem.inside(x + sign * k * step * along)
                value += sign * weight * there.value / step
                limits += sign * weight * there.limits / step
        assert abs(value - point.gradient @ along) < 1e-9 * np.linalg.norm(point.gradient)
        found = point.jacobian.times(along)
        np.testing.assert_allclose(found, limits, atol=1e-9 * np.abs(limits).max())
        weights = rng.uniform(size=len(found))
        by_products = point.jacobian.transposed(weights)
        assert by_products @ along == pytest.approx(weights @ found)
        curved = point.jacobian.squared(weights)
        assert along @ curved @ along == pytest.approx(weights @ found**2)


@pytest.mark.parametrize("name", ["puma", "gantry", "random"])
def test_the_promise_is_least_squares_own_sigma(name: str) -> None:
    """Of perfect instruments but for the plate's noise, sample by sample, no filters."""
    tree = robot(name)
    recording = ideal(tree, duration=5.0)
    minimal = tb.minimal_set(tree, "reaction")
    estimate = tb.identify(tree, recording, "external", settings=EXACT)
    phi = tb.regressor(tree, _motion(recording), minimal) / PLATE[:, None]
    flat = phi.reshape(-1, minimal.count)
    sigma = np.sqrt(np.diag(np.linalg.inv(flat.T @ flat)))
    rng = np.random.default_rng(0)
    motion = random_motion(tree, limits_of(tree), 0.2, 4, rng)
    asked = wish(name)
    times = np.arange(200) / 200 * motion.period
    rows = tb.regressor(tree, motion.at(times), minimal) / PLATE[:, None]
    flat = rows.reshape(-1, minimal.count)
    wanted = np.sqrt(np.diag(np.linalg.inv(flat.T @ flat)) * 200)
    found = predict(asked.information, rows_of(name), motion, ALL, minimal.names)
    np.testing.assert_allclose(found.sigma, wanted, rtol=1e-6)
    scale = relative_scale(minimal, rows_of(name)["reaction"].delta)
    np.testing.assert_allclose(found.relative, found.sigma / scale)
    assert estimate.names[: minimal.count] == minimal.names
    assert sigma.shape == found.sigma.shape


def _motion(recording: tb.Recording) -> tb.Motion:
    assert recording.velocity is not None
    assert recording.acceleration is not None
    return tb.Motion(recording.time, recording.position, recording.velocity, recording.acceleration)


@pytest.mark.slow
def test_knowledge_from_before_steers_a_design() -> None:
    """What is known already need not be told again: the rest becomes more certain."""
    asked = wish("puma", starts=1)
    count, scale = asked.information.counted, asked.information.scale
    sigma = np.full(count, 1e3)
    sigma[: count // 2] = 1e-6
    prior = np.diag((sigma * scale) ** 2)
    knowing = information_of(
        asked.rules.tree, rows_of("puma"), "plate", PLATE, np.full(3, 0.5), prior=prior
    )
    rest = slice(count // 2, None)
    plain, steered = (
        design(replace(asked, information=each)).motion for each in (asked.information, knowing)
    )
    spread = [
        np.sum(predict(knowing, rows_of("puma"), motion, ALL, ("",) * count).relative[rest] ** 2)
        for motion in (plain, steered)
    ]
    assert spread[1] < spread[0]


def test_limits_that_cannot_be_met_are_named() -> None:
    asked = wish("puma")
    heavy = PlateTerm(PlateRange(np.array([1e3, 1e3, 100.0, 1e3, 1e3, 1e3])), np.zeros(6), 0.95)
    rules = replace(asked.rules, terms=(heavy,))
    with pytest.raises(InfeasibleMotion, match=r"plate Fz.*t = "):
        design(replace(asked, rules=rules))


def test_a_search_that_is_told_to_stop_has_a_motion_that_may_be_run() -> None:
    asked = wish("puma", starts=50)
    calls: list[int] = []

    def watch(done: int, total: int, best: float) -> None:
        calls.append(done)
        assert total == 50

    found = design(asked, watch, lambda: len(calls) > 5)
    assert not found.complete
    assert len(found.searches) == 1
    assert found.proof.holds
    assert design(replace(asked, seconds=0.0)).proof.holds


def test_searches_that_end_far_behind_would_not_have_won(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slow and fast motions of one robot: the fast ones tell far less, and end early."""
    asked = replace(wish("puma", starts=4), frequencies=((0.1, 5), (0.8, 2)))
    steps: list[int] = []

    def watch(done: int, total: int, best: float) -> None:
        steps.append(done)

    found = design(asked, watch)
    taken = len(steps)
    monkeypatch.setattr("testbed.excitation.design.BEHIND", np.inf)
    steps.clear()
    whole = design(asked, watch)
    assert taken < len(steps)
    assert found.complete
    np.testing.assert_array_equal(found.motion.coefficients, whole.motion.coefficients)


@pytest.mark.slow
def test_bodies_keep_clear_in_a_design() -> None:
    """Sticks of a robot without a file; the same limits without clearance bring them nearer."""
    asked = wish("puma", clear=True, starts=1)
    found = design(asked)
    margins = [m for m in found.proof.margins if m.unit == "m"]
    assert all(m.holds for m in margins)
    again = prove(found.motion, replace(asked.rules, clearance=asked.rules.clearance + 1))
    assert not again.holds
    assert _problem(asked, 0.2, 4).terms[-1].labels[0].startswith("clearance")


def failing(motion: Fourier, rules: Rules) -> Proof:
    """A proof that fails, whatever the motion."""
    found = prove(motion, rules)
    return replace(found, margins=tuple(replace(m, left=-0.5) for m in found.margins))


@pytest.mark.slow
def test_what_cannot_be_proven_is_no_design(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("testbed.excitation.design.prove", failing)
    monkeypatch.setattr("testbed.excitation.design.FINER", ())
    with pytest.raises(InfeasibleMotion, match="found, but not proven between its samples"):
        design(wish("gantry", starts=1))


@pytest.mark.slow
def test_in_the_end_a_motion_that_swings_much_less_will_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = wish("gantry", starts=1)
    whole = design(asked).motion
    size = float(np.abs(whole.sine).max())

    def proven(motion: Fourier, rules: Rules) -> Proof:
        small = np.abs(motion.sine).max() < 0.9 * size
        return prove(motion, rules) if small else failing(motion, rules)

    monkeypatch.setattr("testbed.excitation.design.prove", proven)
    monkeypatch.setattr("testbed.excitation.design.FINER", ())
    found = design(asked)
    assert found.proof.holds
    np.testing.assert_allclose(found.motion.sine, 0.88 * whole.sine, rtol=1e-9)
    np.testing.assert_allclose(found.motion.cosine, 0.88 * whole.cosine, rtol=1e-9)
    np.testing.assert_allclose(found.motion.offset, whole.offset, rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_row_counts_where_its_joint_moves_and_so_do_all_within_its_filters_reach(
    seed: int,
) -> None:
    """Instant by instant, around the period."""
    rng = np.random.default_rng(seed)
    motion = Fourier(0.25, np.zeros(2), *(0.3 * rng.normal(size=(2, 2, 3))))
    count, resting, reach = 80, 0.2, 0.21
    found = moving(motion, count, replace(ALL, resting=resting, reach=reach))
    step = motion.period / count
    for k in range(count):
        near = np.arange(-round(reach / step), round(reach / step) + 1)
        speed = np.abs(motion.derivative(np.array((k + near) * step, dtype=float), 1))
        np.testing.assert_array_equal(found[k], (speed > resting).all(axis=0))
    assert found.any()
    assert not found.all()
