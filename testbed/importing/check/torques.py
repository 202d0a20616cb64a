"""How likely recorded columns are the joints' torques, and which is whose, in what sense and size.

A joint's torques are t = Y theta + F f + e. Parameters theta lie about the model file's (`Prior`),
friction brakes (F: viscous, dry, a constant, the
rotor), and what is left, e, lasts: model errors are no white noise. Then t is normal, and log N(t)
says how well one recorded column, in one sense, can be a joint's torques. A free set of parameters
would explain anything that is short; this does not. Where a plate determines parameters, their
posterior is the prior here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.regression.normal_equations import inverse_root
from testbed.importing.check.instants import Instants
from testbed.importing.check.remedies import MOST_JOINTS, Hypothesis, of_joints

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

DEPENDENT = 1e-9
"""Part of the most that a column must have of its own for a size to be known."""

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


class _Rows(NamedTuple):
    """One joint's torques, white where what models leave is.

    Attributes:
        raw: Friction of size one, and bodies by the mean of the parameters, before they are white,
            (T, 5).
        white: The same white, (T, 5).
        spread: By which parameters move them, along directions of their own, (T, k).
        moved: Variance of the last before it is white.
    """

    raw: Array
    white: Array
    spread: Array
    moved: float


class TorqueEvidence:
    """How well each recorded column can be each joint's torques."""

    def __init__(
        self, rows: Array, mean: Array, root: Array, instants: Instants
    ) -> None:
        """Products of rows and torques.

        Args:
            rows: Of the torques on all barycentric parameters, (T, n, 10 n).
            mean: Of the parameters, (10 n,).
            root: Root of their covariance, (10 n, k).
            instants: With torques, as recorded.
        """
        self._torque = instants.torque
        count, self.joints = self._torque.shape
        rms = np.sqrt((self._torque**2).mean(axis=0))
        self._rms = np.maximum(rms, FAINT * np.sqrt((rms**2).mean()) + 1e-12)
        self._constant = self._torque.std(axis=0) < 1e-3 * self._rms
        white = _whitening(count, round(instants.spacing, 6))
        self._white_torque = white @ self._torque
        self._rows = []
        for joint in range(self.joints):
            moved = rows[:, joint] @ root
            wide, spread, _ = np.linalg.svd(white @ moved, full_matrices=False)
            moves = spread > NOTHING * spread[:1]
            friction = _friction(instants.motion, joint)
            raw = np.column_stack([friction, rows[:, joint] @ mean])
            variance = float(moved.var(axis=0).sum())
            self._rows.append(
                _Rows(raw, white @ raw, (wide * spread)[:, moves], variance)
            )

    def log(self, joint: int, column: int, gain: float = 1.0) -> Array:
        """Log evidence that a column is a joint's torques, in its sense and in the other, (2,).

        Args:
            joint: Of the robot.
            column: Of the recording.
            gain: Recorded numbers are so many times the torques.
        """
        if self._constant[column]:
            return np.zeros(2)
        rows, size = self._rows[joint], gain / self._rms[column]
        expected = rows.white @ [*FRICTION, size]
        moved = np.hstack([rows.white[:, :-1] * SPREAD, size * rows.spread])
        rest = (
            np.outer([1.0, -1.0], self._white_torque[:, column] / self._rms[column])
            - expected
        )
        spread, axes = eigh(moved.T @ moved)
        along = rest @ moved @ axes
        variance = LEFT**2
        within = np.maximum(spread, 0.0)[:, None] + variance  # (k, 12)
        determinant = np.log(within / variance).sum(axis=0) + rest.shape[1] * np.log(
            variance
        )
        square = (
            (rest**2).sum(axis=1, keepdims=True) - along**2 @ (1 / within)
        ) / variance
        return np.asarray(-0.5 * (square + determinant).min(axis=1))

    def fit(self, joint: int, column: int) -> ColumnFit:
        """A column as a joint's torques, in the likeliest sense and size.

        Args:
            joint: Of the robot.
            column: Of the recording.
        """
        size = abs(self.size(joint, column))
        gains = [1.0, size] if size > LARGE or size < 1 / LARGE else [1.0]
        return min(
            ColumnFit(SIGN * (sense < 0) + GAIN * (gain != 1.0) - log, sense, gain)
            for gain in gains
            for sense, log in zip(
                (1.0, -1.0), self.log(joint, column, gain).tolist(), strict=True
            )
        )

    def unexplained(
        self, joint: int, column: int, sense: float = 1.0, gain: float = 1.0
    ) -> float:
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
        raw, torque = self._rows[joint].raw, sense * self._torque[:, column] / gain
        columns, torque = raw - raw.mean(axis=0), torque - torque.mean()
        rest = nnls(columns[:, [0, 1, 3]], torque - columns[:, 4])[1]
        return float(rest**2 / (torque @ torque))

    def spread(self, joint: int, column: int) -> float:
        """Part of a torque's variance by which parameters may move what is expected.

        Args:
            joint: Of the robot.
            column: Of the recording.
        """
        return self._rows[joint].moved / max(
            float(self._torque[:, column].var()), 1e-30
        )

    def size(self, joint: int, column: int, times: float = 1.0) -> float:
        """Times what the mean's masses make that a column is; nan where they do not determine it.

        Args:
            joint: Of the robot.
            column: Of the recording.
            times: What is left that bodies must explain.
        """
        torque = self._white_torque[:, column]
        columns = np.column_stack([self._rows[joint].white, torque])
        triangle = np.asarray(np.linalg.qr(columns, mode="r"))
        own = np.abs(np.diagonal(triangle))
        explained, left = triangle[-2:, -1] ** 2
        whole = len(torque) * torque.var()
        known = own[:-1].min() > DEPENDENT * own[:-1].max()
        clear = explained > max(CLEAR * whole, times * left)
        return (
            float(triangle[-2, -1] / triangle[-2, -2])
            if known and clear
            else float("nan")
        )


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
            self,
            hypotheses=(),
            cost=self.cost_as_recorded,
            unexplained=self.unexplained_as_recorded,
        )


