"""What an estimate says the instruments should have read.

A prediction takes the motion as the identification does: sensed, or encoder positions
through the filter on positions.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear, pedestal_wrench
from testbed.dynamics.motion import Motion
from testbed.errors import RecordingError
from testbed.identification.filters import motion_taps
from testbed.identification.identify import Estimate, Method
from testbed.identification.settings import Settings
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree


def motion_in(recording: Recording, settings: Settings | None = None) -> tuple[Motion, slice]:
    """The motion that a recording shows, and which of its samples that is.

    Args:
        recording: Encoders, and velocities and accelerations where they were sensed.
        settings: Whose filter on positions to use; default `Settings()`.

    Returns:
        The motion, and the slice of samples that it covers: filters take both ends.
    """
    if recording.velocity is not None and recording.acceleration is not None:
        whole = slice(0, recording.samples)
        rates = recording.velocity, recording.acceleration
        return Motion(recording.time, recording.position, *rates), whole
    taps = motion_taps(recording.rate, (settings or Settings()).position_cutoff)
    reach = taps.shape[1] // 2
    inner = slice(reach, recording.samples - reach)
    if recording.samples <= 2 * reach:
        raise RecordingError("the recording is too short for the filter on positions")
    signals = [
        np.column_stack([np.convolve(q, tap[::-1], "valid") for q in recording.position.T])
        for tap in taps
    ]
    return Motion(recording.time[inner], *signals), inner


def parameters_of(estimate: Estimate, n: int, others: Array | None = None) -> Array:
    """Barycentric parameters that an estimate's minimal ones allow, (n, 10).

    Of all that do, the smallest, or those nearest to `others`: forces are the same.

    Args:
        estimate: Its first `count` values are minimal parameters.
        n: Number of joints.
        others: What to keep of the parameters that the estimate cannot tell, (n, 10).
    """
    start = np.zeros(10 * n) if others is None else others.ravel()
    gap = estimate.values[: estimate.count] - estimate.matrix @ start
    theta: Array = start + np.linalg.lstsq(estimate.matrix, gap, rcond=None)[0]
    return theta.reshape(n, 10)


def predicted_wrench(
    tree: Tree, motion: Motion, theta: Array, gravity: ArrayLike | None = None
) -> Array:
    """Wrench of the bedplate on the moving bodies, (M, 6) [N, N m].

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples.
        theta: Barycentric parameters, (n, 10).
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    return linear(tree, motion, theta[..., None], gravity)[1][..., 0]


def predicted_torque(
    tree: Tree,
    motion: Motion,
    theta: Array,
    estimate: Estimate | None = None,
    gravity: ArrayLike | None = None,
) -> Array:
    """Motor torques, (M, n) [N m or N], friction included where an estimate tells it.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples.
        theta: Barycentric parameters, (n, 10).
        estimate: Of the internal method, for friction; None for none.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    torque = linear(tree, motion, theta[..., None], gravity)[0][..., 0]
    return torque if estimate is None else torque + friction(tree, motion.qd, estimate)


def predictions(
    tree: Tree, recording: Recording, motion: Motion, estimates: Mapping[Method, Estimate]
) -> tuple[dict[Method, Array], dict[Method, Array]]:
    """The plate's wrench, pedestal included, and motor torques, by method.

    By the internal estimate the wrench is the external one's with those parameters put in that
    joint torques tell, and there is none without it; by the external one torques lack friction.

    Args:
        tree: The robot.
        recording: Says how much of the wrench is the pedestal's.
        motion: The motion it shows.
        estimates: By method, "external" first.
    """
    tare = recording.tare if recording.tare is not None else pedestal_wrench(tree)
    wrench: dict[Method, Array] = {}
    torque: dict[Method, Array] = {}
    whole = None
    for method, estimate in estimates.items():
        theta = parameters_of(estimate, tree.n, whole)
        if method == "external":
            whole = theta
        rubs = estimate if method == "internal" else None
        torque[method] = predicted_torque(tree, motion, theta, rubs)
        if whole is not None:
            wrench[method] = predicted_wrench(tree, motion, theta) + tare
    return wrench, torque


def friction(tree: Tree, speed: Array, estimate: Estimate) -> Array:
    """Friction torque that an estimate tells, (M, n) [N m or N].

    Args:
        tree: Gives joint names.
        speed: Joint velocities, (M, n) [rad/s or m/s].
        estimate: Of the internal method.
    """
    found = dict(zip(estimate.names, estimate.values, strict=True))
    dry, wet = (
        np.array([found.get(f"{kind}/{name}", 0.0) for name in tree.names])
        for kind in ("coulomb", "viscous")
    )
    return np.asarray(dry * np.sign(speed) + wet * speed)
