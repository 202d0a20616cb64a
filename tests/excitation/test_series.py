"""Unknowns of a search: derivatives by them are those by the motion, pulled back."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.excitation.limits import limits_of
from testbed.excitation.series import Series
from tests.helpers.robots import random_robot

JOINTS, INSTANTS = 3, 15


def series(seed: int) -> Series:
    tree = random_robot(np.random.default_rng(seed), JOINTS).tree()
    return Series(limits_of(tree), 0.2, 2, INSTANTS, 0.9)


@pytest.mark.parametrize("lead", [(), (4,), (2, 3)])
@pytest.mark.parametrize("seed", range(3))
def test_pulled_back_slopes_are_those_of_the_motion(seed: int, lead: tuple[int, ...]) -> None:
    """The motion is linear in the unknowns: slopes times the motion of a step are the change."""
    one, rng = series(seed), np.random.default_rng(seed)
    slopes = rng.normal(size=(*lead, 3 * JOINTS, INSTANTS))
    step = rng.normal(size=JOINTS * one.width)
    motion = one.at(step)  # (3, G, n)
    wanted = np.einsum("...djg,dgj->...", slopes.reshape(*lead, 3, JOINTS, INSTANTS), motion)
    pulled = one.pulled(slopes)
    assert pulled.shape == (*lead, JOINTS * one.width)
    np.testing.assert_allclose(pulled @ step, wanted, rtol=1e-10, atol=1e-12)


def test_instant_by_instant_they_add_up_to_the_sum() -> None:
    one, rng = series(0), np.random.default_rng(5)
    slopes = rng.normal(size=(3 * JOINTS, INSTANTS))
    each = one.each(slopes.T, np.arange(INSTANTS))
    np.testing.assert_allclose(each.sum(axis=0), one.pulled(slopes), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_linear_values_are_shares_of_limits_less_what_is_allowed(seed: int) -> None:
    one = series(seed)
    x = np.random.default_rng(seed).normal(size=JOINTS * one.width)
    values, none = one.linear_values(x), one.linear_values(0 * x)
    assert values.shape == (JOINTS, 2, 3 * INSTANTS)
    np.testing.assert_allclose(values[:, 0] - none[:, 0], -(values[:, 1] - none[:, 1]), atol=1e-12)
    motion, limits = one.at(x), one.limits
    middle, half = (limits.high + limits.low) / 2, (limits.high - limits.low) / 2
    shares = [(motion[0] - middle) / half, motion[1] / limits.velocity]
    shares.append(motion[2] / limits.acceleration)
    for order, share in enumerate(shares):
        part = slice(order * INSTANTS, (order + 1) * INSTANTS)
        above = values[:, 0, part].T
        below = values[:, 1, part].T
        np.testing.assert_allclose((above - below) / 2, share, atol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_between_the_instants_limits_are_passed_by_no_more_than_is_allowed_for(seed: int) -> None:
    """What is at most `linear_most` at the instants is at most the margin at every moment."""
    one = series(seed)
    x = np.random.default_rng(seed).normal(size=JOINTS * one.width)
    motion, times = one.motion(x), np.linspace(0, 1 / one.fundamental, 20_001)
    for order in range(3):
        at_instants = np.abs(motion.derivative(one.times, order) - (motion.offset * (order == 0)))
        ever = np.abs(motion.derivative(times, order) - (motion.offset * (order == 0)))
        allowed = at_instants.max(axis=0) * one.margin / one.linear_most
        assert (ever.max(axis=0) <= allowed * (1 + 1e-9)).all()
    assert 0.9 * one.margin < one.linear_most < one.margin


def test_unknowns_and_motions_are_one_to_one() -> None:
    one = series(1)
    x = np.random.default_rng(1).normal(size=JOINTS * one.width)
    np.testing.assert_allclose(one.unknowns(one.motion(x)), x, rtol=1e-12)
    there = one.motion(x).at(one.times)
    np.testing.assert_allclose(one.at(x), [there.q, there.qd, there.qdd], rtol=1e-9, atol=1e-12)
