"""How likely recorded columns are the joints' torques, and which is whose, in what sense and size.

A joint's torques are t = Y theta + F f + e. Parameters theta lie about the model file's (`Prior`),
friction brakes (F: viscous, dry, a constant, the
rotor), and what is left, e, lasts: model errors are no white noise. Then t is normal, and log N(t)
says how well one recorded column, in one sense, can be a joint's torques; to it comes how much
likelier the data make it that friction takes power, and gives none. A free set of parameters
would explain anything that is short; this does not. Where a plate determines parameters, their
posterior is the prior here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.importing.check.instants import Instants
from testbed.importing.check.remedies import MOST_JOINTS, Hypothesis

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

CLEAR, TIMES = 0.01, 5.0
"""Part of a torque's variance that bodies must explain for its size to be known, and times what is
left, for it to be said."""

SIGN, GAIN, ORDER = 3.0, 8.0, 5.0
"""What a torque of the other sense, one of another size, and another order must explain [nats]."""

LARGE = 2.5
"""Times that a torque may be too large or too small and count as being of its size."""


class ColumnFit(NamedTuple):
    """With which sense and gain a column is a joint's torques at the least cost [nats]."""

    cost: float
    sense: float
    gain: float


class TorqueEvidence:
    """How well each recorded column can be each joint's torques."""

    def __init__(self, rows: Array, mean: Array, root: Array, instants: Instants) -> None:
        """Products of rows and torques.

        Args:
            rows: Of the torques on all barycentric parameters, (T, n, 10 n).
            mean: Of the parameters, (10 n,).
            root: Root of their covariance, (10 n, k).
            instants: With torques, as recorded.
        """
        torque = self._torque = instants.torque
        self._count, self.joints = torque.shape
        every = float(np.sqrt((torque**2).mean())) + 1e-12
        self._rms = np.maximum(np.sqrt((torque**2).mean(axis=0)), FAINT * every)
        self._constant = torque.std(axis=0) < 1e-3 * self._rms
        white = _whitening(len(torque), round(instants.spacing, 6))
        self._white_torque = white @ torque
        self._raw, self._columns, self._power, self._moved = [], [], [], []
        for joint in range(self.joints):
            moved = rows[:, joint] @ root
            moved = moved[:, np.abs(moved).max(axis=0) > 0]
            self._moved.append(float(moved.var(axis=0).sum()))
            friction = _friction(instants.velocity[:, joint], instants.acceleration[:, joint])
            raw = np.column_stack([rows[:, joint] @ mean, friction])
            self._raw.append(raw)
            wide, spread, _ = np.linalg.svd(white @ moved, full_matrices=False)
            moves = spread > NOTHING * spread[:1]
            self._columns.append(np.hstack([white @ raw, (wide * spread)[:, moves]]))
            self._power.append(friction.T @ instants.velocity[:, joint] * [1, 1, 0, 0])

    def log(self, joint: int, column: int, gain: float = 1.0) -> Array:
        """Log evidence that a column is a joint's torques, in its sense and in the other, (2,).

        Args:
            joint: Of the robot.
            column: Of the recording.
            gain: Recorded numbers are so many times the torques.
        """
        if self._constant[column]:
            return np.zeros(2)
        columns = self._columns[joint].copy()
        columns[:, [0, *range(5, columns.shape[1])]] *= gain / self._rms[column]
        expected = columns[:, 0] + columns[:, 1:5] @ FRICTION
        moved = np.hstack([columns[:, 1:5] * SPREAD, columns[:, 5:]])
        spread, axes = eigh(moved.T @ moved)
        spread = np.maximum(spread, 0.0)
        target = self._white_torque[:, column] / self._rms[column]
        variance = LEFT**2
        within = spread[:, None] + variance
        size = np.log(within).sum(axis=0) + (self._count - len(spread)) * np.log(variance)
        power = SPREAD * (self._power[joint] @ axes[:4])  # of friction, along the axes
        logs = []
        for sense in (1.0, -1.0):
            rest = sense * target - expected
            along = axes.T @ (moved.T @ rest)
            square = (rest @ rest - (along[:, None] ** 2 / within).sum(axis=0)) / variance
            by_variance = -0.5 * (square + size)
            best = int(np.argmax(by_variance))
            mean = self._power[joint] @ FRICTION + power @ (along / within[:, best])
            sigma = np.sqrt(power**2 @ (variance[best] / within[:, best]))
            logs.append(float(by_variance[best]) + _log_positive(mean, sigma))
        return np.array(logs)

    def fit(self, joint: int, column: int) -> ColumnFit:
        """A column as a joint's torques, in the likeliest sense and size.

        Args:
            joint: Of the robot.
            column: Of the recording.
        """
        same, opposite = -self.log(joint, column)
        fits = [ColumnFit(same, 1.0, 1.0), ColumnFit(SIGN + opposite, -1.0, 1.0)]
        size = abs(self.size(joint, column))
        if size > LARGE or size < 1 / LARGE:
            same, opposite = GAIN - self.log(joint, column, size)
            fits += [ColumnFit(same, 1.0, size), ColumnFit(SIGN + opposite, -1.0, size)]
        return min(fits)

    def unexplained(self, joint: int, column: int, sense: float = 1.0, gain: float = 1.0) -> float:
        """Part of a torque's variance that the mean's masses and friction that brakes leave.

        Args:
            joint: Of the robot.
            column: Of the recording.
            sense: 1 or -1.
            gain: Recorded numbers are so many times the torques.
        """
        from scipy.optimize import nnls

        if self._constant[column]:
            return 0.0
        columns = self._raw[joint] - self._raw[joint].mean(axis=0)
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

    def size(self, joint: int, column: int, times: float = 1.0) -> float:
        """Times what the mean's masses make that a column is; nan where they do not determine it.

        Args:
            joint: Of the robot.
            column: Of the recording.
            times: What is left that bodies must explain.
        """
        columns, target = self._columns[joint][:, :5], self._white_torque[:, column]
        values, rest = np.linalg.lstsq(columns, target, rcond=1e-9)[:2]
        others = np.linalg.lstsq(columns[:, 1:], target, rcond=1e-9)[1]
        if not (len(rest) and len(others)):
            return float("nan")
        whole = float(((target - target.mean()) ** 2).sum())
        clear = float(others[0] - rest[0]) > max(CLEAR * whole, times * float(rest[0]))
        return float(values[0]) if clear else float("nan")


