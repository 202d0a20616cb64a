"""What a run logs: samples that belong together, and the traps of logging a simulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.recordings.recording import Truth
from testbed.robot.model_file import ModelFile
from testbed.simulation.build import build_plant
from testbed.simulation.rollout import SimulationDiverged, simulate_motion
from testbed.simulation.sampled_loop import Sampling
from tests.helpers.paths import ROOT
from tests.helpers.plants import PUMA, run, waving


def test_the_plate_feels_the_motion_that_the_encoders_show(puma: tb.Tree) -> None:
    """Averaged samples, smooth joints: the wrench follows from positions alone.

    The trap: an integrator that treats velocities half a step late or damping implicitly
    is wrong here by 1e-3 and more, whatever its sensors say about themselves.
    """
    done = run(puma, PUMA, waving(3), Sampling(1000.0, 2, True, 0.2), 5e-4, friction=False)
    q, rate = done.truth.position, 1000.0
    qd = (q[2:] - q[:-2]) * rate / 2
    qdd = (q[2:] - 2 * q[1:-1] + q[:-2]) * rate**2
    shown = tb.base_wrench(puma, tb.Motion(done.time[1:-1], q[1:-1], qd, qdd))
    felt = done.truth.wrench - tb.pedestal_wrench(puma)
    gap = np.sqrt(np.mean((felt[1:-1] - shown) ** 2, axis=0) / np.mean(shown**2, axis=0))
    assert gap.max() < 1e-4


def test_the_acceleration_of_an_averaged_sample_is_the_gain_of_velocity(puma: tb.Tree) -> None:
    done = run(puma, PUMA, waving(3), Sampling(1000.0, 4, True, 0.1), 2.5e-4, friction=False)
    moved = np.diff(done.truth.position, axis=0) * 1000
    between = (done.truth.velocity[1:] + done.truth.velocity[:-1]) / 2
    np.testing.assert_allclose(moved, between, atol=1e-4)
    gained = np.diff(done.truth.velocity, axis=0) * 1000
    middle = (done.truth.acceleration[1:] + done.truth.acceleration[:-1]) / 2
    np.testing.assert_allclose(gained, middle, atol=0.01)


@pytest.mark.slow
def test_the_same_experiment_gives_the_same_bits(puma_recording: tb.Recording) -> None:
    settings = ["motion.duration=10", "simulation.step=2.5e-4", "motion.candidates=10"]
    again = tb.simulate(tb.Experiment.load(ROOT / "experiments/table6.toml", settings))
    for group in ("position", "torque", "wrench"):
        np.testing.assert_array_equal(getattr(again, group), getattr(puma_recording, group))


def friction_law(velocity: Array) -> Array:
    coulomb, viscous = np.array([6.3, 5.5, 2.6]), np.array([5.80, 9.50, 3.98])
    return coulomb * np.sign(velocity) + viscous * velocity


def test_dry_friction_is_coulombs_above_a_hundredth_of_a_radian_a_second(puma: tb.Tree) -> None:
    true = run(puma, PUMA, waving(3), Sampling(1000.0, 4, False, 0.0), 2.5e-4).truth
    fast = np.abs(true.velocity) > 0.01
    np.testing.assert_allclose(true.friction[fast], friction_law(true.velocity)[fast], atol=1e-12)
    assert fast.mean() > 0.9


def test_the_drive_follows_its_reference(puma_recording: tb.Recording) -> None:
    true = puma_recording.truth
    assert true is not None
    assert max(puma_recording.facts["tracking_rms"].values()) < 2e-3
    fast = np.abs(true.velocity) > 0.1
    means = friction_law(true.velocity)  # of the mean velocity; the law is linear there
    np.testing.assert_allclose(true.friction[fast], means[fast], atol=1e-3)


def test_samples_are_means_by_the_trapezoidal_rule(puma: tb.Tree) -> None:
    """One step a sample: the mean of two neighbours; the acceleration is what speed gained."""
    runs = [
        run(puma, PUMA, waving(3), Sampling(2000.0, 1, averaged, 0.1), 5e-4, friction=False)
        for averaged in (False, True)
    ]
    first, mean = (done.truth for done in runs)
    for name in ("position", "velocity"):
        values = getattr(first, name)
        np.testing.assert_allclose(
            getattr(mean, name)[:-1], (values[1:] + values[:-1]) / 2, atol=1e-12
        )
    gain = np.diff(first.velocity, axis=0) * 2000
    np.testing.assert_allclose(mean.acceleration[:-1], gain, atol=1e-7)
    np.testing.assert_array_equal(mean.torque, first.torque)
    np.testing.assert_allclose(mean.wrench, first.wrench, atol=0.05 * np.abs(first.wrench).max())


@pytest.mark.parametrize("averaged", [False, True])
def test_a_sample_of_several_steps_lies_between_its_ends(puma: tb.Tree, averaged: bool) -> None:
    """Means of five steps are those of a run of five times as many samples' instants."""
    coarse = run(puma, PUMA, waving(3), Sampling(400.0, 5, averaged, 0.1), 5e-4, friction=False)
    q = coarse.truth.position
    wanted = waving(3).at(coarse.time + averaged * 0.5 / 400).q
    np.testing.assert_allclose(q, wanted, atol=5e-4)
    assert np.abs(q - waving(3).at(coarse.time + (not averaged) * 0.5 / 400).q).max() > 1e-3


