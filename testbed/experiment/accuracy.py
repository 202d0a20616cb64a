"""How well estimates know a robot, in the few numbers that a headline has room for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import regressor
from testbed.dynamics.motion import Motion
from testbed.identification.estimate import Estimate, Method
from testbed.parameters.barycentric import barycentric
from testbed.parameters.minimal_set import MinimalSet, minimal_set, selection
from testbed.recordings.columns import PLATE_UNITS
from testbed.robot.tree import Tree

INSTANTS = 400
"""Of a motion on which predictions are held against the truth, about."""

NOTHING = 1e-12
"""Signals below this are none [N, N m]."""


@dataclass(frozen=True)
class Accuracy:
    """What one estimate predicts beside what its robot does, without noise.

    Attributes:
        wrench: Rms error of the base wrench over its rms, both about their means, which are the
            weight and the plate's zero; of forces and moments the larger. None for an estimate
            that does not tell it, as that of joint torques.
        torque: Rms error of the joint torques that the bodies need, friction apart, over their
            rms; of rotary and of sliding joints the larger. None where they need none.
    """

    wrench: float | None
    torque: float | None


def accuracies(
    tree: Tree,
    estimates: Mapping[Method, Estimate],
    zeros: bool | Sequence[str],
    motion: Motion,
) -> dict[Method, Accuracy]:
    """How well estimates predict a motion, by method.

    Args:
        tree: The robot with its true inertias, under the recording's gravity.
        estimates: By method.
        zeros: Which zeros were taken as known, as in `minimal_set`.
        motion: What the robot does, M samples.
    """
    some = motion[:: max(1, motion.samples // INSTANTS)]
    dynamic = minimal_set(tree, "dynamic", zeros=zeros)
    units = ["N m" if joint.revolute else "N" for joint in tree.joints]
    found: dict[Method, Accuracy] = {}
    for method, estimate in estimates.items():
        own, values = estimate.minimal, estimate.base.values
        wrench = None
        if method == "external":
            wrench = _share(tree, some, own, values, PLATE_UNITS, about_mean=True)
            try:
                values = selection(dynamic, own) @ values
            except ValueError:  # a plate that tells changes only
                found[method] = Accuracy(wrench, None)
                continue
        torque = _share(tree, some, dynamic, values, units, about_mean=False)
        found[method] = Accuracy(wrench, torque)
    return found


def _share(
    tree: Tree,
    motion: Motion,
    minimal: MinimalSet,
    values: Array,
    units: Sequence[str],
    *,
    about_mean: bool,
) -> float | None:
    """Rms error of what parameters predict over the rms of what is true, for the worse unit."""
    columns = regressor(tree, motion, minimal)
    truth = minimal.values(barycentric(tree))
    signal, error = columns @ truth, columns @ (values - truth)
    if about_mean:
        signal, error = (each - each.mean(axis=0) for each in (signal, error))
    return share_of_signal(np.linalg.norm(error, axis=0), np.linalg.norm(signal, axis=0), units)


def share_of_signal(error: Array, signal: Array, units: Sequence[str]) -> float | None:
    """Rms error over the signal's rms; of channels of several units the worst, None without signal.

    Args:
        error: Root of the sum of squares of each channel, (C,) [N, N m].
        signal: The same of what they should be, (C,).
        units: One a channel.
    """
    shares = []
    for unit in dict.fromkeys(units):
        same = np.array([each == unit for each in units])
        size = float(np.linalg.norm(signal[same]))
        if size > NOTHING:
            shares.append(float(np.linalg.norm(error[same])) / size)
    return max(shares, default=None)
