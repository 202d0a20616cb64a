"""What is proven holds at every moment; what exceeds a limit anywhere is not proven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import InfeasibleMotion
from testbed.excitation.collision_model import collision_model
from testbed.excitation.fourier import Fourier
from testbed.excitation.jets import force_bounds
from testbed.excitation.limit_terms import EffortTerm, PlateRange, PlateTerm
from testbed.excitation.limits import Limits, limits_of, motor_efforts
from testbed.excitation.proof import SPANS, Rules, prove, spans_of, suprema
from testbed.excitation.random_motion import random_motion
from testbed.excitation.rest_to_rest import RestToRest, Start, start_of
from tests.excitation.test_clearance import ball
from tests.helpers.robots import random_robot


def random_series(rng: np.random.Generator, n: int, harmonics: int, size: float = 0.5) -> Fourier:
    parts = size * rng.normal(size=(2, n, harmonics)) / np.arange(1, harmonics + 1)
    return Fourier(rng.uniform(0.05, 0.5), rng.normal(size=n), *parts)


def wide(n: int) -> Limits:
    far = np.full(n, 1e9)
    return Limits(-far, far, far, far, np.full(n, np.inf))


def rules(tree: tb.Tree, limits: Limits, margin: float = 1.0, **more: object) -> Rules:
    plain = Rules(tree, limits, margin, (), None, np.zeros(0))
    return replace(plain, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(20))
def test_largest_values_between_samples_are_within_the_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, harmonics = 3, int(rng.integers(1, 9))
    motion = random_series(rng, n, harmonics)
    tree = random_robot(rng, n).tree()
    limits = wide(n)
    limits = replace(limits, velocity=np.ones(n), acceleration=np.ones(n))
    left = {m.label: m.left for m in prove(motion, rules(tree, limits)).margins}
    fine = motion.at(np.linspace(0, motion.period, 50_001))
    for j, name in enumerate(tree.names):
        for kind, values in (("velocity", fine.qd), ("acceleration", fine.qdd)):
            most = np.abs(values[:, j]).max()
            bound = 1.0 - left[f"{kind} of '{name}'"]
            assert most * (1 - 1e-12) <= bound <= most * 1.001


@pytest.mark.parametrize("seed", range(10))
def test_jets_bound_how_forces_change(seed: int) -> None:
    """On random trees: second differences of forces, in every span of time."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 5).tree()
    motion = random_series(rng, 5, 4)
    count = spans_of(motion.period)
    bounds = force_bounds(tree, suprema(motion, count))
    step = motion.period / count
    at = motion.at(step * np.arange(-1.0, count + 1))

    def curved(values: Array) -> Array:
        """Largest second derivative in every span, (SPANS, k)."""
        second = np.abs(np.diff(values, 2, axis=0)) / step**2
        return np.asarray(second[:count].reshape(SPANS, -1, values.shape[1]).max(axis=1))

    joints, wrench = tb.joint_forces(tree, at), tb.base_wrench(tree, at)
    slack = 1 + 1e-3  # differences look a sample beyond a span
    assert (slack * bounds.joints >= curved(joints).T).all()
    assert (curved(wrench[:, :3]).max(axis=1) <= slack * bounds.force).all()
    assert (curved(wrench[:, 3:]).max(axis=1) <= slack * bounds.moment).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("haste", [1.0, 10.0])
def test_efforts_are_proven_as_tightly_as_they_are(seed: int, haste: float, puma: tb.Tree) -> None:
    """With friction of either sign, the largest effort of a fine grid, and hardly more.

    In haste it takes more samples than a proof begins with.
    """
    limits = limits_of(puma)
    motion = random_motion(puma, limits, 0.1, 5, np.random.default_rng(seed))
    motion = replace(motion, fundamental=haste * motion.fundamental)
    term = EffortTerm(puma, limits, 1.0)
    left = [
        m.left
        for m in prove(motion, rules(puma, limits, terms=(term,))).margins
        if "effort" in m.label
    ]
    fine = motion.at(np.linspace(0, motion.period, 30_001))
    smooth = motor_efforts(puma.with_joints({n: {"coulomb": 0.0} for n in puma.names}), fine)
    dry = np.array([joint.coulomb for joint in puma.joints])
    used = (np.abs(smooth).max(axis=0) + dry) / limits.effort
    found = 1 - np.array(left).reshape(-1, 2).min(axis=1)
    assert (found >= used - 1e-12).all()
    assert (found <= used + 0.003).all()


@pytest.mark.slow
def test_a_plate_is_held_to_its_range_and_the_pressure_to_its_area(puma: tb.Tree) -> None:
    limits = limits_of(puma)
    motion = random_motion(puma, limits, 0.1, 5, np.random.default_rng(1))
    pedestal = tb.pedestal_wrench(puma)
    fine = tb.base_wrench(puma, motion.at(np.linspace(0, motion.period, 20_001))) + pedestal
    most = np.abs(fine).max(axis=0)
    place = np.abs(fine[:, [4, 3]] / fine[:, [2]]).max(axis=0)
    for factor, holds in ((1.01, True), (0.99, False)):
        for range_ in (
            PlateRange(factor * most),
            PlateRange(np.full(6, np.inf), factor * place),
        ):
            term = PlateTerm(range_, pedestal, 1.0)
            assert prove(motion, rules(puma, limits, terms=(term,))).holds is holds


