"""Predicted torques and wrenches along the motion of a recording, with their variances."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.dynamics.newton_euler import Motion, linear_inverse_dynamics
from testbed.core.estimation.estimate import Estimate, EstimateSummary
from testbed.core.estimation.problem import recording_tare
from testbed.core.estimation.regression.normal_equations import matrix_square_root
from testbed.core.estimation.regression.windows import motion_taps
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.geometry import with_recorded_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import longest_segment
from testbed.core.robot.friction import ROOM_TEMPERATURE, term_torque
from testbed.core.robot.tree import Tree


def longest_segment_motion(
    recording: Recording, settings: Settings = DEFAULTS
) -> tuple[Motion, slice]:
    """Joint motion in a recording's longest segment without gaps, with its sample range.

    Velocities and accelerations are used as recorded if the recording has both. Otherwise positions
    are low-pass filtered and differentiated as in identification.

    Args:
        recording: The recording.
        settings: Settings of the low-pass filter.

    Returns:
        The motion, and the slice of the recording's samples that it covers. At either end the
        filter shortens the segment by half the filter's length.

    Raises:
        RecordingError: The segment is not longer than the filter.
    """
    first, last = longest_segment(recording)
    segment = recording.part(first, last)
    if segment.velocity is not None and segment.acceleration is not None:  # both
        rates = segment.velocity, segment.acceleration
        return Motion(segment.time, segment.position, *rates), slice(first, last)
    fitted = settings.fitted(segment.rate)
    taps = motion_taps(segment.rate, fitted.position_low_pass)
    half_length = taps.shape[1] // 2
    covered = slice(first + half_length, last - half_length)
    if segment.samples <= 2 * half_length:
        raise RecordingError("the recording is too short for the filter on positions")
    signals = (
        np.apply_along_axis(np.convolve, 0, segment.position, tap[::-1], "valid")
        for tap in taps
    )
    return Motion(recording.time[covered], *signals), covered


def barycentric_parameters(estimate: Estimate, others: Array | None = None) -> Array:
    """Barycentric parameters consistent with an estimate's base parameters, (n, 10).

    The parameters theta solve S theta = delta, where S is the matrix of the minimal set and delta
    the base parameters. Of all solutions, which give the same forces in the estimate's signal, the
    one of minimum norm, or nearest to `others`, is returned.

    Args:
        estimate: Estimate from either signal, for a robot of n joints.
        others: Barycentric parameters from which unidentifiable combinations are taken, (n, 10);
            default zero.
    """
    matrix = estimate.minimal.matrix
    reference = np.zeros(matrix.shape[1]) if others is None else others.ravel()
    residual = estimate.base.values - matrix @ reference
    theta: Array = reference + np.linalg.lstsq(matrix, residual, rcond=None)[0]
    return estimate.minimal.with_carried_mass(theta).reshape(-1, 10)


def predicted_signals(
    tree: Tree,
    recording: Recording,
    motion: Motion,
    estimates: Mapping[Signal, Estimate],
) -> tuple[dict[Signal, Array], dict[Signal, Array]]:
    """Wrenches and motor torques predicted along a motion, keyed by the estimate's signal.

    Joint torques do not determine all parameters of the wrench. An estimate from torques therefore
    predicts a wrench only together with an estimate from the plate, which supplies the missing
    combinations of parameters. Torques predicted from the plate contain no friction and no rotor
    inertia.

    Args:
        tree: The robot; its masses are not used, except for the pedestal's weight if the recording
            has no tare.
        recording: Recording with gravity and the pedestal's share of the wrench.
        motion: Motion of M samples within the recording.
        estimates: Estimates keyed by signal, "wrench" and "torque", in any order.

    Returns:
        Wrenches of the bedplate on the robot, including the pedestal, in the bedplate frame about
        its origin, (M, 6) [N, N m]; and motor torques, (M, n) [N m or N]. Both are keyed by signal.
    """
    tree = with_recorded_gravity(tree, recording)
    tare = recording_tare(tree, recording)
    theta = np.zeros((tree.n, 10, len(estimates)))
    methods = [method for method in SIGNALS if method in estimates]
    for k, method in enumerate(methods):  # the estimate by the plate comes first
        theta[..., k] = barycentric_parameters(
            estimates[method], theta[..., 0] if k else None
        )
    joint_torques, wrenches = linear_inverse_dynamics(tree, motion, theta)
    first = int(np.searchsorted(recording.time, motion.t[0]))
    excess_temperature = recording.temperature
    excess_temperature = (
        None
        if excess_temperature is None
        else excess_temperature[first : first + motion.samples] - ROOM_TEMPERATURE
    )
    torque = {
        method: joint_torques[..., k]
        + joint_term_torque(motion, estimates[method], excess_temperature)
        for k, method in enumerate(methods)
    }
    wrench_methods = methods if "wrench" in methods else []
    return {
        method: wrenches[..., k] + tare for k, method in enumerate(wrench_methods)
    }, torque


def joint_term_torque(
    motion: Motion, estimate: Estimate, excess_temperature: Array | None = None
) -> Array:
    """Torque of friction, rotors and other joint terms of an estimate, (M, n) [N m or N].

    Terms proportional to temperature are zero at 25 degC, and if no temperatures are given. Other
    terms with a multiplier (drift of offsets, load) are omitted.

    Args:
        motion: Motion of M samples, joints in the order of `estimate.joints`.
        estimate: Estimate from either signal. An estimate from the plate has no joint terms, so its
            torque is zero.
        excess_temperature: `temperature - 25 degC`, (M, n) [K]; None for 25 degC.
    """
    torque = np.zeros_like(motion.qd)
    drives = estimate.drives
    if drives is not None:
        coefficients = estimate.values[estimate.minimal.count :]
        for term, value in zip(drives.terms, coefficients, strict=True):
            is_known = excess_temperature is not None and term.law.by == "temperature"
            scale = (
                excess_temperature[:, term.joint]
                if excess_temperature is not None and is_known
                else 0.0
            )
            torque += value * term_torque(
                drives.tree, term, motion.qd, motion.qdd, scale
            )
    return torque


def steady_joint_torque(speed: Array, estimate: Estimate) -> Array:
    """Torque of an estimate's joint terms at constant speeds and 25 degC, (M, n) [N m or N].

    Args:
        speed: Joint velocities, (M, n) [rad/s or m/s].
        estimate: Estimate from either signal.
    """
    steady = Motion(
        np.arange(len(speed), dtype=float), speed, speed, np.zeros_like(speed)
    )
    return joint_term_torque(steady, estimate)


def prediction_variances(
    tree: Tree, recording: Recording, motion: Motion, estimate: Estimate
) -> Array:
    """Variances of the predicted signal due to the covariance of the parameters, (M, C).

    The C columns are the channels of the estimate's signal: six of the wrench, or n joint torques.
    The variance of the model-error correction is not included.

    Args:
        tree: The robot; only its geometry is used.
        recording: Recording with gravity.
        motion: Motion of M samples.
        estimate: Estimate from either signal.
    """
    tree = with_recorded_gravity(tree, recording)
    terms = () if estimate.drives is None else estimate.drives.terms
    root = matrix_square_root(covariance_without_correction(estimate))
    body_roots, term_roots = np.split(root, [estimate.minimal.count])
    lift = np.linalg.pinv(estimate.minimal.matrix) @ body_roots
    theta = estimate.minimal.with_carried_mass(lift).reshape(tree.n, 10, -1)
    blocks = []
    for first in range(0, motion.samples, BLOCK_SAMPLES):
        part = motion[first : first + BLOCK_SAMPLES]
        columns = linear_inverse_dynamics(tree, part, theta)[
            estimate.method == "wrench"
        ]
        for term, term_root in zip(
            terms, term_roots, strict=False
        ):  # other unknowns follow
            torque = term_torque(tree, term, part.qd, part.qdd)
            columns += torque[..., None] * term_root
        blocks.append((columns**2).sum(axis=2))
    return np.concatenate(blocks)


def covariance_without_correction(estimate: EstimateSummary) -> Array:
    """Covariance of the p parameters without the effect of the model-error correction, (p, p).

    The validation separately adds the variance of the model errors, which includes that effect. For
    an estimate without correction, the covariance is unchanged.
    """
    if estimate.correction is None:
        return estimate.covariance
    return np.asarray(estimate.covariance - estimate.correction.covariance)


BLOCK_SAMPLES = 4096
"""Number of samples of which variances are computed at a time."""
