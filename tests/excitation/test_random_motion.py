"""Random motions stay within the limits, and use them; the best is the best of those drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.errors import InfeasibleMotion
from testbed.excitation.fourier import Fourier
from testbed.excitation.limits import limits_of, usage
from testbed.excitation.proof import Rules
from testbed.excitation.random_motion import MARGIN, best_motion, random_motion, relative_sigma
from tests.helpers.robots import random_robot

PLATE = np.repeat([0.5, 0.1], 3)


@pytest.mark.parametrize("seed", range(20))
def test_random_motions_stay_within_every_limit(seed: int, puma: tb.Tree) -> None:
    limits = limits_of(puma, {"elbow": 1.0}, {"waist": 3.0})
    motion = random_motion(puma, limits, 0.1, 5, np.random.default_rng(seed))
    fine = motion.at(np.linspace(0, motion.period, 5000))
    for name, share in usage(puma, fine, limits).items():
        assert share.max() <= MARGIN * 1.01, name  # a finer grid finds slightly higher peaks
    assert np.abs(fine.qd[:, 2]).max() <= 1.0
    assert np.abs(fine.qdd[:, 0]).max() <= 3.0


def test_a_robot_too_weak_for_its_own_weight_is_told_so(puma: tb.Tree) -> None:
    weak = replace(puma, joints=tuple(replace(j, max_effort=0.1) for j in puma.joints))
    with pytest.raises(InfeasibleMotion, match="shoulder"):
        random_motion(weak, limits_of(weak), 0.1, 5, np.random.default_rng(0))


def free_tree(seed: int, n: int = 4) -> tb.Tree:
    """Joints of both kinds without limits on their efforts."""
    return random_robot(np.random.default_rng(seed), n).tree()


@pytest.mark.parametrize("seed", range(10))
def test_every_joint_goes_to_its_nearest_limit(seed: int) -> None:
    """Speed, acceleration, or how far it swings: one of them is used up to the margin."""
    tree = free_tree(seed)
    limits = limits_of(tree)
    motion = random_motion(tree, limits, 0.1, 5, np.random.default_rng(seed))
    fine = motion.at(np.linspace(0, motion.period, 5000))
    swing = np.abs(fine.q - motion.offset).max(axis=0) / ((limits.high - limits.low) / 2)
    used = usage(tree, fine, limits)
    nearest = np.max([swing, used["velocity"], used["acceleration"]], axis=0)
    np.testing.assert_allclose(nearest, MARGIN, rtol=0.01)
    assert used["position"].max() <= MARGIN * 1.01


def test_weak_motors_slow_a_motion_no_more_than_they_must(puma: tb.Tree) -> None:
    """What is as fast as the efforts allow exceeds them a step of a ninth faster."""
    puma = replace(puma, gravity=np.zeros(3))  # efforts then fall with the speed
    weak = replace(puma, joints=tuple(replace(j, max_effort=12.0) for j in puma.joints))
    limits = limits_of(weak)
    slowed = 0
    for seed in range(5):
        free = random_motion(puma, limits_of(puma), 0.1, 5, np.random.default_rng(seed))
        slow = random_motion(weak, limits, 0.1, 5, np.random.default_rng(seed))
        shrunk = slow.sine / free.sine
        assert np.ptp(shrunk) < 1e-12
        steps = np.log(shrunk[0, 0]) / np.log(0.9)
        assert steps == pytest.approx(round(steps), abs=1e-9)
        times = np.linspace(0, slow.period, 500, endpoint=False)
        assert usage(weak, slow.at(times), limits)["effort"].max() <= MARGIN
        if steps > 0.5:
            slowed += 1
            faster = replace(slow, sine=slow.sine / 0.9, cosine=slow.cosine / 0.9)
            assert usage(weak, faster.at(times), limits)["effort"].max() > MARGIN
    assert slowed > 1


def test_amplitudes_fall_with_the_harmonic_and_offsets_stray() -> None:
    """As 1/k in the mean; offsets lie up to a quarter of the range from its middle."""
    tree = free_tree(1, 6)
    limits = limits_of(tree, dict.fromkeys(tree.names, 0.05))  # so slow that it swings little
    rng = np.random.default_rng(0)
    drawn = [random_motion(tree, limits, 0.1, 5, rng) for _ in range(60)]
    for part in ("sine", "cosine"):
        found = np.array([getattr(m, part) for m in drawn])  # (motions, joints, harmonics)
        size = np.exp(np.log(np.abs(found)).mean(axis=(0, 1)))
        np.testing.assert_allclose(size / size[0] * np.arange(1, 6), 1, atol=0.25)
    place = np.array([m.offset for m in drawn]) / (limits.high - limits.low)
    assert np.abs(place).max() <= 0.25
    np.testing.assert_allclose(place.std(axis=0), 0.5 / np.sqrt(12), rtol=0.25)


def test_the_best_of_a_few_is_the_best_of_them(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "reaction", zeros=True)
    limits = limits_of(puma)
    free = Rules(puma, limits, 1.0, (), None, np.zeros(0))
    motion, score = best_motion(free, minimal, PLATE, 0.1, 5, 8, np.random.default_rng(7))
    rng = np.random.default_rng(7)
    again = [random_motion(puma, limits, 0.1, 5, rng) for _ in range(8)]
    scores = [relative_sigma(puma, m, minimal, PLATE) for m in again]
    assert score == min(scores)
    np.testing.assert_array_equal(motion.sine, again[int(np.argmin(scores))].sine)


def test_a_motion_that_hides_parameters_has_no_finite_score(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "reaction", zeros=True)
    lame = Fourier(0.1, np.zeros(3), np.zeros((3, 2)), np.zeros((3, 2)))
    for scale in (1e-9, 1.0, 1e9):
        assert relative_sigma(puma, lame, minimal, scale * PLATE) == float("inf")


@pytest.mark.parametrize("seed", range(6))
def test_the_score_is_the_sigma_of_least_squares(seed: int) -> None:
    """Rms of sigma over value; small values count as a twentieth of the largest of their unit."""
    rng = np.random.default_rng(seed)
    tree = free_tree(seed, 3)
    minimal = tb.minimal_set(tree, "reaction")
    motion = random_motion(tree, limits_of(tree), 0.1, 5, rng)
    noise = rng.uniform(0.1, 1.0, 6)
    times = np.arange(100) / 100 * motion.period
    rows = tb.regressor(tree, motion.at(times), minimal) / noise[:, None]
    rows = rows.reshape(-1, minimal.count)
    sigma = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    values = np.abs(minimal.values(tb.barycentric(tree)))
    raised = 0
    for k, unit in enumerate(minimal.units):
        largest = max(v for v, u in zip(values, minimal.units, strict=True) if u == unit)
        sigma[k] /= max(values[k], largest / 20)
        raised += values[k] < largest / 20
    assert raised
    score = relative_sigma(tree, motion, minimal, noise)
    assert score == pytest.approx(np.sqrt(np.mean(sigma**2)), rel=1e-6)
    for scale in (1e-9, 2.0, 1e9):
        assert relative_sigma(tree, motion, minimal, scale * noise) == pytest.approx(scale * score)
