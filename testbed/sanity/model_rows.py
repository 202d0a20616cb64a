"""What a model with rough masses says of a recording, beside what was measured.

Each body's share of every torque and of the wrench stands by itself, so that masses can be
scaled one by one. Everything passes one low-pass and is thinned out: a few hundred rows tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear
from testbed.dynamics.motion import Motion
from testbed.identification.filters import motion_taps, row_weights
from testbed.parameters.barycentric import standard, to_barycentric
from testbed.robot.tree import Tree
from testbed.sanity.thinning import thinned

ROW_CUTOFF, POSITION_CUTOFF = 4.0, 10.0
"""Of the low-pass on rows and on positions [Hz]; less where the recording is slower."""

ROWS_A_SECOND = 14.0
"""Rows kept: a few for each independent one."""

FINE = 40.0
"""Instants a second at which the model is asked before rows are filtered [Hz]."""

MOST_INSTANTS = 1200
"""At which the model is asked; of a longer recording the middle is taken."""


REACH, LIGHT = 0.05, 0.1
"""By which centres of mass may be wrong along each axis [m]; and part of the robot's mass that a
body counts with at least: tools that the model does not know are at light links."""

MEDIAN = 0.4549
"""Of the square of a normal number of variance one."""


@dataclass(frozen=True, eq=False)
class ModelRows:
    """Rows of C channels, n bodies, n joints.

    Attributes:
        bodies: Share of each body by the model file, (T, C, n) [N m or N].
        shifts: What moving each body's centre of mass by `REACH` along x, y, z adds, (T, C, 3 n).
        speed: Of the joints, (T, n) [rad/s or m/s].
        sign: Its sign, filtered alike, (T, n).
        acceleration: (T, n) [rad/s^2 or m/s^2].
        measured: (T, C) [N m or N].
        joints: How many of the channels are joints' torques; the others are the wrench's.
        noise: Variance of the rows' own noise, (C,).
    """

    bodies: Array
    shifts: Array
    speed: Array
    sign: Array
    acceleration: Array
    measured: Array
    joints: int
    noise: Array

    @property
    def noise_share(self) -> Array:
        """Part of each channel's variance that is its own noise, (C,)."""
        found: Array = self.noise / np.maximum(self.measured.var(axis=0), 1e-30)
        return found


def model_rows(
    tree: Tree, position: Array, torque: Array | None, wrench: Array | None, rate: float
) -> ModelRows:
    """Rows of a recording.

    Args:
        tree: The robot, its masses roughly right.
        position: (M, n) [rad or m].
        torque: (M, n) [N m or N], if measured.
        wrench: (M, 6) [N, N m], if measured.
        rate: Samples a second [Hz].
    """
    there = [signal for signal in (torque, wrench) if signal is not None]
    slow = min(1.0, rate / (6 * POSITION_CUTOFF))  # slow recordings are filtered lower
    taps = motion_taps(rate, slow * POSITION_CUTOFF)
    smooth = row_weights(rate, slow * POSITION_CUTOFF)
    step = max(1, int(rate / FINE))
    lost = max(taps.shape[1], len(smooth)) // 2
    part = _middle(len(position), 2 * lost + MOST_INSTANTS * step)
    q, qd, qdd = (thinned(position[part], tap[::-1], lost, step) for tap in taps)
    measured = np.hstack([thinned(signal[part], smooth, lost, step) for signal in there])
    joints, base = linear(tree, Motion(np.arange(len(q)) * step / rate, q, qd, qdd), _shares(tree))
    bodies = [shares for shares, signal in ((joints, torque), (base, wrench)) if signal is not None]
    weights = row_weights(rate / step, slow * ROW_CUTOFF)
    kept = max(1, int(rate / step / ROWS_A_SECOND))
    reach = len(weights) // 2

    def filtered(rows: Array) -> Array:
        flat = thinned(rows.reshape(len(rows), -1), weights, reach, kept)
        return flat.reshape(-1, *rows.shape[1:])

    shares = filtered(np.concatenate(bodies, axis=1))
    return ModelRows(
        bodies=shares[..., : tree.n],
        shifts=shares[..., tree.n :],
        speed=filtered(qd),
        sign=filtered(np.sign(qd)),
        acceleration=filtered(qdd),
        measured=filtered(measured),
        joints=0 if torque is None else tree.n,
        noise=_noise(np.hstack(there)) * 2 * slow * ROW_CUTOFF / rate,
    )


def _noise(signals: Array) -> Array:
    """Variance of white noise, by the differences from sample to sample that motion does not make.

    Args:
        signals: (M, C).
    """
    second = np.diff(signals, 2, axis=0) ** 2
    found: Array = np.median(second, axis=0) / (6 * MEDIAN)
    return found


def _shares(tree: Tree) -> Array:
    """Barycentric parameters of each body alone, then of its shifts, (n, 10, n + 3 n)."""
    n, own = tree.n, standard(tree)
    least = LIGHT * own[:, 0].sum()
    alone, bodies = np.zeros((n, 10, 4 * n)), np.arange(n)
    alone[bodies, :, bodies] = own
    for axis in range(3):
        alone[bodies, 1 + axis, n + 3 * bodies + axis] = REACH * np.maximum(own[:, 0], least)
    return to_barycentric(tree, alone)


def _middle(samples: int, most: int) -> slice:
    first = max(0, (samples - most) // 2)
    return slice(first, first + most)
