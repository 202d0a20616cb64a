"""Estimates under coloured noise, through the front door."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import TestbedError
from testbed.identification.estimate import METHODS, Estimate
from tests.helpers.ideal import ideal
from tests.helpers.measured import measured
from tests.helpers.paths import GOLDEN, ROOT

pytestmark = pytest.mark.slow

ROBOTS = {
    name: GOLDEN / f"robots/{name}.urdf"
    for name in ("ur5", "gantry_ppp_rrr", "two_trunks", "humanoid_pelvis")
} | {"puma": ROOT / "models/puma562.xml"}


def load(robot: str) -> tb.Tree:
    return tb.load_tree(ROBOTS[robot], weld_root=robot.startswith("humanoid"))


def scores(tree: tb.Tree, estimate: Estimate) -> np.ndarray:
    """Errors of the minimal parameters in units of sigma."""
    base = estimate.base
    return np.asarray((base.values - estimate.minimal.values(tb.barycentric(tree))) / base.sigma)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_sigma_is_the_size_of_the_error(robot: str, method: str) -> None:
    """White and coloured noise; a robot's parameters pooled."""
    tree = load(robot)
    for memory in (0.0, 0.98):
        estimate = tb.identify(tree, measured(tree, 1, memory=memory), method)  # type: ignore[arg-type]
        spread = float(np.sqrt(np.mean(scores(tree, estimate) ** 2)))
        assert 0.4 < spread < 1.7
        assert estimate.noise is not None
        assert estimate.noise.factor >= 1.0


@pytest.mark.parametrize("robot", ["puma", "ur5", "gantry_ppp_rrr"])
def test_sigma_holds_where_noise_of_accelerations_passes_the_filter(robot: str) -> None:
    """It draws plain least squares to zero, by up to 20 sigma here."""
    tree, settings = load(robot), tb.Settings(cutoff=20.0)
    for seed in (1, 2):
        recording = measured(tree, seed, duration=60.0)
        estimate = tb.identify(tree, recording, "internal", settings=settings)
        assert 0.4 < float(np.sqrt(np.mean(scores(tree, estimate) ** 2))) < 1.7


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("robot", ["puma", "gantry_ppp_rrr", "two_trunks"])
def test_perfect_recordings_give_the_truth(robot: str, method: str) -> None:
    """Whitening noise that is not there does no harm."""
    tree = load(robot).without_friction()
    settings = tb.Settings(position_cutoff="off", cutoff=5.0, terms=())
    estimate = tb.identify(tree, ideal(tree), method, settings=settings)  # type: ignore[arg-type]
    truth = estimate.minimal.values(tb.barycentric(tree))
    np.testing.assert_allclose(estimate.base.values, truth, atol=1e-10 * np.abs(truth).max())
    assert np.isfinite(estimate.covariance).all()


@pytest.mark.parametrize("robot", ["puma", "ur5"])
def test_a_constant_of_the_plate_is_found_and_told(robot: str) -> None:
    """What it is, and what it makes unsure; without one, nothing is said."""
    tree = load(robot)
    clean = measured(tree, 3)
    bias = np.array([2.0, -2.0, 0.0, 0.5, 0.5, -0.5])
    off = replace(clean, wrench=clean.measured("wrench") + bias)
    before, after = tb.identify(tree, clean), tb.identify(tree, off)
    assert not [line for line in before.warnings if "zero is off" in line]
    (line,) = [line for line in after.warnings if "zero is off" in line]
    noise = after.noise
    assert noise is not None
    assert noise.hidden == ("mbar1",)
    assert "mbar1 cannot be told" in line
    told = noise.bias_sigma > 0
    assert told.sum() >= 5
    np.testing.assert_array_less(np.abs(noise.bias - bias)[told], 5 * noise.bias_sigma[told])
    assert np.abs(scores(tree, after)).max() < 5
    np.testing.assert_allclose(after.residual, before.residual, rtol=0.1)


def test_what_noise_of_the_encoders_drowns_is_said() -> None:
    """Of a slow motion under slow noise of the plate; with finer encoders nothing is said."""
    tree = load("gantry_ppp_rrr")
    fine = measured(tree, 0, duration=40.0, speed=0.25, memory=0.98, noise=0.1)
    coarse = 5e-4 * np.random.default_rng(0).normal(size=fine.position.shape)
    for extra, told in ((0.0, 0), (coarse, 1)):
        estimate = tb.identify(tree, replace(fine, position=fine.position + extra))
        assert estimate.noise is not None
        lines = [line for line in estimate.warnings if "noise of the encoders" in line]
        assert len(lines) == bool(estimate.noise.drowned) == told


