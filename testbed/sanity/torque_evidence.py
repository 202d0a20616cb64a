"""How likely torques are, whatever the masses within reason: evidence with the model file as prior.

A joint's torques are t = Y theta + F f + e. Parameters theta lie about the model file's (masses
within a half, centres within some centimetres), friction brakes (F: viscous, dry, a constant, the
rotor), and what is left, e, lasts: model errors are no white noise. Then t is normal, and log N(t)
says how well one recorded column, in one sense, can be a joint's torques; to it comes how much
likelier the data make it that friction takes power, and gives none. A free set of parameters
would explain anything that is short; this does not. Where a plate has told parameters, what it
has told is the prior.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.parameters.barycentric import standard, to_barycentric
from testbed.robot.free_base import FREE
from testbed.robot.tree import Tree

MASS, REACH, LIGHT = 0.4, 0.03, 0.1
"""Relative sigma of masses, sigma of centres of mass [m]; and part of the robot's mass that a body
counts with at least: tools that the model does not know are at light links."""

FRICTION, SPREAD = (0.3, 0.3, 0.0, 0.1), 0.3
"""Viscous, dry, constant and rotor's part of a torque's rms that are expected, and their sigma."""

MEMORY, LASTING = 0.3, 0.9
"""Time over which what is left is correlated [s], and which part of it is."""

LEFT = np.geomspace(0.1, 0.5, 12)
"""Rms of what may be left, in parts of a torque's rms."""

FAINT = 0.005
"""Part of all torques' rms that a torque counts with at least."""

NOTHING = 1e-4
"""Part of the most by which parameters move torques below which they do not."""

SURELY_NOT = -12.0
"""Log probability at least of friction that drives: what a model lacks may look like it."""

CLEAR = 0.01
"""Part of a torque's variance that bodies alone must explain for its size to be told."""


def prior_root(tree: Tree) -> Array:
    """Sigmas of the standard parameters, on the barycentric ones, (10 n, 10 n)."""
    own = standard(tree)
    mass = np.maximum(own[:, 0], LIGHT * own[:, 0].sum())
    centre = np.linalg.norm(own[:, 1:4], axis=1) / np.where(own[:, 0] > 0, own[:, 0], 1.0)
    reach = REACH + MASS * centre
    sigma = np.empty((tree.n, 10))
    sigma[:, 0] = MASS * mass
    sigma[:, 1:4] = (mass * reach)[:, None]
    sigma[:, 4:] = MASS * np.abs(own[:, 4:]) + (mass * reach**2)[:, None]
    if tree.floating:
        sigma[: FREE - 1] = 0.0  # what carries a free base's coordinates has no matter
    spread = np.diag(sigma.ravel()).reshape(tree.n, 10, 10 * tree.n)
    found: Array = to_barycentric(tree, spread).reshape(10 * tree.n, 10 * tree.n)
    return found


@cache
def _whitening(count: int, spacing: float) -> Array:
    """The matrix that makes what is left white, (T, T)."""
    from scipy.linalg import solve_triangular

    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    covariance = LASTING * np.exp(-apart * spacing / MEMORY) + (1 - LASTING) * np.eye(count)
    root = np.linalg.cholesky(covariance)
    found: Array = solve_triangular(root, np.eye(count), lower=True)
    return found


