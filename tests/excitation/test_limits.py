"""What a motion may ask of a robot and its plate, and random motions that stay within it.

If one fails, a motion is asked of motors, joints or a plate that cannot do it, or less than can be.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.arrays import Array
from testbed.errors import InfeasibleMotion, UnknownName
from testbed.excitation.fourier import Fourier
from testbed.excitation.jets import ForceBounds
from testbed.excitation.limit_terms import PRESSURE, EffortTerm, PlateRange, PlateTerm
from testbed.excitation.limits import limits_of, motor_efforts, usage
from testbed.excitation.proof import Rules
from testbed.excitation.random_motion import MARGIN, best_motion, random_motion, relative_sigma
from testbed.excitation.samples import Computed
from testbed.excitation.slack import slack
from tests.helpers.differences import samples_of, slopes_by_differences
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.strategies import few, rngs, trees

INF = np.inf
EFFORT = np.array([30.0, INF, 50.0, 70.0])
RANGE = np.array([100.0, INF, 300.0, 40.0, 50.0, INF])
HALF = np.array([0.3, 0.5])
PEDESTAL = np.array([1.0, -2.0, -90.0, 3.0, 4.0, -5.0])
PLATE = np.repeat([0.5, 0.1], 3)


def each(tree: tb.Tree, **changes: object) -> tb.Tree:
    """The tree with every joint changed alike."""
    return replace(tree, joints=tuple(replace(j, **changes) for j in tree.joints))  # type: ignore[arg-type]


def by_kind(tree: tb.Tree, revolute: float, prismatic: float) -> Array:
    return np.array([revolute if joint.revolute else prismatic for joint in tree.joints])


@given(trees((2, 6)), rngs)
def test_a_file_without_limits_gets_calm_ones_and_one_end_a_range_as_wide(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    limits, half = limits_of(tree), by_kind(tree, np.pi, 0.5)
    np.testing.assert_allclose([limits.low, limits.high], [-half, half])
    np.testing.assert_array_equal(limits.velocity, by_kind(tree, 2.0, 0.5))
    np.testing.assert_array_equal(limits.acceleration, by_kind(tree, 6.0, 2.0))
    assert (limits.effort == INF).all()
    bound = float(rng.choice([-7.0, -0.3, 0.0, 0.2, 7.0]))
    above = limits_of(each(tree, position_range=np.array([bound, INF])))
    np.testing.assert_allclose([above.low, above.high], [0 * half + bound, bound + 2 * half])
    below = limits_of(each(tree, position_range=np.array([-INF, bound])))
    np.testing.assert_allclose(below.high, np.minimum(bound, half))
    np.testing.assert_allclose(below.low, below.high - 2 * half)
    known = limits_of(each(tree, position_range=np.array([-50.0, 40.0]), max_velocity=1.5))
    np.testing.assert_array_equal([known.low, known.high], np.outer([-50.0, 40.0], half**0))
    first, second, *_ = tree.names
    own = limits_of(each(tree, max_velocity=1.5), {first: 0.2, second: 9.0}, {second: 0.7})
    assert own.velocity.tolist() == [0.2, *[1.5] * (tree.n - 1)]  # the lower of two counts
    assert own.acceleration[1] == 0.7


def test_limits_that_mean_nothing_name_their_joint(puma: tb.Tree) -> None:
    for words in (({"wrist": 1.0}, None), (None, {"wrist": 1.0})):
        with refuses(UnknownName, "wrist"):
            limits_of(puma, *words)
    joints = (*puma.joints[:2], replace(puma.joints[2], position_range=np.array([0.3, 0.3])))
    with refuses(InfeasibleMotion, "'elbow'", "0.3"):
        limits_of(replace(puma, joints=joints))
    weak = each(puma, max_effort=0.1)
    with refuses(InfeasibleMotion, "shoulder"):
        random_motion(weak, limits_of(weak), 0.1, 5, np.random.default_rng(0))
    effort = np.append(limits_of(puma).effort[:2], puma.joints[2].coulomb / 0.9)
    with refuses(InfeasibleMotion, "elbow"):
        EffortTerm(puma, replace(limits_of(puma), effort=effort), 0.9)
    for wrench, half in ((RANGE * [1, 1, 0, 1, 1, 1], HALF), (RANGE, -HALF)):
        with pytest.raises(InfeasibleMotion):
            PlateRange(wrench, half)


@few(4)
@given(trees((4, 4)), rngs)
def test_terms_of_efforts_and_plate_are_shares_of_limits(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """Friction of either sign, rotors, the pedestal, |My| <= x Fz; slopes, bounds of curvature."""
    drawn = rng.uniform(0.5, 3.0, (4, 3)).tolist()
    keys = ("coulomb", "viscous", "rotor_inertia")
    own = {n: dict(zip(keys, row, strict=True)) for n, row in zip(tree.names, drawn, strict=True)}
    tree = tree.with_joints(own)
    limits = replace(limits_of(tree), effort=EFFORT)
    effort = EffortTerm(tree, limits, 0.9)
    plate = PlateTerm(PlateRange(RANGE, HALF), PEDESTAL, 0.9)
    motion = tb.Motion(np.arange(5.0), *rng.normal(size=(3, 5, 4)))
    dry, wet, rotor = np.array(drawn).T
    joints = [0, 2, 3]  # those with a limit
    assert effort.labels == tuple(f"effort of '{tree.names[j]}'" for j in joints for _ in "+-")
    smooth = tb.joint_forces(tree, motion) + wet * motion.qd + rotor * motion.qdd
    wanted = [(s * smooth[:, j] + dry[j]) / EFFORT[j] - 0.9 for j in joints for s in (1, -1)]
    here = Computed(tree, motion)
    np.testing.assert_allclose(effort.values(here), wanted, atol=1e-12)
    braked = smooth + dry * np.sign(motion.qd)
    np.testing.assert_allclose(motor_efforts(tree, motion), braked, atol=1e-12)
    wrench = (tb.base_wrench(tree, motion) + PEDESTAL).T
    wanted = [s * wrench[k] / RANGE[k] - 0.9 for k in (0, 2, 3, 4) for s in (1, -1)]
    for axis, channel in ((0, 4), (1, 3)):
        inside = [s * wrench[channel] - 0.9 * HALF[axis] * wrench[2] for s in (1, -1)]
        wanted += [each / (PRESSURE * HALF[axis]) for each in inside]
    np.testing.assert_allclose(plate.values(here), wanted, atol=1e-12)
    names = ["plate Fx", "plate Fz", "plate Mx", "plate My"]
    names += [f"centre of pressure along {axis}" for axis in "xy"]
    assert plate.labels == tuple(name for name in names for _ in "+-")
    for term in (effort, plate):
        slopes = slopes_by_differences(motion, lambda m, t=term: t.values(Computed(tree, m)))  # type: ignore[misc]
        found = term.slopes(samples_of(tree, motion))
        size = np.abs(slopes).max(axis=(0, 2), keepdims=True)
        assert (np.abs(found - slopes) <= 1e-8 * size + 1e-9).all()
    forces, (force, moment) = rng.uniform(1, 2, (4, 6)), rng.uniform(1, 2, (2, 6))
    bounds = ForceBounds(forces, force, moment, rng.uniform(1, 2, (5, 4, 6)))
    curved = forces + wet[:, None] * bounds.motion[3] + rotor[:, None] * bounds.motion[4]
    curved = np.repeat((curved / EFFORT[:, None])[joints], 2, axis=0)
    np.testing.assert_allclose(effort.curvatures(bounds), curved, rtol=1e-12)
    of_plate = [force / 100, force / 300, moment / 40, moment / 50]
    of_plate += [(moment + 0.9 * half * force) / (PRESSURE * half) for half in HALF]
    np.testing.assert_allclose(plate.curvatures(bounds), np.repeat(of_plate, 2, axis=0), rtol=1e-12)


@few(4)
@given(trees((2, 5)), rngs)
def test_random_motions_go_to_the_nearest_limit_and_no_further(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """Speed, acceleration, or how far a joint swings: one of them is used up to the margin."""
    limits = limits_of(tree, {tree.names[0]: 0.3}, {tree.names[1]: 1.0})
    motion = random_motion(tree, limits, 0.1, 5, rng)
    fine = motion.at(np.linspace(0, motion.period, 5000))
    swing = np.abs(fine.q - motion.offset).max(axis=0) / ((limits.high - limits.low) / 2)
    used = usage(tree, fine, limits)
    speed = np.abs(fine.qd).max(axis=0) / limits.velocity
    haste = np.abs(fine.qdd).max(axis=0) / limits.acceleration
    np.testing.assert_allclose([used["velocity"], used["acceleration"]], [speed, haste], rtol=1e-12)
    np.testing.assert_allclose(np.max([swing, speed, haste], axis=0), MARGIN, rtol=0.01)
    assert used["position"].max() <= MARGIN * 1.01
    assert not used["effort"].any()
    middle, half = (limits.high + limits.low) / 2, (limits.high - limits.low) / 2
    np.testing.assert_allclose(used["position"], np.abs((fine.q - middle) / half).max(axis=0))


def test_weak_motors_slow_a_motion_no_more_than_they_must(puma: tb.Tree) -> None:
    """What is as fast as the efforts allow exceeds them a step of a ninth faster."""
    puma = replace(puma, gravity=np.zeros(3))  # efforts then fall with the speed
    weak = each(puma, max_effort=12.0)
    limits = limits_of(weak)
    slowed = 0
    for seed in range(5):
        free = random_motion(puma, limits_of(puma), 0.1, 5, np.random.default_rng(seed))
        slow = random_motion(weak, limits, 0.1, 5, np.random.default_rng(seed))
        steps = np.log(slow.sine / free.sine) / np.log(0.9)
        np.testing.assert_allclose(steps, round(steps[0, 0]), atol=1e-9)
        times = np.linspace(0, slow.period, 500, endpoint=False)
        share = np.abs(motor_efforts(weak, slow.at(times))).max(axis=0) / 12.0
        np.testing.assert_allclose(usage(weak, slow.at(times), limits)["effort"], share)
        assert share.max() <= MARGIN
        if steps[0, 0] > 0.5:
            slowed += 1
            faster = replace(slow, sine=slow.sine / 0.9, cosine=slow.cosine / 0.9)
            assert usage(weak, faster.at(times), limits)["effort"].max() > MARGIN
    assert slowed > 1


def test_the_best_of_a_few_is_the_best_of_them_by_the_sigma_of_least_squares() -> None:
    """Rms of sigma over value; small values count as a twentieth of the largest of their unit."""
    tree = random_robot(np.random.default_rng(0), 3).tree()
    minimal, limits = tb.minimal_set(tree, "reaction"), limits_of(tree)
    free = Rules(tree, limits, 1.0, (), None, np.zeros(0))
    motion, score = best_motion(free, minimal, PLATE, 0.1, 5, 8, np.random.default_rng(7))
    rng = np.random.default_rng(7)
    again = [random_motion(tree, limits, 0.1, 5, rng) for _ in range(8)]
    scores = [relative_sigma(tree, m, minimal, PLATE) for m in again]
    assert score == min(scores)
    np.testing.assert_array_equal(motion.sine, again[int(np.argmin(scores))].sine)
    times = np.arange(100) / 100 * motion.period
    rows = tb.regressor(tree, motion.at(times), minimal) / PLATE[:, None]
    rows = rows.reshape(-1, minimal.count)
    values = np.abs(minimal.values(tb.barycentric(tree)))
    units = np.array(minimal.units)
    largest = np.array([values[units == unit].max() for unit in units])
    sigma = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows))) / np.maximum(values, largest / 20)
    assert (values < largest / 20).any()
    assert score == pytest.approx(np.sqrt(np.mean(sigma**2)), rel=1e-6)
    lame = Fourier(0.1, np.zeros(3), *np.zeros((2, 3, 2)))
    for scale in (1e-9, 1e9):
        noise = scale * PLATE
        assert relative_sigma(tree, motion, minimal, noise) == pytest.approx(scale * score)
        assert relative_sigma(tree, lame, minimal, noise) == INF


def test_what_is_left_of_limits_is_told_kind_by_kind(puma: tb.Tree) -> None:
    """Of efforts, with friction of either sign; clearances are in the laws of distances."""
    limits = limits_of(puma)
    motion = random_motion(puma, limits, 0.1, 4, np.random.default_rng(0))
    times = np.linspace(0, motion.period, 60)
    rules = Rules(puma, limits, 0.9, (EffortTerm(puma, limits, 0.9),), None, np.zeros(0))
    at, found = motion.at(times), {each.label: each for each in slack(motion, rules, times)}
    assert {each.unit for each in found.values()} == {"%"}
    dry = np.array([joint.coulomb for joint in puma.joints])
    smooth = motor_efforts(each(puma, coulomb=0.0), at)
    wanted = {
        "position limits": np.abs(at.q - limits.middle) / limits.half,
        "velocity limits": np.abs(at.qd) / limits.velocity,
        "acceleration limits": np.abs(at.qdd) / limits.acceleration,
        "effort limits": (np.abs(smooth) + dry) / limits.effort,
    }
    assert list(found) == list(wanted)
    for label, used in wanted.items():
        np.testing.assert_allclose(found[label].left, 100 * (0.9 - used.max(axis=1)), atol=1e-9)
