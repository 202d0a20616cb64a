"""Designed motions tell more than random ones, respect all limits, and are the same again."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.core.base.errors import NoFeasibleMotion
from testbed.core.parameters.rules import Signal
from testbed.core.parameters.symbols import parameter_scale
from testbed.motion.design import DesignProblem, _initial_search, criterion, design
from testbed.motion.fourier import Fourier
from testbed.motion.information import (
    CRITERIA,
    CriterionName,
    Instrument,
    SignalProcessing,
    _scaled_inverse,
    information_of,
    is_counted,
    predict,
)
from testbed.motion.limits import joint_limits, motor_efforts
from testbed.motion.proof import MotionConstraints, Proof, prove
from testbed.motion.random_motion import random_motion
from testbed.motion.samples import MIN_RELATIVE_SCALE, SampledRows
from testbed.motion.terms import EffortTerm, ForceTerm, PlateRange, PlateTerm
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot
from tests.helpers.strategies import rngs

PLATE = np.repeat([0.5, 0.1], 3)
ALL = SignalProcessing(rate=1.0, duration=1.0, band=np.inf, min_speed=0.0, guard_time=0.0)
MODELS: tuple[Signal, ...] = ("wrench", "torque")
FAR = np.array([1e3, 1e3, 3e3, 1e3, 1e3, 1e3])


# what a search is made of


@given(rngs)
def test_criteria_are_what_they_say_and_what_is_no_information_has_no_inverse(
    rng: np.random.Generator,
) -> None:
    """Infinite, about nothing, or contradicting itself; sizes may differ by many orders."""
    root = rng.normal(size=(6, 6)) * 10.0 ** rng.uniform(-2, 2, 6)
    here = root @ root.T + 1e-3 * np.eye(6)
    found, axes = {name: of(here)[0] for name, of in CRITERIA.items()}, np.linalg.eigvalsh(here)
    assert found["a"] == pytest.approx(np.log(axes.mean()))
    assert found["d"] == pytest.approx(np.log(axes).mean())
    assert np.log(axes[-1]) - np.log(6) / 8 - 1e-12 <= found["e"] <= np.log(axes[-1]) + 1e-12
    for wrong in ([[np.inf, 0], [0, 1]], [[np.nan, 0], [0, 1]], [[0, 0], [0, 1]], [[1, 2], [2, 1]]):
        assert _scaled_inverse(np.array(wrong)) is None
    np.testing.assert_allclose(_scaled_inverse(here) @ here, np.eye(6), atol=1e-6)  # type: ignore[operator]


# designs


@cache
def arm(name: str) -> tuple[tb.Tree, dict[Signal, SampledRows]]:
    """A robot whose joints turn rotors, too, and its rows."""
    tree = robot(name)
    tree = tree.with_joints({joint: {"rotor_inertia": 0.1} for joint in tree.names})
    return tree, {model: SampledRows(tree, tb.minimal_set(tree, model)) for model in MODELS}


def asked_of(name: str, instrument: Instrument = "plate", of: CriterionName = "a") -> DesignProblem:
    tree, rows = arm(name)
    limits, pedestal = joint_limits(tree), tb.pedestal_wrench(tree)
    plate = PlateRange(FAR, np.array([1.0, 1.5]) if name == "gantry" else None)
    terms: list[ForceTerm] = [PlateTerm(plate, pedestal, 0.95)]
    if np.isfinite(limits.effort).any():
        terms.append(EffortTerm(tree, limits, 0.95))
    rules = MotionConstraints(tree, limits, 0.95, tuple(terms), None, np.zeros(0))
    information = information_of(rows, instrument, PLATE, np.full(tree.n, 0.5), of)
    return DesignProblem(rules, information, rows, ALL, ((0.2, 4),), 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_a_design_tells_more_than_random_motions_is_proven_and_is_the_same_again(name: str) -> None:
    asked = asked_of(name)
    found, again, other = design(asked), design(asked), design(replace(asked, seed=1))
    np.testing.assert_array_equal(found.motion.coefficients, again.motion.coefficients)
    assert np.abs(found.motion.sine - other.motion.sine).max() > 1e-3
    assert found.is_complete
    assert found.proof.is_valid
    rng, tree, limits = np.random.default_rng(5), asked.rules.tree, asked.rules.limits
    drawn = [random_motion(tree, limits, 0.2, 4, rng) for _ in range(10)]
    assert found.value < min(criterion(asked, motion) for motion in drawn) - np.log(1.3**2)
    fine = found.motion.at(np.linspace(0, found.motion.period, 20_001))
    assert (np.abs(fine.qd) <= 0.95 * limits.velocity).all()
    assert (np.abs(fine.qdd) <= 0.95 * limits.acceleration).all()
    assert ((fine.q >= limits.low) & (fine.q <= limits.high)).all()
    assert (np.abs(motor_efforts(tree, fine)) <= 0.95 * limits.effort + 1e-9).all()


@pytest.mark.parametrize("name", ["puma", "gantry", "random"])
def test_slopes_of_criterion_and_limits_are_those_of_differences(name: str) -> None:
    """Of rows, forces, terms and series at once: derivatives without derivative code."""
    by_torque, by_both = asked_of(name, "joints", "d"), asked_of(name, "both", "e")
    for asked in (asked_of(name), by_torque, by_both):
        problem, x = _initial_search(asked, 0)
        rng, step = np.random.default_rng(0), 3e-4
        along = rng.normal(size=len(x))
        along /= np.linalg.norm(along)
        point = problem.linearise(x)
        value, limits = 0.0, np.zeros_like(point.limits)
        for k, weight in enumerate((4 / 5, -1 / 5, 4 / 105, -1 / 280), start=1):  # of order 8
            for sign in (1, -1):
                there = problem.evaluate(x + sign * k * step * along)
                value += sign * weight * there.value / step
                limits += sign * weight * there.limits / step
        off = abs(value - point.gradient @ along)
        assert off < 1e-9 * np.linalg.norm(point.gradient)
        found, weights = point.jacobian.matvec(along), rng.uniform(size=len(limits))
        np.testing.assert_allclose(found, limits, atol=1e-9 * np.abs(limits).max())
        by_products = point.jacobian.rmatvec(weights)
        assert by_products @ along == pytest.approx(weights @ found)
        gram = point.jacobian.weighted_gram(weights)
        assert along @ gram @ along == pytest.approx(weights @ found**2)


@pytest.mark.parametrize("name", ["puma", "gantry", "random"])
def test_the_promise_is_least_squares_own_sigma(name: str) -> None:
    """Of perfect instruments but for the plate's noise, sample by sample, no filters."""
    (tree, rows), asked = arm(name), asked_of(name)
    minimal = tb.minimal_set(tree, "wrench")
    motion = random_motion(tree, joint_limits(tree), 0.2, 4, np.random.default_rng(0))
    phi = tb.regressor(tree, motion.at(np.arange(200) / 200 * motion.period), minimal)
    flat = (phi / PLATE[:, None]).reshape(-1, minimal.count)
    wanted = np.sqrt(np.diag(np.linalg.inv(flat.T @ flat)) * 200)
    found = predict(asked.information, rows, motion, ALL)
    np.testing.assert_allclose(found.sigma, wanted, rtol=1e-6)
    scale = parameter_scale(rows["wrench"].delta, minimal.units, MIN_RELATIVE_SCALE)
    np.testing.assert_allclose(found.relative, found.sigma / scale)
    spread = np.linalg.svd(flat * scale, compute_uv=False)
    assert found.condition == pytest.approx(spread[0] / spread[-1], rel=1e-6)


