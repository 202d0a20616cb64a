"""Noise is found as it was made, what is none is told from it, and sigma counts the encoders'.

If one fails, sigma is not the size of the error, and nothing else shows it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view
from scipy import linalg, stats

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.estimation.diagnostics.diagnosis import UNLIKELY
from testbed.core.estimation.noise.coloured_noise import (
    averaged,
    averaged_fit,
    constants,
    square_of_last,
)
from testbed.core.estimation.noise.errors_in_variables import Quantization, correct_attenuation
from testbed.core.estimation.noise.fits import Fits, NoiseFit, weighted_fits, whitened_fits
from testbed.core.estimation.noise.lagged_products import (
    LARGEST_ROOT,
    Autoregression,
    LaggedProducts,
    LaggedSums,
    NoiseMaker,
    Whitened,
    best_order,
    fit,
)
from testbed.core.estimation.noise.noise_model import (
    PeriodicResidual,
    PeriodicSums,
    TimeDelay,
    lateness,
    period_of,
)
from testbed.core.estimation.regression.passes import Surveyor
from testbed.core.estimation.regression.windows import Plan, Window, make_plan
from testbed.core.kernel.layout import layout
from testbed.core.kernel.records import Signals
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import open_source
from tests.helpers.measured import measured
from tests.helpers.runs import robot
from tests.helpers.strategies import rngs

LAGS = 6
TRUTH = np.array([1.0, -2.0, 0.5])
SIGMA = np.array([0.1, 1.0, 0.3, 2.0])
WHITE = Autoregression(np.zeros((4, 0)), SIGMA)
SLOW = Autoregression(np.full((4, 1), 0.9), SIGMA)


def products(*sequences: Array, cut: int = 10**9) -> LaggedProducts:
    """Of rows, (C, M, p) each, that were not recorded in one."""
    sums = LaggedSums(LAGS)
    for rows in sequences:
        sums.pause()
        for first in range(0, rows.shape[1], cut):
            sums.add(rows[:, first : first + cut])
    return sums.finish()


def problem(seed: int, noise: Autoregression, rows: int = 400) -> Array:
    """Slow columns, and what they and noise make of TRUTH: (C, rows, 5) with ones."""
    rng, t = np.random.default_rng(seed), np.arange(rows) / 10
    waves, phases = rng.uniform(0.1, 2.0, (4, 3)), rng.uniform(0, 6, (4, 1, 3))
    columns = np.sin(waves[:, None] * t[:, None] + phases)
    made = NoiseMaker(noise, 1, rng).rows(rows)
    return np.concatenate([columns, columns @ TRUTH[:, None] + made, np.ones_like(made)], axis=2)


def whitened(rows: Array, a: Array) -> Array:
    """What of rows does not follow from those before, (C, M - order, p)."""
    p, last = a.shape[1], rows.shape[1]
    parts = (a[:, i, None, None] * rows[:, p - 1 - i : last - 1 - i] for i in range(p))
    return np.asarray(rows[:, p:] - sum(parts))


def by_channel(found: LaggedProducts, a: Array) -> Array:
    """Products of whitened rows, (C, p, p): a whitening for each channel, that counts it alone."""
    return Whitened(found, np.repeat(a[None], len(a), axis=0)).sums(np.eye(len(a)))


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
    rows = NoiseMaker(noise, 1, np.random.default_rng(0)).rows(100_000)[..., 0]
    assert best_order(moments(rows), rows.shape[1] - LAGS) in (3, 4, 5)
    np.testing.assert_allclose(fit(moments(rows), 3), noise.coefficients, atol=0.03)
    left = whitened(rows[..., None], noise.coefficients)[..., 0]
    np.testing.assert_allclose(left.std(axis=1), noise.sigma, rtol=0.02)
    np.testing.assert_allclose(noise.memory, -1 / np.log([0.9, 0.7]))
    pieces = NoiseMaker(noise, 1, np.random.default_rng(0))
    cut = np.concatenate([pieces.rows(20), pieces.rows(30)], axis=1)[..., 0]
    np.testing.assert_array_equal(cut, rows[:, :50])


def test_noise_that_no_model_has_is_met() -> None:
    """It is stationary from its first row, never grows, and may be absent."""
    lasting = Autoregression(np.array([[0.97]]), np.array([np.sqrt(1 - 0.97**2)]))
    rows = NoiseMaker(lasting, 4000, np.random.default_rng(0)).rows(60)[0]
    np.testing.assert_allclose(rows.std(axis=1), 1.0, atol=0.06)
    growing = 1.05 ** np.arange(200)[None] + 1e-3 * np.random.default_rng(0).normal(size=(1, 200))
    held = Autoregression(fit(moments(growing), 2), np.ones(1))
    assert 0 < held.memory[0] <= -1 / np.log(LARGEST_ROOT) * (1 + 1e-9)
    assert not fit(np.zeros((2, LAGS + 1, LAGS + 1)), 3).any()
    assert not WHITE.memory.any()


@given(rngs, st.lists(st.integers(LAGS, 40), min_size=1, max_size=4), st.integers(1, 50))
def test_products_are_those_of_the_rows(
    rng: np.random.Generator, counts: list[int], cut: int
) -> None:
    """However they are cut; rows after a pause have none before. Else long recordings differ."""
    each = [rng.normal(size=(3, count, 5)) for count in counts]
    found, maps = products(*each, cut=cut), rng.normal(size=(3, 5, 2))
    inner = rng.normal(size=(5, 5))
    inner += inner.T
    combined = products(*(rows @ maps for rows in each))
    assert found.rows == sum(counts)
    for order in range(LAGS + 1):
        long = [rows for rows in each if rows.shape[1] > order]
        assert found.after(order) == sum(rows.shape[1] - order for rows in long)
        a = rng.uniform(-0.5, 0.5, (3, order))
        parts = (whitened(rows, a) for rows in long)
        white = sum((part.swapaxes(1, 2) @ part for part in parts), np.zeros((3, 5, 5)))
        np.testing.assert_allclose(by_channel(found, a), white, atol=1e-10)
        alone = Whitened(found, a[None]).sums(np.ones((1, 3)))[0]
        np.testing.assert_allclose(alone, white.sum(axis=0), atol=1e-10)
        wanted = np.zeros((3, order + 1, order + 1))
        for rows in long:
            part = np.array([rows[:, order - i : rows.shape[1] - i] for i in range(order + 1)])
            wanted += np.einsum("ictp,pq,jctq->cij", part, inner, part)
        np.testing.assert_allclose(found.moments(inner[None], order)[0], wanted, atol=1e-9)
    np.testing.assert_allclose(
        by_channel(found.combined(maps), a), by_channel(combined, a), atol=1e-10
    )


def test_the_whitened_fit_is_least_squares_of_whitened_rows() -> None:
    block = problem(0, SLOW)
    (found,) = whitened_fits(products(block))
    white = whitened(block, found.noise.coefficients) / found.noise.sigma[:, None, None]
    rows = white.reshape(-1, 5)
    expected, *_ = np.linalg.lstsq(rows[:, :3], rows[:, 3], rcond=None)
    np.testing.assert_allclose(found.values, expected, rtol=1e-3)  # weights of a round before
    normal = rows[:, :3].T @ rows[:, :3]
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal), rtol=1e-9)
    turn = np.random.default_rng(6).normal(size=(3, 3))
    (turned,) = whitened_fits(products(block), lead=linalg.block_diag(turn, np.eye(2)))
    np.testing.assert_allclose(turn @ turned.values, found.values, rtol=1e-9)


def test_constants_are_found_apart_from_the_parameters() -> None:
    """Those that a parameter imitates are not told; the others are, to their sigmas."""
    block, bias = problem(0, WHITE, rows=2000), np.array([0.3, -1.0, 0.2, 3.0])
    block[..., 0] = np.array([0.0, 0.0, 1.0, 0.0])[:, None]  # a constant in channel 2
    made = NoiseMaker(WHITE, 1, np.random.default_rng(5)).rows(2000)[..., 0]
    block[..., 3] = block[..., :3] @ TRUTH + bias[:, None] + made
    directions, imitating = constants(products(block))
    assert directions.shape == (4, 3)
    assert np.abs(directions[2]).max() < 1e-6
    hidden = np.abs(imitating[0])
    assert hidden[1:].max() < 1e-6 * hidden[0]
    (found,) = whitened_fits(products(block).with_constants(directions))
    told = directions @ found.values[3:]
    np.testing.assert_allclose(told[[0, 1, 3]], bias[[0, 1, 3]], atol=0.2)
    there_is = np.linalg.solve(found.covariance[3:, 3:], found.values[3:]) @ found.values[3:]
    assert square_of_last(found, 3) == pytest.approx(there_is)


def slow_columns(seed: int, size: Array, rows: int = 4000) -> tuple[LaggedProducts, LaggedProducts]:
    """Columns seen with noise, (3,), and products of other noise of the same size."""
    rng, start = np.random.default_rng(seed), np.array([0.7, -1.0, 0.0])
    block = problem(seed, Autoregression(np.full((4, 1), 0.9), 0.3 * np.sqrt(SIGMA)), rows)
    seen = block[..., :3] + size * rng.normal(size=(4, rows, 3))
    made, ones = size * rng.normal(size=seen.shape), block[..., 4:]
    left = block[..., 3:4] - seen @ start[:, None]
    noise = np.concatenate([made, -made @ start[:, None], 0 * ones], axis=2)
    return products(np.concatenate([seen, left, ones], axis=2)), products(noise)


@pytest.mark.parametrize(("fits", "size"), [(whitened_fits, 0.015), (weighted_fits, 0.2)])
def test_what_noise_of_the_columns_draws_to_zero_comes_back(fits: Fits, size: float) -> None:
    """Else an estimate of many rows is wrong by several of its sigmas."""
    left, before, after = TRUTH - np.array([0.7, -1.0, 0.0]), [], []

    def scores(found: NoiseFit) -> Array:
        return np.asarray((found.values - left) / np.sqrt(np.diagonal(found.covariance)))

    for seed in range(12):
        rows, made = slow_columns(seed, np.full(3, size))
        (plain,) = fits(rows, None)
        better = correct_attenuation(plain, made)
        assert not better.noise_limited(np.eye(3)).any()
        before.append(scores(plain))
        after.append(scores(better.found))
    assert np.abs(np.mean(before, axis=0)).max() > 2.0
    assert np.abs(np.mean(after, axis=0)).max() < 1.2
    assert 0.6 < np.sqrt(np.mean(np.square(after))) < 1.5


def test_columns_without_noise_stay_and_drowned_ones_are_named() -> None:
    """No estimate runs away, no sigma shrinks."""
    for size in ([0.0, 0.0, 0.0], [30.0, 1e-3, 1e-3], [1e-3, 1e-3, 30.0]):
        rows, made = slow_columns(1, np.array(size), 600)
        (plain,) = whitened_fits(rows)
        better = correct_attenuation(plain, made)
        np.testing.assert_array_equal(better.noise_limited(np.eye(3)), np.array(size) > 1)
        added = better.found.covariance - plain.covariance
        assert np.linalg.eigvalsh(added).min() > -1e-12
        assert np.isfinite(better.found.values).all()
        if not any(size):
            np.testing.assert_allclose(better.found.values, plain.values, rtol=1e-12)


def test_two_models_answers_are_averaged_as_a_mixture() -> None:
    """The covariance of a mixture by its definition; a constant that is clear is taken."""
    means = np.array([1.0, 2.0, 0.0]), np.array([2.0, 1.5, -1.0])
    spreads = np.diag([0.5, 0.5, 0.0]), 2.0 * np.eye(3)
    alone, beside = (
        NoiseFit(mean[:k], spread[:k, :k], WHITE, WHITE, spread[:k, :k])
        for k, mean, spread in zip((2, 3), means, spreads, strict=True)
    )
    found = averaged(alone, beside, 0.3)
    mean = 0.7 * means[0] + 0.3 * means[1]
    second = 0.7 * (spreads[0] + np.outer(means[0], means[0]))
    second += 0.3 * (spreads[1] + np.outer(means[1], means[1]))
    np.testing.assert_allclose(found.values, mean)
    np.testing.assert_allclose(found.covariance, second - np.outer(mean, mean), atol=1e-12)
    shifted = problem(0, WHITE)
    shifted[..., 3] += 5.0
    clear = averaged_fit(products(shifted), None, whole=True)
    assert clear.weight > 0.99
    np.testing.assert_allclose(clear.directions @ clear.found.values[3:], 5.0, atol=1.0)
    weights = [averaged_fit(products(problem(s, WHITE)), None, whole=True).weight for s in range(9)]
    assert np.median(weights) < 0.5
    few = averaged_fit(products(shifted[:, :40]), None, whole=True)
    assert (few.directions.shape, few.weight) == ((4, 0), 0.0)


SIX = Autoregression(np.zeros((6, 0)), np.arange(1.0, 7.0))
SIX_COLOURED = Autoregression(np.tile([0.6, 0.2], (6, 1)), np.ones(6))


def made(noise: Autoregression, rows: int, seed: int) -> Array:
    """Noise, (C, rows)."""
    return NoiseMaker(noise, 1, np.random.default_rng(seed)).rows(rows)[..., 0]


def repetition(noise: Autoregression, left: Array, cut: int = 10**9) -> PeriodicResidual | None:
    """What is found in residuals of a motion with a period of 100 rows, 10 s."""
    sums = PeriodicSums(noise, 100, 10.0)
    for first in range(0, left.shape[1], cut):
        sums.add(left[:, first : first + cut])
    return sums.found()


def test_chances_of_repetition_are_no_smaller_than_they_say() -> None:
    """Else every fourth good recording is called wrong; nor are they useless."""
    for noise in (SIX, SIX_COLOURED):
        found = [repetition(noise, made(noise, 200, seed)) for seed in range(150)]
        chances = np.array([each.chance for each in found if each is not None])
        for level in (0.05, 0.5, 0.95):
            share = np.mean(chances < level)
            assert share < level + 4 * np.sqrt(level * (1 - level) / len(chances))
        assert np.mean(chances < 0.5) > 0.2
        assert repetition(noise, made(noise, 104, 1)) is None  # too few rows
    alone = Autoregression(np.zeros((1, 0)), np.ones(1))
    for seed in range(9):  # of one channel: by the normal law, for two looks
        one = repetition(alone, made(alone, 200, seed))
        assert one is not None
        assert one.chance == pytest.approx(min(1.0, 2 * stats.norm.sf(10 * one.share[0])))


@pytest.mark.parametrize(("noise", "periods"), [(SIX, 2), (SIX_COLOURED, 5)])
def test_what_repeats_is_found_with_its_share(noise: Autoregression, periods: int) -> None:
    """In one channel twice as large as its noise, four fifths repeat; however rows are cut."""
    alone = Autoregression(noise.coefficients, np.where(np.arange(6) == 2, noise.sigma, 0.0))
    left = made(noise, 100 * periods, 3) + 2 * np.tile(made(alone, 100, 5), periods)
    whole = repetition(noise, left)
    assert whole is not None
    assert (whole.period, whole.chance < 1e-4) == (10.0, True)
    shares = np.array(whole.share)
    assert abs(shares[2] - 0.8) < 0.1
    assert (np.abs(np.delete(shares, 2)) < 0.4).all()
    for cut in (1, 7, 150):
        again = repetition(noise, left, cut)
        assert again is not None
        np.testing.assert_allclose(again.share, shares, rtol=1e-11)


@given(rngs, st.integers(200, 2000), st.integers(1, 8))
def test_the_period_of_a_motion_is_found(
    rng: np.random.Generator, period: int, joints: int
) -> None:
    """Of a Fourier series seen by encoders, beside joints that stand still; where it is over."""
    phase = 2 * np.pi * np.arange(2 * period + 7)[:, None, None] / period * np.arange(1, 6)
    size = rng.normal(size=(2, joints, 5))
    wave = (size[0] * np.sin(phase) + size[1] * np.cos(phase)).sum(axis=2)
    still = np.zeros((len(wave), 1))
    seen = np.hstack([wave, still, still]) + 1e-3 * rng.normal(size=(len(wave), joints + 2))
    seen[:, -1] = 0.0
    assert period_of(seen) == pytest.approx(period, abs=2)
    assert period_of(seen[: int(1.4 * period)]) is None
    assert period_of(np.cumsum(rng.normal(size=(3000, 2)), axis=0)) is None
    turning = np.array([[1.0], [-1.0]] * 10)
    assert period_of(turning) == 2
    for odd in (turning[:3], np.ones((20, 2))):  # too few samples to repeat, and rest
        assert period_of(odd) is None


def late_by(delay: float, seed: int, gaps: float = 0.0, slow: float = 0.0) -> LaggedProducts:
    """Two channels of slow columns at 10 Hz, measured late; noise that goes on to next rows."""
    rng, time = np.random.default_rng(seed), np.arange(600) / 10
    waves, phases = rng.uniform(0.1, 0.8, (2, 1, 3)), rng.uniform(0, 6, (2, 1, 3))
    columns, moved = (
        np.sin(2 * np.pi * waves * at[:, None] + phases) for at in (time, time - delay)
    )
    noise = Autoregression(np.full((2, 1), slow), np.full(2, 0.05 * np.sqrt(1 - slow**2)))
    measured = (moved @ TRUTH)[..., None] + NoiseMaker(noise, 1, rng).rows(600)
    kept = rng.random((2, 600, 1)) >= gaps
    sums = LaggedSums(6)
    sums.add(np.concatenate([columns, measured, np.ones_like(measured)], axis=2) * kept)
    return sums.finish()


def delay_in(given: LaggedProducts, start: Array) -> TimeDelay:
    """As an estimate goes about it: residuals are those of a first solution."""
    moved = np.eye(5)
    moved[:3, 3] = -start
    left = given.combined(moved)
    late = lateness(left, weighted_fits(left)[0], start, 1.0, 10.0)
    assert late is not None
    return late


def test_a_delay_is_found_from_anywhere() -> None:
    """Differences over two rows are a little less than slopes: it seems a little more."""
    for delay in (0.02, -0.02, 0.005):
        for start in (np.zeros(3), TRUTH):
            late = delay_in(late_by(delay, 1), start)
            assert late.delay == pytest.approx(delay, rel=0.15, abs=3 * late.sigma)
            assert abs(late.z) > UNLIKELY
    beside_gaps = delay_in(late_by(0.02, 2, gaps=0.1), np.zeros(3))
    assert beside_gaps.z > UNLIKELY
    assert 0 < beside_gaps.delay < 0.025


def test_chance_makes_no_delays() -> None:
    """Nor do rows that were dropped, or noise that goes on: a good recording would be shifted."""
    for gaps, slow in ((0.1, 0.0), (0.0, 0.6)):
        z = [delay_in(late_by(0.0, seed, gaps, slow), TRUTH).z for seed in range(30)]
        assert 0.6 < np.std(z) < 1.3
        assert np.max(np.abs(z)) < UNLIKELY


COUNT = 1e-3


def rounded(recording: Recording, count: float = COUNT) -> Recording:
    """As coarse encoders show it."""
    return replace(recording, position=count * np.round(recording.position / count))


def planned(tree: tb.Tree, recording: Recording) -> Plan:
    """How the recording is gone through."""
    rows = layout(tree.without_inertias(), tb.minimal_set(tree, "reaction"))
    return make_plan(open_source(recording), rows, tb.pedestal_wrench(tree), tb.Settings())


def signals_of(plan: Plan, window: Window) -> Signals:
    return plan.signals(plan.source.part(window.first, window.last), window)


def counts_of(tree: tb.Tree, recording: Recording) -> Array:
    """Encoders' counts that are seen, (n,)."""
    plan = planned(tree, recording)
    surveyor = Surveyor(plan.source.samples)
    for window in plan.windows():
        surveyor.look(signals_of(plan, window), window.first, plan.own(window))
    return np.asarray(surveyor.survey().encoder_count)


