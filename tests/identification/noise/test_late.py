"""A signal that is late is told from noise by what is foretold before and after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.identification.diagnosis import UNLIKELY
from testbed.identification.noise.fits import weighted_fit
from testbed.identification.noise.lagged_products import LaggedProducts, LaggedSums
from testbed.identification.noise.late import Lateness, lateness

RATE = 10.0
TRUE = np.array([3.0, -2.0, 0.5])


def products(
    delay: float, seed: int, gaps: bool = False, noise: float = 0.05, slow: float = 0.0
) -> LaggedProducts:
    """Two channels of slow columns, measured late by so much; noise that goes on to next rows."""
    rng = np.random.default_rng(seed)
    time = np.arange(600) / RATE
    waves, phases = rng.uniform(0.1, 0.8, (2, 3)), rng.uniform(0, 6, (2, 3))

    def columns(at: Array) -> Array:
        return np.asarray(np.sin(2 * np.pi * waves[:, None] * at[:, None] + phases[:, None]))

    rest = rng.normal(size=(2, len(time)))
    for k in range(1, len(time)):
        rest[:, k] = slow * rest[:, k - 1] + np.sqrt(1 - slow**2) * rest[:, k]
    measured = columns(time - delay) @ TRUE + noise * rest
    ones = np.ones((2, len(time)))
    if gaps:
        ones[:, rng.random(len(time)) < 0.1] = 0.0
    rows = np.concatenate([columns(time), measured[..., None], np.ones((2, len(time), 1))], axis=2)
    sums = LaggedSums(6)
    sums.add(rows * ones[..., None])
    return sums.finish()


def found(given: LaggedProducts, start: Array) -> Lateness:
    """As an estimate goes about it: residuals are those of a first solution."""
    moved = np.eye(5)
    moved[:3, 3] = -start
    left = given.combined(moved)
    late = lateness(left, weighted_fit(left), start, 1.0, RATE)
    assert late is not None
    return late


@pytest.mark.parametrize("delay", [0.02, -0.02, 0.005])
@pytest.mark.parametrize("start", [np.zeros(3), TRUE], ids=["nothing", "truth"])
def test_a_delay_is_found(delay: float, start: Array) -> None:
    """Differences over two rows are a little less than slopes: the delay seems a little more."""
    late = found(products(delay, 1), start)
    assert late.delay == pytest.approx(delay, rel=0.15, abs=3 * late.sigma)
    assert abs(late.z) > UNLIKELY


def test_it_is_seen_beside_rows_that_were_dropped() -> None:
    late = found(products(0.02, 2, gaps=True), np.zeros(3))
    assert late.z > UNLIKELY
    assert 0 < late.delay < 0.025


@pytest.mark.slow
@pytest.mark.parametrize("gaps", [False, True])
def test_chance_makes_no_delays(gaps: bool) -> None:
    """Of variance one: 200 recordings."""
    z = [found(products(0.0, seed, gaps), TRUE).z for seed in range(100, 300)]
    assert np.std(z) == pytest.approx(1.0, abs=0.2)
    assert abs(np.mean(z)) < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("slow", [0.3, 0.6])
def test_nor_does_chance_that_goes_on(slow: float) -> None:
    z = [found(products(0.0, seed, slow=slow), TRUE).z for seed in range(300, 500)]
    assert 0.6 < np.std(z) < 1.25
    assert np.max(np.abs(z)) < UNLIKELY


def test_a_channel_whose_noise_is_foretold_wholly_counts_as_it_is() -> None:
    """Few rows, and a model of the noise that leaves nothing of them: that is no certainty."""
    left = products(0.0, 4)
    fit = weighted_fit(left)
    nothing = replace(fit.noise, sigma=np.array([0.0, fit.noise.sigma[1]]))
    sure = lateness(left, replace(fit, noise=nothing), np.zeros(3), 1.0, RATE)
    plain = lateness(left, fit, np.zeros(3), 1.0, RATE)
    assert sure == plain


def test_too_few_lags_say_nothing() -> None:
    given = products(0.0, 3).at_once
    assert lateness(given, weighted_fit(products(0.0, 3)), np.zeros(3), 1.0, RATE) is None


def test_two_lags_are_needed() -> None:
    """Of one, no second difference can be had."""
    given = products(0.0, 3)
    one = replace(given, products=given.products[:2])
    assert one.lags == 1
    assert lateness(one, weighted_fit(given), np.zeros(3), 1.0, RATE) is None
