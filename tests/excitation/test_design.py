"""Designed motions tell more than random ones, respect all limits, and are the same again."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

import testbed as tb
from testbed.arrays import Array
from testbed.errors import InfeasibleMotion
from testbed.excitation.barrier_search import Inside, Point, minimise
from testbed.excitation.criteria import CRITERIA, CriterionName, e_optimal
from testbed.excitation.design import Wish, _start, criterion, design
from testbed.excitation.fourier import Fourier
from testbed.excitation.information import Instrument, _inverse, information_of, relative_scale
from testbed.excitation.limit_terms import EffortTerm, PlateRange, PlateTerm, SmoothTerm
from testbed.excitation.limits import limits_of, motor_efforts
from testbed.excitation.prediction import Pipeline, moving, predict
from testbed.excitation.proof import Proof, Rules, prove
from testbed.excitation.random_motion import random_motion
from testbed.excitation.sampled_rows import SampledRows
from testbed.excitation.samples import Computed
from testbed.excitation.series import Series
from testbed.parameters.rules import Model
from tests.helpers.differences import samples_of, slopes_by_differences
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot
from tests.helpers.strategies import few, rngs, seeds, trees

PLATE = np.repeat([0.5, 0.1], 3)
ALL = Pipeline(rate=1.0, span=1.0, band=np.inf, resting=0.0, reach=0.0)
MODELS: tuple[Model, ...] = ("reaction", "dynamic")
NAMES: tuple[CriterionName, ...] = ("a", "d", "e")


# what a search is made of


@given(rngs)
def test_a_motion_is_what_its_series_says_and_its_derivatives_are_exact(
    rng: np.random.Generator,
) -> None:
    """Coefficients by an FFT of one period."""
    motion, h = Fourier(0.2, rng.normal(size=3), *rng.normal(size=(2, 3, 4))), 1e-4
    times = np.arange(64) / 64 * motion.period
    lines = np.fft.rfft(motion.at(times + motion.period).q, axis=0) / 64
    np.testing.assert_allclose(lines[0].real, motion.offset, atol=1e-12)
    np.testing.assert_allclose(2 * lines[1:5].T, motion.cosine - 1j * motion.sine, atol=1e-11)
    before, now, after = (motion.at(times + step) for step in (-h, 0, h))
    np.testing.assert_allclose((after.q - before.q) / (2 * h), now.qd, atol=1e-4)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * h), now.qdd, atol=1e-3)
    np.testing.assert_array_equal(now.t, times)


@few(5)
@given(trees((3, 3)), rngs, st.sampled_from([(), (4,), (2, 3)]))
def test_unknowns_of_a_search_are_a_motion_and_its_slopes_pulled_back(
    tree: tb.Tree, rng: np.random.Generator, lead: tuple[int, ...]
) -> None:
    """And what is at most `linear_most` at its instants is at most the margin at every moment."""
    one = Series(limits_of(tree), 0.2, 2, 15, 0.9)
    x, slopes = rng.normal(size=3 * one.width), rng.normal(size=(*lead, 9, 15))
    moved = one.at(x)  # (3, G, n), linear in the unknowns
    wanted = np.einsum("...djg,dgj->...", slopes.reshape(*lead, 3, 3, 15), moved)
    np.testing.assert_allclose(one.pulled(slopes) @ x, wanted, rtol=1e-10, atol=1e-11)
    some = rng.normal(size=(9, 15))
    by_instant = one.each(some.T, np.arange(15)).sum(axis=0)
    np.testing.assert_allclose(by_instant, one.pulled(some), rtol=1e-10, atol=1e-11)
    motion, limits = one.motion(x), one.limits
    np.testing.assert_allclose(one.unknowns(motion), x, rtol=1e-11, atol=1e-12)
    there = motion.at(one.times)
    np.testing.assert_allclose(moved, [there.q, there.qd, there.qdd], rtol=1e-9, atol=1e-11)
    above, below = one.linear_values(x)[:, 0], one.linear_values(x)[:, 1]
    shares = [(there.q - limits.middle) / limits.half, there.qd / limits.velocity]
    shares.append(there.qdd / limits.acceleration)
    np.testing.assert_allclose((above - below) / 2, np.vstack(shares).T, atol=1e-10)
    np.testing.assert_allclose(above + below, -2 * one.linear_most, atol=1e-10)
    assert 0.9 * one.margin < one.linear_most < one.margin
    for order in range(3):
        many = (one.times, np.linspace(0, 1 / one.fundamental, 20_001))
        at, ever = (
            np.abs(motion.derivative(t, order) - motion.offset * (order == 0)) for t in many
        )
        allowed = at.max(axis=0) * one.margin / one.linear_most
        assert (ever.max(axis=0) <= allowed * (1 + 1e-9)).all()


@few(6)
@given(trees((2, 5)), rngs, st.sampled_from(MODELS))
def test_forces_of_rows_and_their_slopes_are_the_recursions(
    tree: tb.Tree, rng: np.random.Generator, model: Model
) -> None:
    """Derivatives without derivative code, against differences of inverse dynamics."""
    motion = tb.Motion(np.arange(4.0), *rng.normal(size=(3, 4, tree.n)))
    samples, forces = samples_of(tree, motion), Computed(tree, motion).forces(model)
    np.testing.assert_allclose(samples.forces(model), forces, atol=1e-11 * np.abs(forces).max())
    wanted = slopes_by_differences(motion, lambda moved: Computed(tree, moved).forces(model))
    found, size = samples.force_slopes(model), np.abs(wanted).max()
    np.testing.assert_allclose(found, wanted, atol=1e-9 * size)


@given(rngs, st.sampled_from(NAMES))
def test_criteria_are_what_they_say_and_their_slopes_are_right(
    rng: np.random.Generator, name: CriterionName
) -> None:
    root = rng.normal(size=(6, 6)) * 10.0 ** rng.uniform(-2, 2, 6)
    here, turn = root @ root.T + 1e-3 * np.eye(6), rng.normal(size=(6, 6))
    step = 1e-5 * np.linalg.eigvalsh(here)[0] * (turn + turn.T)
    value, slope = CRITERIA[name](here)
    after, before = (CRITERIA[name](here + sign * step)[0] for sign in (1, -1))
    wanted = float(np.sum(slope * step))
    assert (after - before) / 2 == pytest.approx(wanted, rel=1e-4, abs=1e-12)
    assert CRITERIA[name](0.04 * np.eye(7))[0] == pytest.approx(np.log(0.04))
    for factor in (1e-8, 1e8):  # noise shifts all alike
        assert CRITERIA[name](factor * here)[0] - value == pytest.approx(np.log(factor))
    longest = np.log(np.linalg.eigvalsh(here)[-1])
    assert longest - np.log(6) / 8 - 1e-12 <= e_optimal(here)[0] <= longest + 1e-12


def test_what_is_no_information_has_no_inverse() -> None:
    """Infinite, about nothing, or contradicting itself; sizes may differ by many orders."""
    for wrong in ([[np.inf, 0], [0, 1]], [[np.nan, 0], [0, 1]], [[0, 0], [0, 1]], [[1, 2], [2, 1]]):
        assert _inverse(np.array(wrong)) is None
    far = np.array([[1e12, 1e2], [1e2, 1e-4]])
    found = _inverse(far)
    assert found is not None
    np.testing.assert_allclose(found @ far, np.eye(2), atol=1e-3)


@dataclass
class Dense:
    """Derivatives as a matrix."""

    matrix: Array

    def times(self, x: Array) -> Array:
        return np.asarray(self.matrix @ x)

    def transposed(self, weights: Array) -> Array:
        return np.asarray(self.matrix.T @ weights)

    def squared(self, weights: Array) -> Array:
        return np.asarray(self.matrix.T @ (weights[:, None] * self.matrix))


@dataclass
class Ball:
    """A smooth function within a ball and a random polytope around zero."""

    seed: int
    flawed: bool = False
    seen: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        self.goal, self.faces = 3 * rng.normal(size=6), rng.normal(size=(10, 6))

    def value(self, x: Array) -> float:
        return float(np.sum((x - self.goal) ** 4) ** 0.5 + np.sum((x - self.goal) ** 2))

    def limits(self, x: Array) -> Array:
        return np.append(self.faces @ x - 1, x @ x - 4)

    def inside(self, x: Array) -> Inside:
        stuck = self.flawed and len(self.seen) > 3
        return Inside(np.inf if stuck else self.value(x), self.limits(x))

    def point(self, x: Array) -> Point:
        self.seen.append(x)
        away = x - self.goal
        slope = 2 * away**3 / max(np.sum(away**4) ** 0.5, 1e-12) + 2 * away
        rows = Dense(np.vstack([self.faces, 2 * x]))
        return Point(self.value(x), self.limits(x), x, slope, rows)


@pytest.mark.slow
def test_what_is_not_proven_swings_less_or_is_no_design(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, place = wish("puma", seed=2), "testbed.excitation.design."
    whole = design(asked).motion
    size = float(np.abs(whole.sine).max())
    monkeypatch.setattr(place + "FINER", ())

    def proven(motion: Fourier, rules: Rules) -> Proof:
        small = np.abs(motion.sine).max() < 0.9 * size
        return prove(motion, rules) if small else failing(motion, rules)

    monkeypatch.setattr(place + "prove", proven)
    found = design(asked).motion
    np.testing.assert_allclose(found.sine, 0.88 * whole.sine, rtol=1e-9)
    np.testing.assert_allclose(found.offset, whole.offset, rtol=1e-9)
    monkeypatch.setattr(place + "prove", failing)
    with refuses(InfeasibleMotion):
        design(asked)


def test_a_search_that_finds_no_step_has_its_last_point() -> None:
    zero, search = np.zeros(6), Ball(1, flawed=True)
    found = minimise(search, zero)
    assert len(search.seen) == 4
    np.testing.assert_array_equal(found.x, search.seen[-1])
    assert found.holds
    assert found.value < search.value(zero)
    with pytest.raises(ValueError, match="outside"):
        minimise(Ball(0), 10 * np.ones(6))


@few(8)
@given(seeds)
def test_a_search_ends_where_another_solver_does_and_is_inside_all_the_way(seed: int) -> None:
    ball, zero = Ball(seed), np.zeros(6)
    found = minimise(ball, zero, iterations=300)
    assert all((ball.limits(x) < 0).all() for x in ball.seen)
    other = minimize(
        ball.value,
        zero,
        method="SLSQP",
        jac=lambda x: ball.point(x).gradient,
        constraints={"type": "ineq", "fun": lambda x: -ball.limits(x)},
        options={"maxiter": 500, "ftol": 1e-9},
    )
    assert (ball.limits(other.x) < 1e-6).all()
    assert found.value == pytest.approx(other.fun, rel=2e-3)
    assert found.value >= other.fun - 1e-5 * abs(other.fun)


# designs


@cache
def rows_of(name: str) -> dict[Model, SampledRows]:
    tree = robot(name)
    return {model: SampledRows(tree, tb.minimal_set(tree, model)) for model in MODELS}


def wish(name: str, instrument: Instrument = "plate", starts: int = 1, seed: int = 0) -> Wish:
    tree = robot(name)
    limits = limits_of(tree)
    plate = PlateRange(np.array([1e3, 1e3, 3e3, 1e3, 1e3, 1e3]))
    terms: list[SmoothTerm] = [PlateTerm(plate, tb.pedestal_wrench(tree), 0.95)]
    if np.isfinite(limits.effort).any():
        terms.append(EffortTerm(tree, limits, 0.95))
    rules = Rules(tree, limits, 0.95, tuple(terms), None, np.zeros(0))
    noise = np.full(tree.n, 0.5)
    information = information_of(tree, rows_of(name), instrument, PLATE, noise)
    return Wish(rules, information, rows_of(name), ((0.2, 4),), starts, np.inf, seed)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_a_design_tells_more_than_random_motions_is_proven_and_is_the_same_again(name: str) -> None:
    asked = wish(name)
    found, again, other = design(asked), design(asked), design(replace(asked, seed=1))
    np.testing.assert_array_equal(found.motion.coefficients, again.motion.coefficients)
    assert np.abs(found.motion.sine - other.motion.sine).max() > 1e-3
    assert found.complete
    assert found.proof.holds
    rng, tree, limits = np.random.default_rng(5), asked.rules.tree, asked.rules.limits
    drawn = [random_motion(tree, limits, 0.2, 4, rng) for _ in range(10)]
    assert found.value < min(criterion(asked, motion) for motion in drawn) - np.log(1.3**2)
    fine = found.motion.at(np.linspace(0, found.motion.period, 20_001))
    assert (np.abs(fine.qd) <= 0.95 * limits.velocity).all()
    assert (np.abs(fine.qdd) <= 0.95 * limits.acceleration).all()
    assert ((fine.q >= limits.low) & (fine.q <= limits.high)).all()
    assert (np.abs(motor_efforts(tree, fine)) <= 0.95 * limits.effort + 1e-9).all()


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_slopes_of_criterion_and_limits_are_those_of_differences(name: str) -> None:
    instruments: tuple[Instrument, ...] = ("plate", "joints", "both")
    for instrument, criterion_name in zip(instruments, NAMES, strict=True):
        asked = wish(name, instrument)
        asked = replace(asked, information=replace(asked.information, criterion=criterion_name))
        problem, x = _start(asked, 0)
        rng, step = np.random.default_rng(0), 3e-4
        along = rng.normal(size=len(x))
        along /= np.linalg.norm(along)
        point = problem.point(x)
        value, limits = 0.0, np.zeros_like(point.limits)
        for k, weight in enumerate((4 / 5, -1 / 5, 4 / 105, -1 / 280), start=1):  # of order 8
            for sign in (1, -1):
                there = problem.inside(x + sign * k * step * along)
                value += sign * weight * there.value / step
                limits += sign * weight * there.limits / step
        assert abs(value - point.gradient @ along) < 1e-9 * np.linalg.norm(point.gradient)
        found, weights = point.jacobian.times(along), rng.uniform(size=len(limits))
        np.testing.assert_allclose(found, limits, atol=1e-9 * np.abs(limits).max())
        by_products = point.jacobian.transposed(weights)
        assert by_products @ along == pytest.approx(weights @ found)
        assert along @ point.jacobian.squared(weights) @ along == pytest.approx(weights @ found**2)


@pytest.mark.parametrize("name", ["puma", "gantry", "random"])
def test_the_promise_is_least_squares_own_sigma(name: str) -> None:
    """Of perfect instruments but for the plate's noise, sample by sample, no filters."""
    tree, asked = robot(name), wish(name)
    minimal = tb.minimal_set(tree, "reaction")
    motion = random_motion(tree, limits_of(tree), 0.2, 4, np.random.default_rng(0))
    rows = tb.regressor(tree, motion.at(np.arange(200) / 200 * motion.period), minimal)
    flat = (rows / PLATE[:, None]).reshape(-1, minimal.count)
    wanted = np.sqrt(np.diag(np.linalg.inv(flat.T @ flat)) * 200)
    found = predict(asked.information, rows_of(name), motion, ALL, minimal.names)
    np.testing.assert_allclose(found.sigma, wanted, rtol=1e-6)
    scale = relative_scale(minimal, rows_of(name)["reaction"].delta)
    np.testing.assert_allclose(found.relative, found.sigma / scale)
    spread = np.linalg.svd(flat * scale, compute_uv=False)
    assert found.condition == pytest.approx(spread[0] / spread[-1], rel=1e-6)