def test_a_sigma_is_the_same_every_time(puma: tb.Tree) -> None:
    recording = measured(puma, 0, memory=0.9)
    one, other = (tb.identify(puma, recording) for _ in range(2))
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_the_memory_of_noise_is_told(puma: tb.Tree) -> None:
    """White noise forgets at once; noise of 0.99 from sample to sample in half a second."""
    for memory, least, most in ((0.0, 0.0, 0.3), (0.99, 0.25, 1.5)):
        estimate = tb.identify(puma, measured(puma, 0, memory=memory, duration=120.0, noise=3.0))
        assert estimate.noise is not None
        assert least <= np.median(estimate.noise.memory) <= most


def test_noise_that_hangs_together_across_channels_is_whitened_too(puma: tb.Tree) -> None:
    """By the covariance of all channels' residuals, and by a given one."""
    clean = measured(puma, 0, noise=0.1)
    rng = np.random.default_rng(0)
    common = np.cumsum(rng.normal(size=clean.samples)) * 0.01
    shared = common[:, None] * np.array([5.0, 0, 0, 0, 1.0, 0])
    noisy = replace(clean, wrench=clean.measured("wrench") + shared)
    for weights in ("full", np.diag([1.0, 1, 1, 0.04, 0.04, 0.04]).tolist()):
        estimate = tb.identify(puma, noisy, zeros=True, settings=tb.Settings(weights=weights))
        assert np.abs(scores(puma, estimate)).max() < 5


def test_rows_near_reversals_do_not_count(puma: tb.Tree, tmp_path: Path) -> None:
    """The further the reach, the fewer the rows; beyond the filter's own there is nothing."""
    recording = measured(puma)
    counts = []
    for reach in (0.0, 0.05, None, 0.24, 10.0):
        settings = tb.Settings(reversal_reach=reach)
        counts.append(sum(tb.identify(puma, recording, "internal", settings=settings).samples))
    assert counts == sorted(counts, reverse=True)
    assert len(set(counts)) >= 4
    assert counts[-1] > 0


def test_dry_friction_that_jumps_at_reversals_does_not_enter(puma: tb.Tree) -> None:
    """Torques in stiction differ from the law in the deadband only: at the right reach no more."""
    clean = measured(puma, noise=1e-3, duration=40.0)
    slow = tb.Settings()
    speed = np.gradient(clean.position, clean.time, axis=0)
    stuck = np.where(np.abs(speed) < slow.deadband, 20.0, 0.0)  # a force that no law has
    recording = replace(clean, torque=clean.measured("torque") + stuck)
    found = {}
    for reach in (0.0, None):
        settings = tb.Settings(reversal_reach=reach, zeros=True)
        estimate = tb.identify(puma, recording, "internal", settings=settings)
        truth = estimate.minimal.values(tb.barycentric(puma))
        found[reach] = float(np.abs(estimate.base.values / truth - 1).max())
    assert found[None] < 0.2 * found[0.0]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("robot", ["puma", "ur5", "gantry_ppp_rrr"])
def test_few_rows_are_enough_for_some_estimate_or_named(robot: str, method: str) -> None:
    """Whitening takes no more rows than there are."""
    tree = load(robot)
    recording = measured(tree)
    made = 0
    for samples in (160, 200, 240, 300, 400, 600, 1000):
        try:
            estimate = tb.identify(tree, recording.part(0, samples), method)  # type: ignore[arg-type]
        except TestbedError:
            continue
        made += 1
        assert np.isfinite(estimate.covariance).all()
    assert made >= 3


@pytest.mark.parametrize("robot", ["puma", "ur5"])
def test_residuals_are_about_as_large_as_the_noise(robot: str) -> None:
    """However slowly it wanders: the likeliest constant may lie far off. Of Fz the mass has it."""
    tree, others = load(robot), [0, 1, 3, 4, 5]
    for seed in range(12):
        noisy, quiet = (measured(tree, seed, memory=0.9983, noise=size) for size in (1.0, 0.0))
        noise = noisy.measured("wrench") - quiet.measured("wrench")
        ratio = tb.identify(tree, noisy).residual / noise.std(axis=0)
        np.testing.assert_array_less(ratio[others], 1.35)  # noise of the encoders adds