def kernels_of(plan: Plan) -> Array:
    """What a row sees of samples: positions, velocities, accelerations."""
    return np.stack([np.convolve(taps, plan.weights) for taps in plan.taps])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_whole_counts_are_told_from_noise(name: str) -> None:
    """With a tenth of a count of noise, beside a joint that rests; not with a whole one."""
    tree = robot(name)
    for seed, speed in enumerate((0.1, 1.0)):
        fine = measured(tree, seed, speed=speed, duration=10.0)
        for count in (COUNT, 2 * np.pi / 4096):
            moves = np.arange(tree.n) != 2
            resting = replace(fine, position=fine.position * moves)
            found = counts_of(tree, rounded(resting, count))
            np.testing.assert_allclose(np.delete(found, 2), count, rtol=1e-6)
            assert found[2] == 0
        for other in (rounded(fine, 1e-4), measured(tree, seed, speed=speed, noise=0.0)):
            assert not counts_of(tree, other).any()


def test_made_errors_of_counts_are_like_real_ones() -> None:
    """Else sigma of a coarse encoder is too small: as large, but of other numbers; they repeat."""
    tree = robot("puma")
    exact = measured(tree, 3, duration=60.0, speed=0.2, noise=0.0)
    plan = planned(tree, rounded(exact))
    zeros = np.random.default_rng(0).uniform(size=(10, 1, tree.n))
    shown = exact.position / COUNT + zeros
    off, kernels = COUNT * (np.round(shown) - shown), kernels_of(plan)
    around = sliding_window_view(off, kernels.shape[1], axis=1)
    real = np.moveaxis(around[:, :: plan.step] @ kernels.T, 3, 1)[:, :, : plan.rows]
    (window,) = plan.windows()
    counts, signals = Quantization(plan, np.full(tree.n, COUNT)), signals_of(plan, window)
    lasting = counts.lasting(signals, 9)
    made = np.array([*lasting, counts.changing(signals, window.row)])
    ratio = np.sqrt((made**2).mean(axis=(0, 2)) / (real**2).mean(axis=(0, 2)))
    np.testing.assert_allclose(ratio, 1, atol=0.5)
    np.testing.assert_allclose(ratio.mean(axis=1), 1, atol=0.2)
    alike = (real * made).sum() / np.sqrt((real**2).sum() * (made**2).sum())
    assert abs(alike) < 0.15
    period = round(10.0 * plan.rate)
    apart = ((made[:, :, period:] - made[:, :, :-period]) ** 2).sum(axis=(1, 2, 3))
    part = apart / (2 * (made**2).sum(axis=(1, 2, 3)))
    assert part[:-1].max() < 0.2
    assert part[-1] > 0.6


@pytest.mark.slow
def test_sigma_counts_what_coarse_encoders_do() -> None:
    """Of slow motions that repeat, under slow noise; nothing is said of finer encoders."""
    tree = robot("puma")
    slow = measured(tree, 1, duration=60.0, rate=250.0, speed=0.2, memory=0.993)
    coarse, fine = (tb.identify(tree, each, zeros=True) for each in (rounded(slow), slow))
    truth = coarse.minimal.values(tb.barycentric(tree))
    assert np.sqrt(np.mean(((coarse.values - truth) / coarse.sigma) ** 2)) < 1.5
    for found, seen in ((coarse, True), (fine, False)):
        assert found.noise is not None
        assert found.noise.steps_matter == seen
        np.testing.assert_allclose(found.noise.least_counts, [COUNT] * 3 * seen, rtol=1e-6)
        said = [d.text for d in found.diagnostics if d.code == "encoder.resolution"]
        assert [all(n in text for n in (*tree.names, f"{COUNT:g}")) for text in said] == [
            True
        ] * seen
    assert (coarse.sigma > fine.sigma).mean() > 0.8
