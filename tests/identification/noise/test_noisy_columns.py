"""Made noise of the encoders does to the columns what real noise does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.dynamics.drive_set import drive_set
from testbed.dynamics.inverse_dynamics import pedestal_wrench
from testbed.identification.noise.noisy_columns import NoisyColumns, PositionNoise
from testbed.identification.passes import Passes
from testbed.identification.windows import Plan, make_plan
from testbed.kernel.layout import layout
from testbed.parameters.rules import Model
from testbed.recordings.recording import Recording
from testbed.recordings.source import open_source
from tests.helpers.measured import measured
from tests.helpers.runs import ROBOTS, robot

SIZE = 2e-4


def planned(tree: tb.Tree, recording: Recording, model: Model = "reaction") -> Plan:
    minimal = tb.minimal_set(tree, model)
    terms = drive_set(tree, minimal, ("viscous", "rotor")).terms if model == "dynamic" else ()
    rows, settings = layout(tree.without_inertias(), minimal, terms), tb.Settings(deadband=0.0)
    return make_plan(open_source(recording), rows, pedestal_wrench(tree), settings)


def maker_of(plan: Plan, sigma: Array) -> NoisyColumns:
    """Of white noise, for each unknown's own column."""
    noise = PositionNoise(sigma, np.zeros_like(sigma))
    return NoisyColumns(plan, noise, np.eye(len(plan.layout.basis)))


def exact(tree: tb.Tree, duration: float) -> Recording:
    return measured(tree, 4, duration=duration, speed=0.3, noise=0.0)


def all_rows(plan: Plan, combined: Array) -> Array:
    passes = Passes(plan, 1, lambda done, total: None, 1)
    return np.concatenate([columns for columns, _ in passes.rows(combined)], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "least"), [("reaction", 1e-4), ("dynamic", 1e-3)])
@pytest.mark.parametrize("name", ROBOTS)
def test_columns_change_as_with_real_noise(name: str, model: Model, least: float) -> None:
    """As large, column by column, and as much alike from row to row.

    What moves noise into the filter's band, a coefficient that changes within it, is left out:
    it rules columns that change very little.
    """
    tree = robot(name)
    recording = exact(tree, 120.0)
    rng = np.random.default_rng(0)
    noise = SIZE * rng.normal(size=recording.position.shape)
    plan = planned(tree, recording, model)
    combined = np.eye(len(plan.layout.basis))
    noisy = planned(tree, replace(recording, position=recording.position + noise), model)
    real = all_rows(noisy, combined) - all_rows(plan, combined)
    maker = maker_of(noisy, np.full(tree.n, SIZE))
    made = np.concatenate(
        [maker(plan.signals(plan.source.part(w.first, w.last), w), w.row) for w in noisy.windows()],
        axis=1,
    )
    assert made.shape == real.shape
    for lag in (0, 1, 2):
        now, then = slice(lag, None), slice(None, made.shape[1] - lag)
        one, other = ((d[:, now] * d[:, then]).sum(axis=1) for d in (real, made))
        size = (real**2).sum(axis=1)
        some = size > least * size.max()
        np.testing.assert_allclose(
            (other / np.where(some, size, 1))[some], (one / np.where(some, size, 1))[some], atol=0.3
        )


def test_made_noise_has_the_spectrum_of_filtered_white_noise(puma: tb.Tree) -> None:
    """Variances and covariances of positions, velocities and accelerations at a row."""
    plan = planned(puma, exact(puma, 20.0))
    made = maker_of(plan, np.ones(3)).coordinates(0, 20_000)
    kernels = np.stack([np.convolve(taps, plan.weights) for taps in plan.taps])
    expected, found = kernels @ kernels.T, np.tensordot(made, made, ([1, 2], [1, 2])) / 60_000
    size = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        found / np.outer(size, size), expected / np.outer(size, size), atol=0.03
    )
    later = kernels[:, : -plan.step] @ kernels[:, plan.step :].T
    next_row = np.tensordot(made[:, 1:], made[:, :-1], ([1, 2], [1, 2])) / 60_000
    np.testing.assert_allclose(
        np.diagonal(next_row) / size**2, np.diagonal(later) / size**2, atol=0.03
    )


def test_made_noise_is_the_same_for_any_cut(puma: tb.Tree) -> None:
    plan = planned(puma, exact(puma, 20.0))
    maker = maker_of(plan, np.array([1.0, 2.0, 0.0]))
    whole = maker.coordinates(0, 700)
    parts = [maker.coordinates(first, 70) for first in range(0, 700, 70)]
    np.testing.assert_array_equal(whole, np.concatenate(parts, axis=1))
    assert not whole[..., 2].any()


@pytest.mark.parametrize("rate", [100.0, 130.0, 1000.0])
def test_any_sampling_rate_will_do(puma: tb.Tree, rate: float) -> None:
    recording = measured(puma, 1, duration=8.0, rate=rate, speed=0.3)
    plan = planned(puma, recording)
    made = maker_of(plan, np.ones(3)).coordinates(0, 5000)
    kernels = np.stack([np.convolve(taps, plan.weights) for taps in plan.taps])
    np.testing.assert_allclose((made**2).mean(axis=(1, 2)), (kernels**2).sum(axis=1), rtol=0.1)


def test_least_counts_are_of_joints_whose_encoders_count() -> None:
    none = np.zeros(3)
    assert PositionNoise(np.full(3, SIZE), none).least_counts == ()
    assert PositionNoise(none, np.array([0.0, SIZE, 0.0])).least_counts == (0.0, SIZE, 0.0)
