"""Encoders so coarse that they stand still from sample to sample: told, made again, counted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import pedestal_wrench
from testbed.identification.noise.counts import Counts
from testbed.identification.survey import Survey, Surveyor
from testbed.identification.windows import Plan, make_plan
from testbed.kernel.layout import layout
from testbed.recordings.recording import Recording
from testbed.recordings.source import open_source
from tests.helpers.measured import measured
from tests.helpers.runs import ROBOTS, robot

COUNT = 1e-3


def rounded(recording: Recording, count: float = COUNT) -> Recording:
    return replace(recording, position=count * np.round(recording.position / count))


def planned(tree: tb.Tree, recording: Recording) -> Plan:
    rows = layout(tree.without_inertias(), tb.minimal_set(tree, "reaction"))
    return make_plan(open_source(recording), rows, pedestal_wrench(tree), tb.Settings())


def surveyed(plan: Plan) -> Survey:
    surveyor = Surveyor(plan.source.samples)
    for window in plan.windows():
        signals = plan.signals(plan.source.part(window.first, window.last), window)
        surveyor.look(signals, window.first, plan.own(window))
    return surveyor.survey()


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_whole_counts_are_told_from_noise(name: str) -> None:
    """With a tenth of a count of noise; not with a whole one, nor without counts."""
    tree = robot(name)
    for seed, speed in enumerate((0.1, 0.3, 1.0)):
        fine = measured(tree, seed, speed=speed)
        for count in (COUNT, 2 * np.pi / 4096):
            found = surveyed(planned(tree, rounded(fine, count))).encoder_count
            np.testing.assert_allclose(found, count, rtol=1e-6)
        for other in (fine, rounded(fine, 1e-4), measured(tree, seed, speed=speed, noise=0.0)):
            assert not surveyed(planned(tree, other)).encoder_count.any()


def test_a_joint_that_rests_has_no_counts(puma: tb.Tree) -> None:
    """And hinders none of the others."""
    recording = rounded(measured(puma, 1, speed=0.3))
    position = recording.position.copy()
    position[:, 2] = position[0, 2]
    found = surveyed(planned(puma, replace(recording, position=position))).encoder_count
    np.testing.assert_allclose(np.delete(found, 2), COUNT, rtol=1e-6)
    assert found[2] == 0


def errors(plan: Plan, tree: tb.Tree) -> Iterator[Array]:
    """Made ones of ten kinds of zeros, (3, rows, n)."""
    counts = Counts(plan, np.full(tree.n, COUNT))
    (window,) = plan.windows()
    signals = plan.signals(plan.source.part(window.first, window.last), window)
    for replica in range(9):
        yield counts.lasting(signals, replica)
    yield counts.changing(signals, window.row)


@pytest.mark.parametrize("name", ROBOTS)
def test_made_errors_are_like_real_ones(name: str) -> None:
    """Of any zero of the encoders: as large, joint by joint; but of other numbers."""
    tree = robot(name)
    exact = measured(tree, 2, duration=40.0, speed=0.2, noise=0.0)
    plan = planned(tree, rounded(exact))
    kernels = np.stack([np.convolve(taps, plan.weights) for taps in plan.taps])
    zeros = np.random.default_rng(0).uniform(size=(10, 1, tree.n))
    counts = exact.position / COUNT + zeros
    off = COUNT * (np.round(counts) - counts)
    around = np.lib.stride_tricks.sliding_window_view(off, kernels.shape[1], axis=1)
    real = np.moveaxis(around[:, :: plan.step] @ kernels.T, 3, 1)[:, :, : plan.rows]
    made = np.array(list(errors(plan, tree)))
    squares, again = (real**2).mean(axis=(0, 2)), (made**2).mean(axis=(0, 2))
    ratio = np.sqrt(again / squares)
    np.testing.assert_allclose(ratio, 1, atol=0.5)
    np.testing.assert_allclose(ratio.mean(axis=1), 1, atol=0.2)
    alike = (real * made).sum() / np.sqrt((real**2).sum() * (made**2).sum())
    assert abs(alike) < 0.15


def test_errors_of_lasting_zeros_repeat_with_the_motion(puma: tb.Tree) -> None:
    """Those of changing zeros do not; the period of these motions is ten seconds."""
    plan = planned(puma, measured(puma, 3, duration=60.0, speed=0.2, noise=0.0))
    *lasting, changing = errors(plan, puma)
    period = round(10.0 * plan.rate)
    for made, repeats in ((lasting[0], True), (changing, False)):
        apart = made[:, period:] - made[:, :-period]
        part = (apart**2).sum() / (2 * (made**2).sum())
        assert part < 0.2 if repeats else part > 0.6


def scores(tree: tb.Tree, estimate: tb.Estimate) -> Array:
    truth = estimate.minimal.values(tb.barycentric(tree))
    return np.asarray((estimate.values - truth) / estimate.sigma)


@pytest.mark.slow
def test_sigma_counts_what_coarse_encoders_do(
    puma: tb.Tree, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of slow motions that repeat, under slow noise; it does not if that is taken for white."""
    told, before = [], []
    for seed in range(6):
        slow = measured(puma, seed, duration=60.0, rate=500.0, speed=0.2, memory=0.993)
        recording = rounded(slow)
        estimate = tb.identify(puma, recording, zeros=True)
        told.append(scores(puma, estimate))
        assert estimate.noise is not None
        assert estimate.noise.steps_matter
        np.testing.assert_allclose(estimate.noise.least_counts, COUNT, rtol=1e-6)
        (line,) = [line for line in estimate.warnings if line.startswith("coarse")]
        assert all(name in line for name in puma.names)
        repeats = [each for each in estimate.findings if "repeat with the motion" in each.found]
        assert all(each.causes[0] == "steps of coarse encoders" for each in repeats)
        with monkeypatch.context() as patch:
            patch.setattr("testbed.identification.survey.BETWEEN", 0.0)
            before.append(scores(puma, tb.identify(puma, recording, zeros=True)))
    assert np.sqrt(np.mean(np.square(told))) < 1.15
    assert np.sqrt(np.mean(np.square(before))) > 1.25


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_nothing_is_said_of_finer_encoders(name: str) -> None:
    tree = robot(name)
    estimate = tb.identify(tree, rounded(measured(tree, speed=0.3), 1e-4))
    assert estimate.noise is not None
    assert not estimate.noise.least_counts
    assert not [line for line in estimate.warnings if "coarse" in line]