def test_what_is_watched_is_what_is_recorded_and_what_went_before(puma: tb.Tree) -> None:
    seen: list[tuple[Array, Truth]] = []
    done: list[tuple[int, int]] = []
    plant = build_plant(ModelFile(PUMA), puma, 1e-3)
    rollout = simulate_motion(
        plant,
        puma,
        waving(3),
        2.0,
        60.0,
        Sampling(1000.0, 1, False, 0.3),
        progress=lambda now, total: done.append((now, total)),
        watch=lambda time, truth: seen.append((time, truth)),
    )
    assert done == [(1000, 2300), (2000, 2300), (2300, 2300)]
    time = np.concatenate([t for t, _ in seen])
    np.testing.assert_allclose(time, np.arange(-300, 2000) / 1000, atol=1e-12)
    np.testing.assert_array_equal(rollout.time, time[300:])
    for name in ("position", "velocity", "acceleration", "torque", "friction", "wrench"):
        whole = np.concatenate([getattr(truth, name) for _, truth in seen])
        np.testing.assert_array_equal(getattr(rollout.truth, name), whole[300:])
    np.testing.assert_array_equal(time[0], -0.3)
    started = waving(3).at(time[:1])
    np.testing.assert_allclose(seen[0][1].position[0], started.q[0], atol=1e-12)
    np.testing.assert_allclose(seen[0][1].velocity[0], started.qd[0], atol=1e-12)


def weaker(tree: tb.Tree, share: float) -> tb.Tree:
    joints = (replace(joint, max_effort=share * joint.max_effort) for joint in tree.joints)
    return replace(tree, joints=tuple(joints))


def test_tracking_is_the_rms_distance_from_the_reference(puma: tb.Tree) -> None:
    strong = weaker(puma, 10)
    done = run(strong, PUMA, waving(3), Sampling(500.0, 2, False, 0.2), 1e-3)
    away = done.truth.position - waving(3).at(done.time).q
    np.testing.assert_allclose(done.tracking, np.sqrt(np.mean(away**2, axis=0)), rtol=1e-9)
    assert (done.tracking > 0).all()
    assert (done.saturated == 0).all()


def test_saturation_is_the_share_of_samples_at_the_limit(puma: tb.Tree) -> None:
    """The waving takes the shoulder there."""
    done = run(puma, PUMA, waving(3), Sampling(500.0, 2, False, 0.2), 1e-3)
    limits = np.array([joint.max_effort for joint in puma.joints])
    torque = np.abs(done.truth.torque)
    assert (torque <= limits).all()
    np.testing.assert_array_equal(done.saturated, (torque == limits).mean(axis=0))
    assert 0 < done.saturated.max() < 1


def test_motors_too_weak_to_follow_lose_the_reference(puma: tb.Tree) -> None:
    with pytest.raises(SimulationDiverged, match=r"lost the reference at .*shoulder"):
        run(weaker(puma, 0.01), PUMA, waving(3), Sampling(500.0, 2, False, 0.2), 1e-3)


def test_a_run_that_blows_up_says_when(puma: tb.Tree) -> None:
    """A loop far faster than the samples it is closed over."""
    strong = weaker(puma, np.inf)
    plant = build_plant(ModelFile(PUMA), puma, 1e-3)
    with pytest.raises(SimulationDiverged, match=r"unstable near t = 1\.00 s; use a smaller step"):
        simulate_motion(plant, strong, waving(3), 1.0, 1e5, Sampling(500.0, 2, False, 0.0))