NO_TORQUES = TorqueAssignment((), 0.0, 0.0, *[np.zeros(0)] * 4)


def assign(torques: TorqueEvidence) -> TorqueAssignment:
    """Order, senses and sizes of recorded torques: the assignment of the greatest evidence.

    Args:
        torques: Their evidence.
    """
    from scipy.optimize import linear_sum_assignment

    n = torques.joints
    fits = {
        pair: torques.fit(*pair)
        for pair in product(range(n), repeat=2)
        if n <= MOST_JOINTS or pair[0] == pair[1]
    }
    costs = np.full((n, n), np.inf)
    for place, fit in fits.items():
        costs[place] = fit.cost
    joints, order = linear_sum_assignment(costs)
    if costs[joints, order].sum() >= np.trace(costs) - ORDER:
        order = joints
    places = list(enumerate(order.tolist()))
    cost, sense, gain = np.array([fits[place] for place in places]).T
    sizes = sense * [torques.size(*place, TIMES) for place in places]
    sizes = np.where(gain != 1, gain, sizes)
    hypotheses = (
        *of_joints("torque_order", order != joints, order),
        *of_joints("torque_sign", sense < 0),
        *of_joints("torque_size", gain != 1, gain[gain != 1]),
    )
    return TorqueAssignment(
        hypotheses,
        float(cost.sum()),
        -sum(float(torques.log(k, k)[0]) for k in range(n)),
        np.array([torques.unexplained(*place, *fits[place][1:]) for place in places]),
        np.array([torques.unexplained(k, k) for k in range(n)]),
        np.array([torques.spread(*place) for place in places]),
        np.where(sizes > 0, sizes, np.nan),
    )


@cache
def _whitening(count: int, spacing: float) -> Array:
    """The matrix that makes what is left white, (T, T)."""
    from scipy.linalg import toeplitz

    correlation = LASTING * np.exp(-np.arange(count) * spacing / MEMORY)
    correlation[0] = 1.0
    return inverse_root(toeplitz(correlation)).T


def _friction(motion: Motion, joint: int) -> Array:
    """Viscous and dry friction, a constant, the rotor; of size one, (T, 4)."""
    signals = motion.qd[:, joint], motion.qdd[:, joint]
    speed, rotor = (each / max(float(np.abs(each).max()), 1e-9) for each in signals)
    return np.column_stack([speed, np.tanh(100 * speed), np.ones(len(speed)), rotor])
