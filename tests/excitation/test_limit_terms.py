"""Terms of efforts and plate on random trees with friction and rotors: values, slopes, bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.dynamics.motion import Motion
from testbed.errors import InfeasibleMotion
from testbed.excitation.jets import ForceBounds
from testbed.excitation.limit_terms import (
    PRESSURE,
    EffortTerm,
    PlateRange,
    PlateTerm,
    SmoothTerm,
)
from testbed.excitation.limits import Limits, limits_of
from testbed.excitation.samples import Computed
from tests.helpers.differences import samples_of, slopes_by_differences
from tests.helpers.robots import random_robot

EFFORT = np.array([30.0, np.inf, 50.0, 70.0])
RANGE = np.array([100.0, np.inf, 300.0, 40.0, 50.0, np.inf])
HALF = np.array([0.3, 0.5])
MARGIN = 0.9
PEDESTAL = np.array([1.0, -2.0, -90.0, 3.0, 4.0, -5.0])


def driven(seed: int) -> tuple[tb.Tree, Limits]:
    """A random arm of four joints whose drives have everything."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 4).tree()
    joints = tuple(
        replace(joint, coulomb=c, viscous=v, rotor_inertia=r)
        for joint, (c, v, r) in zip(tree.joints, rng.uniform(0.5, 3.0, (4, 3)), strict=True)
    )
    tree = replace(tree, joints=joints)
    return tree, replace(limits_of(tree), effort=EFFORT)


def terms(tree: tb.Tree, limits: Limits) -> tuple[SmoothTerm, ...]:
    plate = PlateTerm(PlateRange(RANGE, HALF), PEDESTAL, MARGIN)
    return EffortTerm(tree, limits, MARGIN), plate


def states(tree: tb.Tree, seed: int) -> Motion:
    return Motion(np.arange(5.0), *np.random.default_rng(seed).normal(size=(3, 5, tree.n)))


@pytest.mark.parametrize("seed", range(4))
def test_efforts_are_shares_of_limits_with_friction_of_either_sign(seed: int) -> None:
    tree, limits = driven(seed)
    motion = states(tree, seed)
    term, _ = terms(tree, limits)
    joints = [0, 2, 3]  # those with a limit
    assert term.labels == tuple(f"effort of '{tree.names[j]}'" for j in joints for _ in "+-")
    forces = tb.joint_forces(tree, motion)
    found = term.values(Computed(tree, motion)).reshape(3, 2, -1)
    for k, j in enumerate(joints):
        own = tree.joints[j]
        torque = forces[:, j] + own.viscous * motion.qd[:, j] + own.rotor_inertia * motion.qdd[:, j]
        for side, sign in enumerate((1, -1)):
            wanted = (sign * torque + own.coulomb) / EFFORT[j] - MARGIN
            np.testing.assert_allclose(found[k, side], wanted, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_plates_channels_and_centre_of_pressure_are_limited(seed: int) -> None:
    """The pedestal counts; |My| <= x Fz and |Mx| <= y Fz."""
    tree, limits = driven(seed)
    motion = states(tree, seed)
    _, term = terms(tree, limits)
    wrench = (tb.base_wrench(tree, motion) + PEDESTAL).T
    wanted, labels = [], []
    for channel in (0, 2, 3, 4):
        labels += 2 * [f"plate {('Fx', 'Fy', 'Fz', 'Mx', 'My')[channel]}"]
        wanted += [sign * wrench[channel] / RANGE[channel] - MARGIN for sign in (1, -1)]
    for axis, channel in ((0, 4), (1, 3)):
        labels += 2 * [f"centre of pressure along {'xy'[axis]}"]
        for sign in (1, -1):
            inside = sign * wrench[channel] - MARGIN * HALF[axis] * wrench[2]
            wanted.append(inside / (PRESSURE * HALF[axis]))
    assert term.labels == tuple(labels)
    np.testing.assert_allclose(term.values(Computed(tree, motion)), wanted, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("which", [0, 1])
def test_slopes_are_those_of_differences_of_the_recursion(seed: int, which: int) -> None:
    tree, limits = driven(seed)
    motion = states(tree, seed)
    term = terms(tree, limits)[which]
    found = term.slopes(samples_of(tree, motion))
    slopes = slopes_by_differences(motion, lambda moved: term.values(Computed(tree, moved)))
    for place in range(3 * tree.n):
        wanted = slopes[:, place]
        np.testing.assert_allclose(found[:, place], wanted, atol=1e-8 * np.abs(wanted).max() + 1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_bounds_of_curvature_are_of_forces_and_drives(seed: int) -> None:
    """Viscous friction goes with the third derivative, a rotor with the fourth."""
    tree, limits = driven(seed)
    rng = np.random.default_rng(seed)
    joints, (force, moment) = rng.uniform(1, 2, (4, 6)), rng.uniform(1, 2, (2, 6))
    bounds = ForceBounds(joints, force, moment, rng.uniform(1, 2, (5, 4, 6)))
    effort, plate = terms(tree, limits)
    wanted = [
        (
            bounds.joints[j]
            + tree.joints[j].viscous * bounds.motion[3, j]
            + tree.joints[j].rotor_inertia * bounds.motion[4, j]
        )
        / EFFORT[j]
        for j in (0, 0, 2, 2, 3, 3)
    ]
    np.testing.assert_allclose(effort.curvatures(bounds), wanted, rtol=1e-12)
    found = plate.curvatures(bounds)
    each = [force / 100, force / 300, moment / 40, moment / 50]
    each += [(moment + MARGIN * half * force) / (PRESSURE * half) for half in HALF]
    np.testing.assert_allclose(found, np.repeat(each, 2, axis=0), rtol=1e-12)


def test_what_leaves_no_room_is_refused() -> None:
    tree, limits = driven(1)
    weak = replace(limits, effort=np.full(4, tree.joints[2].coulomb / MARGIN))
    with pytest.raises(InfeasibleMotion, match="too weak for its dry friction"):
        EffortTerm(tree, weak, MARGIN)
    for wrench, half in ((RANGE * [1, 1, 0, 1, 1, 1], HALF), (RANGE, -HALF)):
        with pytest.raises(InfeasibleMotion, match="ranges and half lengths must be positive"):
            PlateRange(wrench, half)
