"""What an estimate says the instruments should have read.

A prediction takes the motion as the identification does: sensed, or encoder positions
through the filter on positions.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear
from testbed.dynamics.motion import Motion
from testbed.errors import RecordingError
from testbed.identification.estimate import METHODS, Estimate, Method
from testbed.identification.problem import tare_of
from testbed.identification.regression.filters import motion_taps
from testbed.identification.settings import DEFAULTS, Settings
from testbed.recordings.geometry import in_its_gravity
from testbed.recordings.recording import Recording
from testbed.robot.friction import term_torque
from testbed.robot.tree import Tree


def motion_in(recording: Recording, settings: Settings = DEFAULTS) -> tuple[Motion, slice]:
    """The motion that a recording shows, and which of its samples that is.

    Args:
        recording: Encoders, and velocities and accelerations where they were sensed.
        settings: Whose filter on positions to use; default those of `Settings()`.

    Returns:
        The motion, and the slice of samples that it covers: filters take both ends.
    """
    if recording.velocity is not None and recording.acceleration is not None:  # both
        whole = slice(0, recording.samples)
        rates = recording.velocity, recording.acceleration
        return Motion(recording.time, recording.position, *rates), whole
    fitted = settings.fitted(recording.rate)
    taps = motion_taps(recording.rate, fitted.position_low_pass)
    reach = taps.shape[1] // 2
    inner = slice(reach, recording.samples - reach)
    if recording.samples <= 2 * reach:
        raise RecordingError("the recording is too short for the filter on positions")
    signals = [
        np.column_stack([np.convolve(q, tap[::-1], "valid") for q in recording.position.T])
        for tap in taps
    ]
    return Motion(recording.time[inner], *signals), inner


def parameters_of(estimate: Estimate, others: Array | None = None) -> Array:
    """Barycentric parameters that an estimate's minimal ones allow, (n, 10).

    Of all that do, the smallest, or those nearest to `others`: forces are the same.

    Args:
        estimate: Of either method.
        others: What to keep of the parameters that the estimate cannot identify, (n, 10).
    """
    base = estimate.base
    start = np.zeros(base.matrix.shape[1]) if others is None else others.ravel()
    gap = base.values - base.matrix @ start
    theta: Array = start + np.linalg.lstsq(base.matrix, gap, rcond=None)[0]
    return estimate.minimal.carried(theta).reshape(-1, 10)


def predictions(
    tree: Tree,
    recording: Recording,
    motion: Motion,
    estimates: Mapping[Method, Estimate],
    gravity: ArrayLike | None = None,
) -> tuple[dict[Method, Array], dict[Method, Array]]:
    """What plate and drives should have shown along a motion, by method.

    By the internal estimate the wrench is the external one's with those parameters put in that
    joint torques identify, and there is none without it; by the external one torques lack what the
    joints add of their own.

    Args:
        tree: The robot; its masses do not matter.
        recording: Says its gravity, and how much of the wrench is the pedestal's.
        motion: The motion it shows.
        estimates: By method, "external" and "internal", in any order.
        gravity: As for `identify`.

    Returns:
        Wrenches, pedestal included, (M, 6) [N, N m]; and motor torques, (M, n) [N m or N].
    """
    tree = in_its_gravity(tree, recording, gravity)
    tare = tare_of(tree, recording)
    theta = np.zeros((tree.n, 10, len(estimates)))
    methods = [method for method in METHODS if method in estimates]
    for k, method in enumerate(methods):  # the external one comes first
        theta[..., k] = parameters_of(estimates[method], theta[..., 0] if k else None)
    joints, plate = linear(tree, motion, theta)
    torque = {m: joints[..., k] + own_torque(motion, estimates[m]) for k, m in enumerate(methods)}
    whole = methods if "external" in methods else []
    return {m: plate[..., k] + tare for k, m in enumerate(whole)}, torque


def own_torque(motion: Motion, estimate: Estimate) -> Array:
    """What an estimate's joint terms add to the torques, (M, n) [N m or N].

    Args:
        motion: M samples, joints in the order of `estimate.joints`.
        estimate: Of either method; the external one knows none.
    """
    found = np.zeros_like(motion.qd)
    drives = estimate.drives
    if drives is not None:
        own = estimate.values[estimate.minimal.count :]
        for term, value in zip(drives.terms, own, strict=True):
            found += value * term_torque(drives.tree, term, motion.qd, motion.qdd)
    return found


def friction(speed: Array, estimate: Estimate) -> Array:
    """What an estimate's joint terms add to the torques at steady speed, (M, n) [N m or N].

    Args:
        speed: Joint velocities, (M, n) [rad/s or m/s], in the order of `estimate.joints`.
        estimate: Of the internal method.
    """
    steady = Motion(np.arange(len(speed), dtype=float), speed, speed, np.zeros_like(speed))
    return own_torque(steady, estimate)
