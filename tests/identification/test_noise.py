"""Noise is found as it was made, what is none is told from it, and sigma counts the encoders'.

If one fails, sigma is not the size of the error, and nothing else shows it.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.applications.prediction import longest_segment_motion
from testbed.core.base.arrays import Array
from testbed.core.base.codec import json_text, to_json_values
from testbed.core.base.errors import SettingsError, TestbedError
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.influence import influence, names_by_influence
from testbed.core.estimation.known import parse_known
from testbed.core.estimation.noise.coloured_noise import averaged_fit, mixture_fit
from testbed.core.estimation.noise.fits import NoiseFit, weighted_fits, whitened_fits
from testbed.core.estimation.noise.lagged_products import (
    Autoregression,
    LaggedProducts,
    LaggedSums,
    NoiseGenerator,
    WhitenedProducts,
    best_order,
    fit_autoregression,
)
from testbed.core.estimation.noise.noise_model import (
    period_of,
)
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.metadata import vector_tuple
from testbed.core.robot.rotations import rotvec_to_matrix
from tests.helpers.ideal import ideal, plus
from tests.helpers.measured import measured
from tests.helpers.plates import mass_of
from tests.helpers.refusals import refuses
from tests.helpers.runs import noisy, robot, run_of
from tests.helpers.strategies import Rng, few, rngs, settings

LAGS = 6
TRUTH = np.array([1.0, -2.0, 0.5])
SIGMA = np.array([0.1, 1.0, 0.3, 2.0])
WHITE = Autoregression(np.zeros((4, 0)), SIGMA)
SLOW = Autoregression(np.full((4, 1), 0.9), SIGMA)


def products(*sequences: Array, cut: int = 10**9) -> LaggedProducts:
    """Of rows, (C, M, p) each, that were not recorded in one."""
    sums = LaggedSums(LAGS)
    for rows in sequences:
        sums.end_sequence()
        for first in range(0, rows.shape[1], cut):
            sums.add(rows[:, first : first + cut])
    return sums.lagged_products()


def problem(seed: int, noise: Autoregression, rows: int = 400) -> Array:
    """Slow columns, and what they and noise make of TRUTH: (C, rows, 5) with ones."""
    rng, t = np.random.default_rng(seed), np.arange(rows) / 10
    waves, phases = rng.uniform(0.1, 2.0, (4, 3)), rng.uniform(0, 6, (4, 1, 3))
    columns = np.sin(waves[:, None] * t[:, None] + phases)
    made = NoiseGenerator(noise, 1, rng).rows(rows)
    return np.concatenate([columns, columns @ TRUTH[:, None] + made, np.ones_like(made)], axis=2)


def whitened(rows: Array, a: Array) -> Array:
    """What of rows does not follow from those before, (C, M - order, p)."""
    p, last = a.shape[1], rows.shape[1]
    parts = (a[:, i, None, None] * rows[:, p - 1 - i : last - 1 - i] for i in range(p))
    return np.asarray(rows[:, p:] - sum(parts))


def by_channel(found: LaggedProducts, a: Array) -> Array:
    """Products of whitened rows, (C, p, p): a whitening for each channel, that counts it alone."""
    return WhitenedProducts(found, np.repeat(a[None], len(a), axis=0)).sums(np.eye(len(a)))


def moments(rows: Array) -> Array:
    """Of noise, (C, rows)."""
    part = np.array([rows[:, LAGS - i : rows.shape[1] - i] for i in range(LAGS + 1)])
    return np.asarray(np.einsum("ict,jct->cij", part, part))


def test_what_is_made_is_found_again() -> None:
    """Two channels of three roots, one pair of them complex; else whitening whitens nothing."""
    roots = ([0.9, 0.7 * np.exp(1j), 0.7 * np.exp(-1j)], [0.6, 0.7 * np.exp(2j), 0.7 * np.exp(-2j)])
    noise = Autoregression(
        np.array([-np.real(np.poly(each))[1:] for each in roots]), np.array([0.2, 5.0])
    )
    rows = NoiseGenerator(noise, 1, np.random.default_rng(0)).rows(100_000)[..., 0]
    assert best_order(moments(rows), rows.shape[1] - LAGS) in (3, 4, 5)
    np.testing.assert_allclose(fit_autoregression(moments(rows), 3), noise.coefficients, atol=0.03)
    left = whitened(rows[..., None], noise.coefficients)[..., 0]
    np.testing.assert_allclose(left.std(axis=1), noise.sigma, rtol=0.02)
    np.testing.assert_allclose(noise.decay_rows, -1 / np.log([0.9, 0.7]))
    pieces = NoiseGenerator(noise, 1, np.random.default_rng(0))
    cut = np.concatenate([pieces.rows(20), pieces.rows(30)], axis=1)[..., 0]
    np.testing.assert_array_equal(cut, rows[:, :50])


@given(rngs, st.lists(st.integers(LAGS, 40), min_size=1, max_size=4), st.integers(1, 50))
def test_products_are_those_of_the_rows(rng: Rng, counts: list[int], cut: int) -> None:
    """However they are cut; rows after a pause have none before. Else long recordings differ."""
    each = [rng.normal(size=(3, count, 5)) for count in counts]
    found, maps = products(*each, cut=cut), rng.normal(size=(3, 5, 2))
    for order in range(LAGS + 1):
        long = [rows for rows in each if rows.shape[1] > order]
        assert found.rows_with_history(order) == sum(rows.shape[1] - order for rows in long)
        a = rng.uniform(-0.5, 0.5, (3, order))
        parts = (whitened(rows, a) for rows in long)
        white = sum((part.swapaxes(1, 2) @ part for part in parts), np.zeros((3, 5, 5)))
        np.testing.assert_allclose(by_channel(found, a), white, atol=1e-10)
    combined = products(*(rows @ maps for rows in each))
    np.testing.assert_allclose(
        by_channel(found.combine_columns(maps), a), by_channel(combined, a), atol=1e-10
    )


@pytest.mark.parametrize("rows", [20, 80])
def test_few_rows_with_gaps_are_not_believed_beyond_their_noise(rows: int) -> None:
    """Sums over lags of few rows are error: squares of z were 4.6 of 20 rows, 1.9 of 80."""
    squares = []
    for seed in range(100):
        (found,) = weighted_fits(products(problem(seed, WHITE, rows)))
        error = found.values - TRUTH
        squares.append(error @ np.linalg.solve(found.covariance, error) / len(TRUTH))
    assert 0.7 < np.mean(squares) < 1.4


def test_the_whitened_fit_is_least_squares_of_whitened_rows() -> None:
    block = problem(0, SLOW)
    (found,) = whitened_fits(products(block))
    white = whitened(block, found.noise.coefficients) / found.noise.sigma[:, None, None]
    rows = white.reshape(-1, 5)
    expected, *_ = np.linalg.lstsq(rows[:, :3], rows[:, 3], rcond=None)
    np.testing.assert_allclose(found.values, expected, rtol=1e-3)  # weights of a round before
    normal = rows[:, :3].T @ rows[:, :3]
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal), rtol=1e-9)


def test_an_offset_counts_as_far_as_the_data_show_it() -> None:
    """A clear one is taken, few rows show none; between, covariance is that of a mixture."""
    means = np.array([1.0, 2.0, 0.0]), np.array([2.0, 1.5, -1.0])
    spreads = np.diag([0.5, 0.5, 0.0]), 2.0 * np.eye(3)
    alone, beside = (
        NoiseFit(mean[:k], spread[:k, :k], WHITE, WHITE, spread[:k, :k])
        for k, mean, spread in zip((2, 3), means, spreads, strict=True)
    )
    found, gap = mixture_fit(alone, beside, 0.3), means[1] - means[0]
    np.testing.assert_allclose(found.values, means[0] + 0.3 * gap)
    mixture = 0.7 * spreads[0] + 0.3 * spreads[1] + 0.21 * np.outer(gap, gap)
    np.testing.assert_allclose(found.covariance, mixture, atol=1e-12)
    shifted = problem(0, WHITE)
    shifted[..., 3] += 5.0
    clear, few = (averaged_fit(products(x), None, gapless=True) for x in (shifted, shifted[:, :40]))
    assert clear.weight > 0.99
    np.testing.assert_allclose(clear.directions @ clear.fit.values[3:], 5.0, atol=1.0)
    assert (few.directions.shape, few.weight) == ((4, 0), 0.0)
    weights = [
        averaged_fit(products(problem(s, WHITE)), None, gapless=True).weight for s in range(9)
    ]
    assert np.median(weights) < 0.5


SIX = Autoregression(np.zeros((6, 0)), np.arange(1.0, 7.0))
SIX_COLOURED = Autoregression(np.tile([0.6, 0.2], (6, 1)), np.ones(6))


def made(noise: Autoregression, rows: int, seed: int) -> Array:
    """Noise, (C, rows)."""
    return NoiseGenerator(noise, 1, np.random.default_rng(seed)).rows(rows)[..., 0]


@given(rngs, st.integers(200, 2000), st.integers(1, 8))
def test_the_period_of_a_motion_is_found(rng: Rng, period: int, joints: int) -> None:
    """Of a Fourier series seen by encoders, beside joints that stand still; of no other motion."""
    phase = 2 * np.pi * np.arange(2 * period + 7)[:, None, None] / period * np.arange(1, 6)
    size = rng.normal(size=(2, joints, 5))
    wave = (size[0] * np.sin(phase) + size[1] * np.cos(phase)).sum(axis=2)
    seen = np.pad(wave, ((0, 0), (0, 2))) + 1e-3 * rng.normal(size=(len(wave), joints + 2))
    seen[:, -1] = 0.0
    turning = np.array([[1.0], [-1.0]] * 10)
    assert period_of(seen) == pytest.approx(period, abs=2)
    assert period_of(turning) == 2
    wandering = np.cumsum(rng.normal(size=(3000, 2)), axis=0)
    for none in (seen[: int(1.4 * period)], wandering, turning[:3], np.ones((20, 2))):
        assert period_of(none) is None


@pytest.mark.slow
def test_sigma_counts_what_coarse_encoders_do() -> None:
    """Of slow motions that repeat, under slow noise; nothing is said of finer encoders."""
    tree, count = robot("puma"), 1e-3
    slow = measured(tree, 1, duration=60.0, rate=250.0, speed=0.2, memory=0.993)
    rounded = replace(slow, position=count * np.round(slow.position / count))
    coarse, fine = (tb.identify(tree, each, zeros=True) for each in (rounded, slow))
    truth = coarse.minimal.values(tb.barycentric(tree))
    assert np.sqrt(np.mean(((coarse.values - truth) / coarse.sigma) ** 2)) < 1.5
    for found, seen in ((coarse, True), (fine, False)):
        assert found.noise is not None
        assert found.noise.quantization_matters == seen
        np.testing.assert_allclose(found.noise.least_counts, [count] * 3 * seen, rtol=1e-6)
        said = [d.text for d in found.diagnostics if d.code == "encoder.resolution"]
        assert [len([n for n in tree.names if n in text]) for text in said] == [tree.n] * seen
    assert (coarse.sigma > fine.sigma).mean() > 0.8


# errors are of the size of sigma, under any noise, settings, plate's zero, facts and weights


def scores(tree: tb.Tree, estimate: Estimate) -> Array:
    """Errors of the minimal parameters in units of sigma."""
    base = estimate.base
    return np.asarray((base.values - estimate.minimal.values(tb.barycentric(tree))) / base.sigma)


@pytest.mark.slow
@few(8)
@given(
    st.sampled_from(["puma", "gantry"]), settings, st.sampled_from(SIGNALS),
    st.sampled_from([0.0, 0.98]),
)  # fmt: skip
def test_errors_are_as_sigma_says(
    name: str, how: tb.Settings, method: Signal, memory: float
) -> None:
    """Under white and slow noise, however signals are treated."""
    tree = robot(name)
    if name != "puma":
        how = replace(how, zeros=False)
    if memory or "off" in (how.cutoff, how.position_cutoff):
        how = replace(how, cutoff=5.0, position_cutoff=20.0)
    found = tb.identify(tree, measured(tree, 1, memory=memory), method, settings=how)
    assert 0.3 < float(np.sqrt(np.mean(scores(tree, found) ** 2))) < 2.0
    assert found.noise is not None
    assert found.noise.factor >= 1.0


@pytest.mark.slow
def test_sigma_holds_where_noise_of_accelerations_passes_the_filter() -> None:
    """It draws plain least squares to zero, by up to 20 sigma here; drowned ones are named."""
    tree = robot("puma")
    how = tb.Settings(cutoff=20.0)
    found = tb.identify(tree, measured(tree, 1, duration=60.0), "torque", settings=how)
    assert 0.4 < float(np.sqrt(np.mean(scores(tree, found) ** 2))) < 1.7
    tree, rng = robot("gantry"), np.random.default_rng(0)
    fine = measured(tree, 0, duration=40.0, speed=0.25, memory=0.98, noise=0.1)
    coarse = replace(fine, position=fine.position + 5e-4 * rng.normal(size=fine.position.shape))
    noise_limited = [tb.identify(tree, each).noise for each in (fine, coarse)]
    assert [bool(each and each.noise_limited) for each in noise_limited] == [False, True]


@pytest.mark.slow
def test_what_a_plates_zero_hides_has_no_sigma() -> None:
    """It is found and told; all others hold; a known mass makes it known."""
    tree, rng = robot("puma"), np.random.default_rng(0)
    clean, zero = measured(tree), 3 * np.repeat([1.0, 0.2], 3) * rng.normal(size=6)
    off = plus(clean, wrench=zero)
    found = tb.identify(tree, off)
    assert found.unidentifiable == ("mbar1",)
    assert np.abs(scores(tree, found)).max() < 5
    noise = found.noise
    assert noise is not None
    assert noise.hidden == ("mbar1",)
    told = noise.bias_sigma > 0
    assert told.sum() >= 5
    np.testing.assert_array_less(np.abs(noise.bias - zero)[told], 5 * noise.bias_sigma[told])
    content = json.loads(json_text(to_json_values(found)))
    assert content["unidentifiable"] == ["mbar1"]
    assert [k for k, s in enumerate(content["sigma"]) if s is None] == [found.names.index("mbar1")]
    known = tb.Settings(known={"mass": (mass_of(tree), 0.01)})
    sure = tb.identify(tree, off, settings=known)
    assert sure.unidentifiable == () == tb.identify(tree, clean).unidentifiable
    assert np.abs(scores(tree, sure)).max() < 5
    other = plus(measured(tree, 1), wrench=20 + zero)
    held, false = (tb.validate(each, other) for each in (found, tb.identify(tree, clean)))
    assert [each.code for each in held.diagnostics] == []
    assert {each.code for each in false.diagnostics} == {"estimate.prediction-offset"}


@pytest.mark.slow
def test_dry_friction_that_jumps_at_reversals_does_not_enter() -> None:
    """The further the reach the fewer the rows; whitened, more rows count than without any near."""
    tree = robot("puma")
    clean = measured(tree, noise=1e-3)
    speed = np.gradient(clean.position, clean.time, axis=0)
    stuck = np.where(np.abs(speed) < tb.Settings().deadband, 20.0, 0.0)  # a force that no law has
    errors, counts = [], []
    for reach in (None, 0.02, 0.05, 0.15, 10.0):
        how = tb.Settings(reversal_reach=reach, zeros=True)
        found = tb.identify(tree, plus(clean, torque=stuck), "torque", settings=how)
        truth = found.minimal.values(tb.barycentric(tree))
        errors.append(float(np.abs(found.base.values / truth - 1).max()))
        counts.append(sum(found.samples))
    assert counts[1:] == sorted(counts[1:], reverse=True)
    assert counts[1] > counts[0] > counts[3] > counts[4]
    assert max(errors[0], errors[3]) < 0.1 * errors[1]


@pytest.mark.slow
def test_facts_count_as_far_as_they_are_sure() -> None:
    """Held, a mass is had; its doubt comes back as far as the estimate moves; seen by moving it."""
    tree, recording = robot("puma"), measured(robot("puma"))

    def knowing(method: Signal = "wrench", **known: float | tuple[float, float]) -> Estimate:
        return tb.identify(tree, recording, method, settings=tb.Settings(known=known))

    mass = mass_of(tree) + 1.0
    exact, moved, doubted = (knowing(mass=m) for m in (mass, mass + 1e-3, (mass, 0.05)))
    theta = (exact.minimal.lift @ exact.values).reshape(-1, 10)
    roots = [k for k, joint in enumerate(tree.joints) if joint.parent < 0]
    assert theta[roots, 0].sum() == pytest.approx(mass, abs=1e-9)
    slope = (moved.values - exact.values) / 1e-3
    wanted = np.sqrt(np.diagonal(exact.covariance) + (0.05 * slope) ** 2)
    np.testing.assert_allclose(doubted.values, exact.values)
    np.testing.assert_allclose(np.sqrt(np.diagonal(doubted.covariance)), wanted, rtol=0.02)
    plain, k = knowing("torque"), 3
    np.testing.assert_array_equal(plain.values, knowing("torque", mass=3.0).values)  # not told
    found = knowing("torque", **{plain.names[k]: float(plain.values[k])})
    assert np.abs((found.values - plain.values) / plain.sigma).max() < 0.01
    assert found.noise is not None
    assert plain.noise is not None
    column = plain.covariance[:, k]
    left = plain.covariance - np.outer(column, column) / plain.covariance[k, k]
    spread = np.sqrt(np.maximum(np.diagonal(left), 0)) * found.noise.factor / plain.noise.factor
    spread[k] = 0.0
    np.testing.assert_allclose(found.sigma, spread, rtol=0.02)


def test_facts_that_mean_nothing_are_refused() -> None:
    words = ["mass=20", "gain/Fz=1.01+-2e-3"]
    assert parse_known(words) == {"mass": (20.0, 0.0), "gain/Fz": (1.01, 2e-3)}
    for word in ("mass=", "=20", "mass=20+-much"):
        with refuses(SettingsError, word):
            parse_known([word])
    tree, recording = robot("puma"), measured(robot("puma"), duration=4.0)
    for names, culprit in (
        (["weight"], "weight"),
        (["centre/w"], "centre/w"),
        (["centre/z"], "centre/z"),
        (["centre/x@hip=1"], "hip"),
        (["mass", "mbar1"], "mbar1"),  # known twice
    ):
        with pytest.raises(TestbedError, match=culprit):
            tb.identify(tree, recording, settings=tb.Settings(known=dict.fromkeys(names, 0.1)))


@pytest.mark.slow
def test_a_plate_that_is_not_level_is_named() -> None:
    """By 1 degree; a level one is not."""
    tree = robot("ur5")
    leaning = tree.with_gravity(rotvec_to_matrix([0.02, 0, 0]) @ tree.gravity)
    for actual, said in ((leaning, True), (tree, False)):
        made = noisy(ideal(actual, duration=20.0), size=0.02)
        metadata = replace(made.metadata, gravity=vector_tuple(tree.gravity))
        found = tb.identify(tree, replace(made, metadata=metadata))
        assert ("tilt" in {each.family for each in found.model_errors}) == said


def test_a_parameter_counts_for_the_signal_that_it_makes_alone() -> None:
    """Witness: the regressor of the motion, unfiltered; the largest is told first."""
    tree = robot("gantry")
    recording = ideal(tree)
    found = run_of(tree, recording).estimates["wrench"]
    truth = found.minimal.values(tb.barycentric(tree))
    columns = tb.regressor(tree, longest_segment_motion(recording)[0], found.minimal) * truth
    parts = (columns[:, :3], columns[:, 3:])
    wanted = np.max(
        [np.linalg.norm(p, axis=(0, 1)) / np.linalg.norm(p.sum(axis=2)) for p in parts], axis=0
    )
    values = dict(zip(found.names, truth.tolist(), strict=True))
    large = wanted > 0.02 * wanted.max()
    np.testing.assert_allclose(influence(found, values)[large], wanted[large], rtol=0.2)
    assert names_by_influence([found], values)[0] == found.names[int(wanted.argmax())]