def test_bodies_that_meet_between_samples_are_found() -> None:
    """A ball on an arm grazes a ball on the floor once a period, for a moment."""
    tree = random_robot(np.random.default_rng(0), 3).tree()
    arm = replace(
        tree.joints[0],
        kind="revolute",
        axis=np.array([0, 0, 1.0]),
        offset=np.zeros(3),
        rotation=np.eye(3),
    )
    hand = replace(arm, name="hand", parent=0, offset=np.array([1.0, 0, 0]))
    two = replace(tree, joints=(arm, hand), inertias=tree.inertias[:2])
    motion = Fourier(1.0, np.zeros(2), np.array([[2.0], [0.0]]), np.zeros((2, 1)))
    limits = limits_of(two, {"hand": 100.0})
    angle = 2.0 * np.sin(0.77)  # passed twice a period, at no sample of a millisecond
    for gap, holds in ((0.0099, True), (-0.0001, False)):
        away = 1.0 + 0.1 + 0.01 + gap
        post = ball(-1, 0.05, away * np.array([np.cos(angle), np.sin(angle), 0]))
        tip = ball(1, 0.05, np.zeros(3))
        collision = collision_model(two, [post, tip])
        found = prove(motion, rules(two, wide(2), collision=collision, clearance=np.full(1, 0.01)))
        distances = [m for m in found.margins if m.unit == "m"]
        assert [m.holds for m in distances] == [holds]
        assert found.postures < 5000
    assert limits.low.shape == (2,)


@pytest.mark.parametrize("seed", range(5))
def test_a_start_is_at_rest_and_joins_the_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = random_series(rng, 3, 4)
    start = Start(motion, 2.0)
    ends = start.at(np.array([0.0, 2.0]))
    joined = motion.at(np.zeros(1))
    np.testing.assert_allclose(ends.qd[0], 0, atol=1e-12)
    np.testing.assert_allclose(ends.qdd[0], 0, atol=1e-12)
    for name in ("q", "qd", "qdd"):
        np.testing.assert_allclose(getattr(ends, name)[1], getattr(joined, name)[0], atol=1e-12)
    times = np.linspace(0.01, 1.99, 400)
    h = 1e-4
    for order in range(4):  # the chain rule against differences
        near = start.derivative(times + h, order) - start.derivative(times - h, order)
        wanted = start.derivative(times, order + 1)
        np.testing.assert_allclose(near / (2 * h), wanted, atol=1e-5 * np.abs(wanted).max())
    fifth = np.diff(start.derivative(times, 4), axis=0) / np.diff(times)[:, None]
    assert (np.abs(fifth) <= start.fifth_derivative).all()


def test_a_start_keeps_all_limits_and_takes_no_longer_than_it_must(puma: tb.Tree) -> None:
    limits = limits_of(puma)
    motion = random_motion(puma, limits, 0.1, 5, np.random.default_rng(3))
    held = rules(puma, limits, terms=(EffortTerm(puma, limits, 1.0),))
    start, margins = start_of(motion, held)
    assert all(margin.holds for margin in margins)
    fine = start.at(np.linspace(0, start.duration, 20_001))
    assert (np.abs(fine.qdd) <= limits.acceleration).all()
    assert (np.abs(motor_efforts(puma, fine)) <= limits.effort).all()


def test_from_rest_to_rest_the_path_is_the_motion_s_own(puma: tb.Tree) -> None:
    motion = random_motion(puma, limits_of(puma), 0.2, 4, np.random.default_rng(0))
    whole = RestToRest(Start(motion, 1.5), 3)
    assert whole.end == pytest.approx(15.0)
    times = np.linspace(-3.0, 20.0, 2001)
    samples = whole.at(times)
    np.testing.assert_allclose(samples.q, motion.at(whole.place(times)).q, atol=1e-12)
    h = 1e-5
    near = (whole.at(times + h).q - whole.at(times - h).q) / (2 * h)
    np.testing.assert_allclose(samples.qd, near, atol=1e-6)
    still = (times < -1.5) | (times > 16.5)
    assert np.abs(samples.qd[still]).max() < 1e-9
    assert np.abs(samples.qdd[still]).max() < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_a_start_tells_when_its_acceleration_is_greatest(seed: int) -> None:
    """Joint by joint, at an instant of the start or of its mirror image."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 3).tree()
    start, margins = start_of(random_series(rng, 3, 3, 0.05), rules(tree, wide(3)))
    told = {m.label: m for m in margins[:3]}
    fine = np.linspace(0, start.duration, 4001)
    size = np.abs(start.derivative(fine, 2))
    for j, name in enumerate(tree.names):
        margin = told[f"acceleration of '{name}'"]
        assert 0 <= margin.instant <= start.duration
        here = np.abs(start.derivative(np.array([margin.instant]), 2))[0, j]
        assert here > 0.99 * size[:, j].max()


@pytest.mark.slow
def test_a_robot_that_cannot_rest_where_the_motion_begins_is_told_so(puma: tb.Tree) -> None:
    """However slowly it starts: its motors do not hold the weight there."""
    tree, limits = puma.without_friction(), limits_of(puma)
    motion = random_motion(tree, limits, 0.1, 5, np.random.default_rng(3))
    weak = replace(limits, effort=0.01 * limits.effort)
    held = rules(tree, weak, terms=(EffortTerm(tree, weak, 1.0),))
    with pytest.raises(InfeasibleMotion, match=r"cannot begin from rest: .* of the start"):
        start_of(motion, held)