@given(rngs)
def test_a_row_counts_where_its_joint_moves_and_so_do_all_within_its_filters_reach(
    rng: np.random.Generator,
) -> None:
    """Instant by instant, around the period."""
    motion = Fourier(0.25, np.zeros(2), *(0.3 * rng.normal(size=(2, 2, 3))))
    found = is_counted(motion, 80, replace(ALL, min_speed=0.2, guard_time=0.21))
    for k in range(80):
        near = np.array(k + np.arange(-4, 5), dtype=float) * motion.period / 80
        speed = np.abs(motion.derivative(near, 1))
        np.testing.assert_array_equal(found[k], (speed > 0.2).all(axis=0))


@pytest.mark.slow
def test_a_search_may_end_early_is_steered_by_what_is_known_and_names_what_forbids_it() -> None:
    asked, calls = replace(asked_of("puma"), search_count=50), list[int]()
    found = design(asked, lambda done, total, best: calls.append(total), lambda: len(calls) > 5)
    assert set(calls) == {50}
    assert (found.is_complete, found.searches, found.proof.is_valid) == (False, 1, True)
    scale = asked.information.scale
    count = len(scale)
    sigma = np.where(np.arange(count) < count // 2, 1e-6, 1e3)  # the first half is known
    prior, noise = np.diag((sigma * scale) ** 2), np.full(3, 0.5)
    rows = arm("puma")[1]
    knowing = information_of(rows, "plate", PLATE, noise, prior=prior)
    one = replace(asked, search_count=1)
    motions = [design(replace(one, information=i)).motion for i in (one.information, knowing)]
    told = [predict(knowing, rows, m, ALL).relative for m in motions]
    plain, steered = (np.sum(each[count // 2 :] ** 2) for each in told)
    assert steered < plain
    heavy = PlateTerm(PlateRange(FAR * [1, 1, 0.03, 1, 1, 1]), np.zeros(6), 0.95)
    with refuses(NoFeasibleMotion, "plate Fz", "t = "):
        design(replace(asked, rules=replace(asked.rules, force_limits=(heavy,))))


@pytest.mark.slow
def test_what_is_not_proven_swings_less_or_is_no_design(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, place = replace(asked_of("puma"), seed=2), "testbed.motion.design."
    whole, share = design(asked).motion, 0.9

    def smaller(motion: Fourier, rules: MotionConstraints) -> Proof:
        """A proof that fails but of motions that swing less."""
        found = prove(motion, rules)
        if np.abs(motion.sine).max() < share * np.abs(whole.sine).max():
            return found
        return replace(found, margins=tuple(replace(m, left=-0.5) for m in found.margins))

    monkeypatch.setattr(place + "prove", smaller)
    found = design(asked).motion
    np.testing.assert_allclose(found.sine, 0.88 * whole.sine, rtol=1e-9)
    np.testing.assert_allclose(found.offset, whole.offset, rtol=1e-9)
    share = 0.0
    with refuses(NoFeasibleMotion):
        design(asked)
