"""What is proven holds at every moment; what exceeds a limit anywhere is not proven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.arrays import Array
from testbed.errors import InfeasibleMotion
from testbed.excitation.collision_model import collision_model
from testbed.excitation.fourier import Fourier
from testbed.excitation.jets import force_bounds
from testbed.excitation.limit_terms import EffortTerm, PlateRange, PlateTerm
from testbed.excitation.limits import Limits, limits_of, motor_efforts
from testbed.excitation.proof import SPANS, Rules, prove, seems_to_hold, spans_of, suprema
from testbed.excitation.random_motion import random_motion
from testbed.excitation.rest_to_rest import RestToRest, Start, start_of
from tests.helpers.chains import Z, chain
from tests.helpers.refusals import refuses
from tests.helpers.shapes import ball
from tests.helpers.strategies import few, rngs, trees


def random_series(rng: np.random.Generator, n: int, harmonics: int, size: float = 0.5) -> Fourier:
    parts = size * rng.normal(size=(2, n, harmonics)) / np.arange(1, harmonics + 1)
    return Fourier(rng.uniform(0.05, 0.5), rng.normal(size=n), *parts)


def wide(n: int) -> Limits:
    far = np.full(n, 1e9)
    return Limits(-far, far, far, far, np.full(n, np.inf))


def rules(tree: tb.Tree, limits: Limits, margin: float = 1.0, **more: object) -> Rules:
    plain = Rules(tree, limits, margin, (), None, np.zeros(0))
    return replace(plain, **more)  # type: ignore[arg-type]


@few(10)
@given(trees((3, 3)), rngs, st.integers(1, 8))
def test_largest_values_between_samples_are_within_the_bound(
    tree: tb.Tree, rng: np.random.Generator, harmonics: int
) -> None:
    motion, ones = random_series(rng, 3, harmonics), np.ones(3)
    limits = replace(wide(3), velocity=ones, acceleration=ones, low=-ones, high=ones)
    left = {m.label: m.left for m in prove(motion, rules(tree, limits)).margins}
    fine = motion.at(np.linspace(0, motion.period, 50_001))
    for j, name in enumerate(tree.names):
        shares = {"position": fine.q, "velocity": fine.qd, "acceleration": fine.qdd}
        for kind, values in shares.items():
            most = np.abs(values[:, j]).max()
            assert most * (1 - 1e-12) <= 1.0 - left[f"{kind} of '{name}'"] <= most * 1.001


@few(6)
@given(trees((5, 5)), rngs)
def test_jets_bound_how_forces_change(tree: tb.Tree, rng: np.random.Generator) -> None:
    """Second differences of forces, in every span of time."""
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
@pytest.mark.parametrize("haste", [1.0, 10.0])
def test_efforts_and_plate_are_proven_as_tightly_as_they_are(haste: float, puma: tb.Tree) -> None:
    """With friction of either sign, the most of a fine grid, and hardly more.

    In haste it takes more samples than a proof begins with.
    """
    limits, pedestal = limits_of(puma), tb.pedestal_wrench(puma)
    motion = random_motion(puma, limits, 0.1, 5, np.random.default_rng(int(haste)))
    motion = replace(motion, fundamental=haste * motion.fundamental)
    held = rules(puma, limits, terms=(EffortTerm(puma, limits, 1.0),))
    left = [m.left for m in prove(motion, held).margins if "effort" in m.label]
    fine = motion.at(np.linspace(0, motion.period, 30_001))
    smooth = motor_efforts(puma.with_joints({n: {"coulomb": 0.0} for n in puma.names}), fine)
    dry = np.array([joint.coulomb for joint in puma.joints])
    used = (np.abs(smooth).max(axis=0) + dry) / limits.effort
    found = 1 - np.array(left).reshape(-1, 2).min(axis=1)
    assert (found >= used - 1e-12).all()
    assert (found <= used + 0.003).all()
    if haste > 1:
        return
    wrench = tb.base_wrench(puma, fine) + pedestal
    most, place = np.abs(wrench).max(axis=0), np.abs(wrench[:, [4, 3]] / wrench[:, [2]])
    for factor, holds in ((1.01, True), (0.99, False)):
        for range_ in (
            PlateRange(factor * most),
            PlateRange(np.full(6, np.inf), factor * place.max(axis=0)),
        ):
            held = rules(puma, limits, terms=(PlateTerm(range_, pedestal, 1.0),))
            assert prove(motion, held).holds is holds
            assert seems_to_hold(motion, held) is holds


def test_bodies_that_meet_between_samples_are_found() -> None:
    """A ball on an arm grazes a ball on the floor twice a period, for a moment."""
    two = chain(("revolute", Z), ("revolute", Z))
    hand = replace(two.joints[1], offset=np.array([1.0, 0, 0]))
    two = replace(two, joints=(two.joints[0], hand))
    motion = Fourier(1.0, np.zeros(2), np.array([[2.0], [0.0]]), np.zeros((2, 1)))
    angle = 2.0 * np.sin(0.77)  # passed at no sample of a millisecond
    for gap, holds in ((0.0099, True), (-0.0001, False)):
        away = 1.0 + 0.1 + 0.01 + gap
        post = ball(-1, 0.05, away * np.array([np.cos(angle), np.sin(angle), 0]))
        collision = collision_model(two, [post, ball(1, 0.05, np.zeros(3))])
        found = prove(motion, rules(two, wide(2), collision=collision, clearance=np.full(1, 0.01)))
        assert [m.holds for m in found.margins if m.unit == "m"] == [holds]
        assert found.postures < 5000


# from rest to rest


@few(5)
@given(trees((3, 3)), rngs)
def test_a_start_is_at_rest_joins_the_motion_and_tells_its_largest_acceleration(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    motion = random_series(rng, 3, 4)
    start = Start(motion, 2.0)
    ends, joined = start.at(np.array([0.0, 2.0])), motion.at(np.zeros(1))
    np.testing.assert_allclose([ends.qd[0], ends.qdd[0]], 0, atol=1e-12)
    for name in ("q", "qd", "qdd"):
        np.testing.assert_allclose(getattr(ends, name)[1], getattr(joined, name)[0], atol=1e-12)
    times, h = np.linspace(0.01, 1.99, 400), 1e-4
    for order in range(4):  # the chain rule against differences
        near = start.derivative(times + h, order) - start.derivative(times - h, order)
        wanted = start.derivative(times, order + 1)
        np.testing.assert_allclose(near / (2 * h), wanted, atol=1e-5 * np.abs(wanted).max())
    fifth = np.diff(start.derivative(times, 4), axis=0) / np.diff(times)[:, None]
    assert (np.abs(fifth) <= start.fifth_derivative).all()
    start, margins = start_of(random_series(rng, 3, 3, 0.05), rules(tree, wide(3)))
    told = {m.label: m for m in margins[:3]}  # of the start; the others are of its mirror image
    size = np.abs(start.derivative(np.linspace(0, start.duration, 4001), 2))
    for j, name in enumerate(tree.names):
        margin = told[f"acceleration of '{name}'"]
        assert 0 <= margin.instant <= start.duration
        here = np.abs(start.derivative(np.array([margin.instant]), 2))[0, j]
        assert here > 0.99 * size[:, j].max()


@pytest.mark.slow
def test_a_motion_of_the_puma_goes_from_rest_to_rest_within_all_limits(puma: tb.Tree) -> None:
    """Its path is the motion's own; where motors do not hold the weight it cannot begin."""
    limits = limits_of(puma)
    motion = random_motion(puma, limits, 0.2, 4, np.random.default_rng(3))
    start, margins = start_of(motion, rules(puma, limits, terms=(EffortTerm(puma, limits, 1.0),)))
    assert all(margin.holds for margin in margins)
    fine = start.at(np.linspace(0, start.duration, 20_001))
    assert (np.abs(fine.qdd) <= limits.acceleration).all()
    assert (np.abs(motor_efforts(puma, fine)) <= limits.effort).all()
    whole = RestToRest(Start(motion, 1.5), 3)
    assert whole.end == pytest.approx(15.0)
    times, h = np.linspace(-3.0, 20.0, 2001), 1e-5
    samples = whole.at(times)
    np.testing.assert_allclose(samples.q, motion.at(whole.place(times)).q, atol=1e-12)
    near = (whole.at(times + h).q - whole.at(times - h).q) / (2 * h)
    np.testing.assert_allclose(samples.qd, near, atol=1e-6)
    still = (times < -1.5) | (times > 16.5)
    assert max(np.abs(samples.qd[still]).max(), np.abs(samples.qdd[still]).max()) < 1e-9
    smooth, weak = puma.without_friction(), replace(limits, effort=0.01 * limits.effort)
    with refuses(InfeasibleMotion, "start", "effort"):
        start_of(motion, rules(smooth, weak, terms=(EffortTerm(smooth, weak, 1.0),)))
