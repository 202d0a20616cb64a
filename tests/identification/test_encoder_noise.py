"""Noise and whole counts of the encoders are made again as they are, and sigma counts them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

import testbed as tb
from testbed.arrays import Array
from testbed.identification.noise.counts import Counts
from testbed.identification.survey import Surveyor
from testbed.identification.windows import Plan, Window, make_plan
from testbed.kernel.layout import layout
from testbed.kernel.records import Signals
from testbed.recordings.recording import Recording
from testbed.recordings.source import open_source
from tests.helpers.measured import measured
from tests.helpers.runs import robot

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
    """As large, joint by joint, but of other numbers; of lasting zeros, they repeat."""
    tree = robot("puma")
    exact = measured(tree, 3, duration=60.0, speed=0.2, noise=0.0)
    plan = planned(tree, rounded(exact))
    zeros = np.random.default_rng(0).uniform(size=(10, 1, tree.n))
    shown = exact.position / COUNT + zeros
    off, kernels = COUNT * (np.round(shown) - shown), kernels_of(plan)
    around = sliding_window_view(off, kernels.shape[1], axis=1)
    real = np.moveaxis(around[:, :: plan.step] @ kernels.T, 3, 1)[:, :, : plan.rows]
    (window,) = plan.windows()
    counts, signals = Counts(plan, np.full(tree.n, COUNT)), signals_of(plan, window)
    lasting = [counts.lasting(signals, replica) for replica in range(9)]
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
        (line,) = [w for w in found.warnings if all(n in w for n in tree.names)] or [""]
        assert (f"{COUNT:g}" in line) == seen
    assert (coarse.sigma > fine.sigma).mean() > 0.8