@dataclass(frozen=True, eq=False)
class TorqueAssignment:
    """Which columns are which joint's torques.

    Attributes:
        hypotheses: Order, senses and sizes.
        cost: Minus the logarithm of the evidence [nats].
        cost_as_recorded: Of each column as its own joint's, in its sense and size [nats].
        unexplained: Part of each joint's torque, (n,).
        unexplained_as_recorded: The same of columns as they were recorded, (n,).
        spread: Part of it that parameters within their sigma may leave, (n,).
        sizes: Times what the masses make that torques are; nan where that is not known, (n,).
    """

    hypotheses: tuple[Hypothesis, ...]
    cost: float
    cost_as_recorded: float
    unexplained: Array
    unexplained_as_recorded: Array
    spread: Array
    sizes: Array

    def as_recorded(self) -> TorqueAssignment:
        """Columns as they were recorded."""
        return replace(
            self, hypotheses=(), cost=self.cost_as_recorded,
            unexplained=self.unexplained_as_recorded,
        )  # fmt: skip


NO_TORQUES = TorqueAssignment((), 0.0, 0.0, *[np.zeros(0)] * 4)


def assign(torques: TorqueEvidence) -> TorqueAssignment:
    """Order, senses and sizes of recorded torques: the assignment of the greatest evidence.

    Args:
        torques: Their evidence.
    """
    from scipy.optimize import linear_sum_assignment

    joints = list(range(torques.joints))
    pairs = [(j, k) for j in joints for k in joints if j == k or len(joints) <= MOST_JOINTS]
    fits = {pair: torques.fit(*pair) for pair in pairs}
    order = joints
    if len(pairs) == len(joints) ** 2:
        costs = np.reshape([fits[pair].cost for pair in pairs], (len(joints), -1))
        better = linear_sum_assignment(costs)[1]
        if costs[joints, better].sum() < np.trace(costs) - ORDER:
            order = better.tolist()
    pairs = list(enumerate(order))
    best = [fits[pair] for pair in pairs]
    moved = tuple(j for j, k in pairs if j != k)
    opposite = tuple(j for j in joints if best[j].sense < 0)
    odd = tuple(j for j in joints if best[j].gain != 1.0)
    hypotheses = [Hypothesis("torque_order", moved, tuple(order))] * bool(moved)
    hypotheses += [Hypothesis("torque_sign", opposite)] * bool(opposite)
    hypotheses += [Hypothesis("torque_size", odd, tuple(best[j].gain for j in odd))] * bool(odd)
    sizes = np.array([
        fit.gain if fit.gain != 1.0 else torques.size(*pair, TIMES) * fit.sense
        for pair, fit in zip(pairs, best, strict=True)
    ])  # fmt: skip
    return TorqueAssignment(
        tuple(hypotheses),
        sum(fit.cost for fit in best),
        -sum(float(torques.log(k, k)[0]) for k in joints),
        np.array([torques.unexplained(j, k, *best[j][1:]) for j, k in pairs]),
        np.array([torques.unexplained(k, k) for k in joints]),
        np.array([torques.spread(j, k) for j, k in pairs]),
        np.where(sizes > 0, sizes, np.nan),
    )


@cache
def _whitening(count: int, spacing: float) -> Array:
    """The matrix that makes what is left white, (T, T)."""
    from scipy.linalg import solve_triangular

    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    covariance = LASTING * np.exp(-apart * spacing / MEMORY) + (1 - LASTING) * np.eye(count)
    white: Array = solve_triangular(np.linalg.cholesky(covariance), np.eye(count), lower=True)
    return white


def _log_positive(mean: float, sigma: float) -> float:
    """Log probability that a normal number is positive, down to `SURELY_NOT`."""
    from scipy.special import log_ndtr

    return max(float(log_ndtr(mean / sigma)), SURELY_NOT) if sigma > 0 else 0.0


def _friction(velocity: Array, acceleration: Array) -> Array:
    """Viscous and dry friction, a constant, the rotor; of size one, (T, 4)."""
    speed = velocity / max(float(np.abs(velocity).max()), 1e-9)
    rotor = acceleration / max(float(np.abs(acceleration).max()), 1e-9)
    return np.column_stack([speed, np.tanh(100 * speed), np.ones(len(speed)), rotor])
