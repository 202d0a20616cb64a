"""What the estimates say that the instruments should read, beside what they read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import joint_forces
from testbed.errors import RecordingError
from testbed.experiment.predictions import Predictions, Signal, predict
from testbed.experiment.run import assemble_run
from testbed.identification.estimate import METHODS, SIGNAL_OF
from testbed.identification.filters import row_weights
from testbed.identification.settings import Settings
from testbed.recordings.columns import AXES
from testbed.recordings.recording import Recording
from testbed.robot.friction import friction_torque
from tests.helpers.ideal import ideal
from tests.helpers.runs import ROBOTS, noisy, robot, run_of, without

pytestmark = pytest.mark.slow


def signal_of(found: Predictions, kind: str) -> Signal:
    return next(signal for signal in found.signals if signal.kind == kind)


@pytest.mark.parametrize("name", ROBOTS)
def test_without_noise_predictions_are_what_was_measured(name: str) -> None:
    """On a motion that no estimate has seen."""
    tree = robot(name)
    other = ideal(tree, seed=1)
    found = predict(run_of(tree, ideal(tree)), other)
    wrench, torque = signal_of(found, "wrench"), signal_of(found, "torque")
    for method in METHODS:
        assert np.abs(wrench.residual(method)).max() < 1e-8 * np.abs(wrench.measured).max()
    assert np.abs(torque.residual("internal")).max() < 1e-8 * np.abs(torque.measured).max()
    np.testing.assert_array_equal(wrench.measured, other.measured("wrench"))
    assert wrench.channels == AXES
    assert torque.channels == tree.names
    units = ["N m" if joint.revolute else "N" for joint in tree.joints]
    assert list(torque.units) == units


@pytest.mark.parametrize("name", ROBOTS)
def test_what_the_plate_leaves_unexplained_is_friction(name: str) -> None:
    tree = robot(name)
    found = predict(run_of(tree, ideal(tree)))
    assert found.unexplained_torque is not None
    true = friction_torque(tree, found.motion.qd)
    scale = np.abs(found.recording.measured("torque")).max()
    np.testing.assert_allclose(found.unexplained_torque, true, atol=1e-8 * scale)
    law = found.friction(found.motion.qd)
    assert law is not None
    np.testing.assert_allclose(law, true, atol=1e-8 * scale)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("signal", ["wrench", "torque"])
def test_only_what_was_measured_is_compared(name: str, signal: str) -> None:
    tree = robot(name)
    lacks = {"wrench": "torque", "torque": "wrench"}[signal]
    found = predict(run_of(tree, without(noisy(ideal(tree)), lacks)))
    assert [each.kind for each in found.signals] == [signal]
    assert found.unexplained_torque is None
    (method,) = [m for m in METHODS if SIGNAL_OF[m] == signal]
    assert set(found.signals[0].predicted) == {method}
    assert (found.friction(np.ones((1, tree.n))) is None) == (method == "external")


def test_residuals_are_those_of_the_identification() -> None:
    """With sensed kinematics and no filter, rms for rms."""
    tree = robot("ur5")
    run = run_of(tree)
    found = predict(run)
    for method in METHODS:
        estimate = run.estimates[method]
        rest = signal_of(found, SIGNAL_OF[method]).residual(method)
        if method == "external":  # no row is dropped
            np.testing.assert_allclose(np.sqrt(np.mean(rest**2, axis=0)), estimate.residual)


def encoders(recording: Recording) -> Recording:
    """The recording of an instrument that senses positions alone."""
    return replace(recording, velocity=None, acceleration=None)


@pytest.mark.parametrize("samples", [5, 20, 36])
def test_a_recording_shorter_than_the_filter_is_shown_all_the_same(samples: int) -> None:
    tree = robot("puma")
    whole = run_of(tree)
    short = encoders(ideal(tree)).part(0, samples)
    run = assemble_run(tree, short, name="short", settings=Settings())
    assert run.estimates == {}
    found = predict(run)
    assert found.motion.samples == samples
    np.testing.assert_array_equal(found.motion.q, short.position)
    states = ideal(tree).part(0, samples)
    speed, size = states.measured("velocity"), np.abs(states.measured("velocity")).max()
    np.testing.assert_allclose(found.motion.qd[1:-1], speed[1:-1], atol=2e-3 * size)
    turning = states.measured("acceleration")
    inner = found.motion.qdd[2:-2] - turning[2:-2]
    assert np.abs(inner).max(initial=0.0) < 0.02 * np.abs(turning).max()
    assert len(predict(whole, short).signals[0].predicted) == 2


def test_another_robots_recording_is_refused() -> None:
    with pytest.raises(RecordingError, match="of another robot"):
        predict(run_of(robot("puma")), ideal(robot("ur5")))


def test_one_low_pass_for_everything() -> None:
    found = predict(run_of(robot("puma")))
    smooth = found.smoothed(10.0)
    weights = row_weights(found.recording.rate, 10.0)
    reach = len(weights) // 2
    inner = slice(reach, found.motion.samples - reach)
    np.testing.assert_array_equal(smooth.motion.t, found.motion.t[inner])
    for kind in ("wrench", "torque"):
        before, after = signal_of(found, kind), signal_of(smooth, kind)

        def passed(values: Array) -> Array:
            return np.column_stack([np.convolve(v, weights, "valid") for v in values.T])

        np.testing.assert_allclose(after.measured, passed(before.measured), rtol=1e-12, atol=1e-9)
        for method in METHODS:
            expected = passed(before.residual(method))
            np.testing.assert_allclose(after.residual(method), expected, rtol=1e-9, atol=1e-9)


def test_a_motion_too_short_for_the_low_pass_is_left_as_it_is() -> None:
    tree = robot("puma")
    found = predict(run_of(tree), ideal(tree).part(0, 30))
    assert found.smoothed(1.0) is found


def test_gravity_is_the_recordings() -> None:
    moon = [0.0, 0.4, -1.6]
    tree = robot("gantry").with_gravity(moon)
    recording = replace(ideal(tree), facts={"gravity": moon})
    found = predict(run_of(robot("gantry"), recording))
    torque = joint_forces(tree, found.motion) + friction_torque(tree, found.motion.qd)
    predicted = signal_of(found, "torque").predicted["internal"]
    np.testing.assert_allclose(predicted, torque, atol=1e-8 * np.abs(torque).max())


def test_the_run_and_its_recording_are_what_they_were() -> None:
    run = run_of(robot("puma"))
    found = predict(run)
    assert found.run is run
    assert found.recording is run.recording
    assert isinstance(found.recording, tb.Recording)
