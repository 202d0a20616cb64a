"""Motions are what their series says, and stay within the limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.errors import InfeasibleMotion, UnknownName
from testbed.excitation.fourier import Fourier
from testbed.excitation.limits import limits_of, usage
from testbed.excitation.random_motion import MARGIN, best_motion, random_motion, relative_sigma
from tests.helpers.robots import random_robot

PLATE = np.repeat([0.5, 0.1], 3)


def series(rng: np.random.Generator, n: int = 3) -> Fourier:
    return Fourier(0.2, rng.normal(size=n), *rng.normal(size=(2, n, 4)))


@pytest.mark.parametrize("seed", range(5))
def test_velocity_and_acceleration_are_derivatives(seed: int) -> None:
    motion, h = series(np.random.default_rng(seed)), 1e-4
    t = np.linspace(0, 5, 40)
    before, now, after = (motion.at(t + step) for step in (-h, 0, h))
    np.testing.assert_allclose((after.q - before.q) / (2 * h), now.qd, atol=1e-4)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * h), now.qdd, atol=1e-3)


def test_a_motion_repeats_after_its_period() -> None:
    motion = series(np.random.default_rng(0))
    t = np.linspace(0, 5, 20)
    np.testing.assert_allclose(motion.at(t).q, motion.at(t + motion.period).q, atol=1e-12)


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


def test_a_limit_for_a_joint_that_is_not_there_is_refused(puma: tb.Tree) -> None:
    with pytest.raises(UnknownName, match="wrist"):
        limits_of(puma, {"wrist": 1.0})


def test_files_without_limits_get_calm_ones() -> None:
    tree = random_robot(np.random.default_rng(2), 5).tree()
    limits = limits_of(tree)
    assert np.isfinite([limits.low, limits.high, limits.velocity, limits.acceleration]).all()


def test_the_best_of_a_few_is_the_best_of_them(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "reaction", zeros=True)
    limits = limits_of(puma)
    motion, score = best_motion(puma, limits, minimal, PLATE, 0.1, 5, 8, np.random.default_rng(7))
    rng = np.random.default_rng(7)
    again = [random_motion(puma, limits, 0.1, 5, rng) for _ in range(8)]
    scores = [relative_sigma(puma, m, minimal, PLATE) for m in again]
    assert score == min(scores)
    np.testing.assert_array_equal(motion.sine, again[int(np.argmin(scores))].sine)


def test_a_motion_that_hides_parameters_has_no_finite_score(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "reaction", zeros=True)
    lame = Fourier(0.1, np.zeros(3), np.zeros((3, 2)), np.zeros((3, 2)))
    assert relative_sigma(puma, lame, minimal, PLATE) == float("inf")