@given(rngs)
def test_a_row_counts_where_its_joint_moves_and_so_do_all_within_its_filters_reach(
    rng: np.random.Generator,
) -> None:
    """Instant by instant, around the period."""
    motion = Fourier(0.25, np.zeros(2), *(0.3 * rng.normal(size=(2, 2, 3))))
    found = moving(motion, 80, replace(ALL, resting=0.2, reach=0.21))
    step = motion.period / 80
    for k in range(80):
        near = np.arange(-round(0.21 / step), round(0.21 / step) + 1)
        speed = np.abs(motion.derivative(np.array((k + near) * step, dtype=float), 1))
        np.testing.assert_array_equal(found[k], (speed > 0.2).all(axis=0))


@pytest.mark.slow
def test_a_search_may_end_early_is_steered_by_what_is_known_and_names_what_forbids_it() -> None:
    asked = wish("puma", starts=50)
    calls: list[tuple[int, int]] = []
    found = design(
        asked, lambda done, total, best: calls.append((done, total)), lambda: len(calls) > 5
    )
    assert {total for _, total in calls} == {50}
    assert (found.complete, len(found.searches), found.proof.holds) == (False, 1, True)
    assert design(replace(asked, seconds=0.0)).proof.holds
    count, scale = asked.information.counted, asked.information.scale
    sigma = np.where(np.arange(count) < count // 2, 1e-6, 1e3)  # the first half is known
    prior, noise = np.diag((sigma * scale) ** 2), np.full(3, 0.5)
    tree, rows = asked.rules.tree, rows_of("puma")
    knowing = information_of(tree, rows, "plate", PLATE, noise, prior=prior)
    one = replace(asked, starts=1)
    motions = [design(replace(one, information=i)).motion for i in (one.information, knowing)]
    told = [predict(knowing, rows, m, ALL, ("",) * count).relative for m in motions]
    plain, steered = (np.sum(each[count // 2 :] ** 2) for each in told)
    assert steered < plain
    heavy = PlateTerm(PlateRange(np.array([1e3, 1e3, 100.0, 1e3, 1e3, 1e3])), np.zeros(6), 0.95)
    with refuses(InfeasibleMotion, "plate Fz", "t = "):
        design(replace(asked, rules=replace(asked.rules, terms=(heavy,))))


def failing(motion: Fourier, rules: Rules) -> Proof:
    """A proof that fails, whatever the motion."""
    found = prove(motion, rules)
    return replace(found, margins=tuple(replace(m, left=-0.5) for m in found.margins))