class TorqueEvidence:
    """How well each recorded column can be each joint's torques."""

    def __init__(
        self,
        rows: Array,
        mean: Array,
        root: Array,
        velocity: Array,
        acceleration: Array,
        torque: Array,
        spacing: float,
    ) -> None:
        """Products of rows and torques.

        Args:
            rows: Of the torques on all barycentric parameters, (T, n, 10 n).
            mean: Of the parameters, (10 n,).
            root: Root of their covariance, (10 n, k).
            velocity: (T, n).
            acceleration: (T, n).
            torque: As recorded, (T, n).
            spacing: From one instant to the next [s].
        """
        self._torque = torque
        every = float(np.sqrt((torque**2).mean())) + 1e-12
        self._rms = np.maximum(np.sqrt((torque**2).mean(axis=0)), FAINT * every)
        self.constant = torque.std(axis=0) < 1e-3 * self._rms
        white = _whitening(len(torque), round(spacing, 6))
        self._white_torque = white @ torque
        self._raw, self._columns, self._power, self._moved = [], [], [], []
        for joint in range(rows.shape[1]):
            moved = rows[:, joint] @ root
            moved = moved[:, np.abs(moved).max(axis=0) > 0]
            self._moved.append(float(moved.var(axis=0).sum()))
            friction = _friction(velocity[:, joint], acceleration[:, joint])
            foretold = rows[:, joint] @ mean
            raw = np.column_stack([foretold, friction])
            self._raw.append(raw)
            wide, spread, _ = np.linalg.svd(white @ moved, full_matrices=False)
            moves = spread > NOTHING * spread[:1]
            self._columns.append(np.hstack([white @ raw, (wide * spread)[:, moves]]))
            self._power.append(friction.T @ velocity[:, joint] * [1, 1, 0, 0])
        self._count = len(torque)

    def log(self, joint: int, column: int, gain: float = 1.0) -> Array:
        """Log evidence that a column is a joint's torques, in its sense and in the other, (2,).

        Args:
            joint: Of the robot.
            column: Of the recording.
            gain: Recorded numbers are so many times the torques.
        """
        if self.constant[column]:
            return np.zeros(2)
        columns = self._scaled(self._columns[joint], gain, column)
        expected = columns[:, 0] + columns[:, 1:5] @ FRICTION
        moved = np.hstack([columns[:, 1:5] * SPREAD, columns[:, 5:]])
        spread, axes = eigh(moved.T @ moved)
        spread = np.maximum(spread, 0.0)
        target = self._white_torque[:, column] / self._rms[column]
        variance = LEFT**2
        within = spread[:, None] + variance
        size = np.log(within).sum(axis=0) + (self._count - len(spread)) * np.log(variance)
        power = SPREAD * (self._power[joint] @ axes[:4])  # of friction, along the axes
        found = []
        for sense in (1.0, -1.0):
            rest = sense * target - expected
            along = axes.T @ (moved.T @ rest)
            square = (rest @ rest - (along[:, None] ** 2 / within).sum(axis=0)) / variance
            logs = -0.5 * (square + size)
            best = int(np.argmax(logs))
            mean = self._power[joint] @ FRICTION + power @ (along / within[:, best])
            sigma = np.sqrt(power**2 @ (variance[best] / within[:, best]))
            found.append(float(logs[best]) + _log_positive(mean, sigma))
        return np.array(found)

    def left(self, joint: int, column: int, sense: float, gain: float = 1.0) -> float:
        """Part of a torque's variance that the mean's masses and friction that brakes leave.

        Args:
            joint: Of the robot.
            column: Of the recording.
            sense: 1 or -1.
            gain: Recorded numbers are so many times the torques.
        """
        from scipy.optimize import nnls

        if self.constant[column]:
            return 0.0
        columns = self._raw[joint][:, :5] - self._raw[joint][:, :5].mean(axis=0)
        true = sense * (self._torque[:, column] - self._torque[:, column].mean()) / gain
        _, rest = nnls(columns[:, [1, 2, 4]], true - columns[:, 0])
        return float(rest**2 / (true @ true))

    def spread(self, joint: int, column: int) -> float:
        """Part of a torque's variance by which parameters may move what is expected.

        Args:
            joint: Of the robot.
            column: Of the recording.
        """
        return self._moved[joint] / max(float(self._torque[:, column].var()), 1e-30)

    def size(self, joint: int, column: int, told_times: float = 1.0) -> float:
        """Times what the mean's masses make that a column is; nan where they do not tell."""
        columns, target = self._columns[joint][:, :5], self._white_torque[:, column]
        values, rest = np.linalg.lstsq(columns, target, rcond=1e-9)[:2]
        others = np.linalg.lstsq(columns[:, 1:], target, rcond=1e-9)[1]
        if not (len(rest) and len(others)):
            return float("nan")
        whole = float(((target - target.mean()) ** 2).sum())
        told = float(others[0] - rest[0])
        return (
            float(values[0])
            if told > max(CLEAR * whole, told_times * float(rest[0]))
            else float("nan")
        )

    def _scaled(self, columns: Array, gain: float, column: int) -> Array:
        """Columns of one scale: mean, friction, what parameters may move."""
        scale = np.full(columns.shape[1], gain / self._rms[column])
        scale[1:5] = 1.0
        found: Array = columns * scale
        return found


def _log_positive(mean: float, sigma: float) -> float:
    """Log probability that a normal number is positive, down to `SURELY_NOT`."""
    from scipy.special import log_ndtr

    return max(float(log_ndtr(mean / sigma)), SURELY_NOT) if sigma > 0 else 0.0


def _friction(velocity: Array, acceleration: Array) -> Array:
    """Viscous and dry friction, a constant, the rotor; of size one, (T, 4)."""
    speed = velocity / max(float(np.abs(velocity).max()), 1e-9)
    rotor = acceleration / max(float(np.abs(acceleration).max()), 1e-9)
    dry = np.tanh(100 * speed)
    found: Array = np.column_stack([speed, dry, np.ones(len(speed)), rotor])
    return found
