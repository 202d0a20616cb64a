"""Solutions and sigmas as good as dense linear algebra gives, or refused by name."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.arrays import AnyArray, Array
from testbed.dynamics.algebra import NUMBERS
from testbed.dynamics.kinematics import kinematics
from testbed.dynamics.newton_euler import transmitted
from testbed.errors import UnknownName
from testbed.identification.covariance import ScoreSquares, bin_size, hidden
from testbed.identification.estimate import METHODS, SIGNAL_OF, Method
from testbed.identification.filters import row_weights
from testbed.identification.predict import motion_in
from tests.helpers.ideal import EXACT, ideal, plus, true_values
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.runs import noisy, robot
from tests.helpers.strategies import rngs


@pytest.mark.parametrize("method", METHODS)
def test_a_fit_of_some_channels_is_the_fit_of_their_rows(method: Method) -> None:
    """By weight, and by leaving the rows of the others out of a dense problem."""
    tree = random_robot(np.random.default_rng(4), 3).tree()
    recording = noisy(ideal(tree))
    settings = replace(EXACT, terms=(), deadband=0.0)
    estimate = tb.identify(tree, recording, method, settings=settings)
    left = {name: 1.0 + k for k, name in enumerate(estimate.channels) if k != 1}
    phi = tb.regressor(tree, motion_in(recording)[0], estimate.minimal)
    y = recording.measured(SIGNAL_OF[method])
    keep = [k for k, name in enumerate(estimate.channels) if name in left]
    root = np.sqrt([left[estimate.channels[k]] for k in keep])
    a = (phi[:, keep] * root[:, None]).reshape(-1, estimate.minimal.count)
    expected = np.linalg.lstsq(a, (y[:, keep] * root).ravel(), rcond=None)[0]
    found = tb.fit(estimate.normal_equations, left)
    seen = ~np.isnan(found.values)
    scale = np.abs(expected).max()
    assert np.abs(found.values[seen] - expected[seen]).max() <= 1e-9 * scale
    assert not a[:, ~seen].any()
    again = tb.fit(estimate.normal_equations)
    np.testing.assert_allclose(again.values, estimate.values, rtol=1e-8, atol=1e-8 * scale)
    with refuses(UnknownName, "Mq"):
        tb.fit(estimate.normal_equations, {"Mq": 1.0})


def test_channels_weigh_as_their_own_residuals_say(puma: tb.Tree) -> None:
    """However unlike their noise is: a poor channel does not spoil a good one."""
    noise = np.random.default_rng(0).normal(size=(400, 6)) * [5.0, 0.5, 0.5, 0.1, 0.01, 1.0]
    recording = plus(ideal(puma, 2.0), wrench=noise)
    equations = tb.identify(puma, recording, settings=EXACT).normal_equations
    found = tb.fit(equations)
    free = equations.used - len(equations.unknowns) / 6
    left = np.diagonal(equations.residual(found.values)) / free
    np.testing.assert_allclose(np.diagonal(found.weights) * left, 1.0, atol=1e-5)


def test_the_full_covariance_of_the_plate_is_worth_knowing() -> None:
    """Noise of which Fx and My hold the same, ten times larger than the rest."""
    tree = robot("puma")
    root = np.eye(6) * 0.1
    root[0, 0] = root[4, 0] = 3.0
    noise = np.random.default_rng(5).normal(size=(12000, 6)) @ root.T
    recording = plus(ideal(tree, duration=60.0, seed=3), wrench=noise)
    weights: tuple[Any, ...] = ("channels", "full", root @ root.T)
    found = [
        tb.identify(tree, recording, settings=replace(EXACT, weights=each)) for each in weights
    ]
    gaps = [each.values - true_values(tree, "external") for each in found]
    assert np.linalg.norm(found[1].sigma) < 0.8 * np.linalg.norm(found[0].sigma)
    assert np.linalg.norm(gaps[1]) < np.linalg.norm(gaps[0])
    np.testing.assert_allclose(gaps[1], gaps[2], rtol=0.05, atol=0.05)
    for gap, each in zip(gaps, found, strict=True):
        assert np.abs(gap / each.sigma).max() < 4.0


def extended(tree: tb.Tree, motion: tb.Motion, minimal: tb.MinimalSet) -> Array:
    """The reaction regressor in extended precision, (6 M, N)."""
    states: tuple[AnyArray, ...] = (motion.q, motion.qd, motion.qdd)
    q, qd, qdd = (x.astype(np.longdouble) for x in states)
    lift = minimal.lift.reshape(tree.n, 10, minimal.count).astype(np.longdouble)
    moving = kinematics(tree, q, qd, qdd, minimal.gravity, NUMBERS)
    base: Array = transmitted(tree, moving, lift, NUMBERS)[1]
    return base.reshape(-1, minimal.count)


@pytest.mark.parametrize("exponent", [0, 3, 5, 7])
def test_as_accurate_as_lstsq_up_to_a_condition_of_a_million(exponent: int) -> None:
    """Two joints and one that moves less and less; against lstsq in extended precision."""
    tree = random_robot(np.random.default_rng(12), 3).tree()
    clean, small = ideal(tree, duration=20.0), np.array([1.0, 1.0, 10.0**-exponent])
    full, _ = motion_in(clean)
    offset = np.array([0.0, 0.0, 0.3])
    motion = tb.Motion(full.t, full.q * small + offset, full.qd * small, full.qdd * small)
    minimal = tb.minimal_set(tree, "reaction")
    phi = tb.regressor(tree, motion, minimal).reshape(-1, minimal.count)
    wrench = (phi @ minimal.values(tb.barycentric(tree))).reshape(-1, 6)
    wrench = wrench + 1e-2 * np.random.default_rng(exponent).normal(size=wrench.shape)
    rates: dict[str, Any] = {"velocity": motion.qd, "acceleration": motion.qdd}
    recording = replace(clean, position=motion.q, wrench=wrench, **rates)
    estimate = tb.identify(tree, recording, settings=replace(EXACT, weights=np.eye(6).tolist()))
    scale = np.linalg.norm(phi, axis=0)
    a, y = phi / scale, wrench.ravel()
    plain = np.linalg.lstsq(a, y, rcond=None)[0]
    fine, inverse = extended(tree, motion, minimal) / scale, np.linalg.pinv(a)
    exact = plain.astype(np.longdouble)
    for _ in range(8):
        exact = exact + inverse @ (y - fine @ exact).astype(float)
    ours, theirs = (
        np.linalg.norm((each - exact).astype(float)) / np.linalg.norm(exact.astype(float))
        for each in (estimate.values * scale, plain)
    )
    assert 10.0**exponent < estimate.condition < 200 * 10.0**exponent
    assert ours <= (3 * max(float(theirs), 4e-15) if estimate.condition <= 1e6 else 1e-6)


@given(rngs, st.lists(st.integers(0, 100), max_size=4))
def test_the_covariances_sums_have_bartletts_weights(
    rng: np.random.Generator, cuts: list[int]
) -> None:
    """However the scores come."""
    scores = rng.normal(size=(100, 4))
    squares = ScoreSquares(4, rate=20.0)
    for part in np.split(scores, sorted(cuts)):
        squares.add(part)
    assert squares.lags == 10
    expected = scores.T @ scores
    for lag in range(1, 11):
        overlap = scores[lag:].T @ scores[:-lag]
        expected += (1 - lag / 11) * (overlap + overlap.T)
    np.testing.assert_allclose(squares.finish(), expected, rtol=1e-12, atol=1e-12)
    assert [bin_size(rate) for rate in (20.0, 100.0, 1000.0, 1e5)] == [1, 8, 64, 64]


def test_what_those_weights_hide_of_filtered_noise_is_given_back() -> None:
    """Expected squares are those of all impulses: of each, the rows that it leaves."""
    for rate, step in ((200.0, 10), (150.0, 10), (1000.0, 100)):
        weights, rows = row_weights(rate, 5.0), rate / step
        whole = seen = 0.0
        for phase in range(step):
            squares = ScoreSquares(1, rows)
            squares.add(weights[phase::step][:, None])
            seen += float(squares.finish()[0, 0])
            whole += float(weights[phase::step].sum() ** 2)
        assert hidden(weights, step, rows) == pytest.approx(whole / seen, rel=1e-9)
        assert hidden(np.ones(1), step, rows) == 1.0
