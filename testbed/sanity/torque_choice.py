"""Which recorded column is which joint's torques: order, senses and sizes by one assignment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.arrays import Array
from testbed.robot.tree import Tree
from testbed.sanity.mistakes import MOST_JOINTS, Mistake
from testbed.sanity.torque_evidence import TorqueEvidence

SIGN, GAIN, ORDER = 3.0, 8.0, 5.0
"""What a torque of the other sense, one of another size, and another order must explain [nats]."""

LARGE = 2.5
"""Times that a torque may be too large or too small and count as being of its size."""


@dataclass(frozen=True, eq=False)
class Choice:
    """Which columns are which joint's torques.

    Attributes:
        mistakes: Order, senses and sizes.
        cost: Without these mistakes [nats].
        gain: By how much it is less than with them [nats].
        left: Part of each joint's torque that is not explained, (n,).
        unchanged: The same with the mistakes, (n,).
        spread: Part of it that parameters within their sigma may leave, (n,).
        sizes: Times what the masses make that torques are; nan where they do not tell, (n,).
    """

    mistakes: tuple[Mistake, ...]
    cost: float
    gain: float
    left: Array
    unchanged: Array
    spread: Array
    sizes: Array

    def undoing_nothing(self) -> Choice:
        """Columns as they were recorded."""
        return replace(self, mistakes=(), cost=self.cost + self.gain, gain=0.0, left=self.unchanged)


TOLD = 5.0
"""Times what is left that bodies must explain of a torque for its size to be said."""

NO_TORQUES = Choice((), 0.0, 0.0, *[np.zeros(0)] * 4)


def chosen(tree: Tree, torques: TorqueEvidence | None) -> Choice:
    """Order, senses and sizes of recorded torques.

    Args:
        tree: The robot.
        torques: Their evidence, if they were measured.
    """
    if torques is None:
        return NO_TORQUES
    from scipy.optimize import linear_sum_assignment

    order, several = np.arange(tree.n), range(tree.n)
    pairs = {(k, k): least(torques, k, k) for k in several}
    if tree.n <= MOST_JOINTS:
        for j, k in ((j, k) for j in several for k in several if j != k):
            pairs[j, k] = least(torques, j, k)
        costs = np.full((tree.n, tree.n), 1e9)
        for pair, found in pairs.items():
            costs[pair] = found[0]
        better = linear_sum_assignment(costs)[1]
        if costs[order, better].sum() < costs[order, order].sum() - ORDER:
            order = better
    columns: list[int] = order.tolist()
    best = [pairs[j, k] for j, k in enumerate(columns)]
    moved = tuple(k for k, place in enumerate(columns) if place != k)
    turned_over = tuple(k for k, (_, sense, _) in enumerate(best) if sense < 0)
    odd = tuple(k for k, (_, _, gain) in enumerate(best) if gain != 1.0)
    mistakes = [Mistake("torque_order", moved, tuple(columns))] if moved else []
    mistakes += [Mistake("torque_sign", turned_over)] if turned_over else []
    mistakes += [Mistake("torque_size", odd, tuple(best[k][2] for k in odd))] if odd else []
    cost = sum(each[0] for each in best)
    given = -sum(float(torques.log(k, k)[0]) for k in several)
    return Choice(
        tuple(mistakes),
        cost,
        given - cost,
        np.array([torques.left(j, k, *best[j][1:]) for j, k in enumerate(columns)]),
        np.array([torques.left(k, k, 1.0) for k in several]),
        np.array([torques.spread(j, k) for j, k in enumerate(columns)]),
        _positive(
            [
                gain if gain != 1.0 else torques.size(j, k, TOLD) * sense
                for (j, k), (_, sense, gain) in zip(enumerate(columns), best, strict=True)
            ]
        ),
    )


def _positive(sizes: Sequence[float]) -> Array:
    """Sizes; nan where one is none."""
    return np.array([size if size > 0 else np.nan for size in sizes])


def least(torques: TorqueEvidence, joint: int, column: int) -> tuple[float, float, float]:
    """Least cost, sense and gain with which a column is a joint's torques.

    Args:
        torques: Their evidence.
        joint: Of the robot.
        column: Of the recording.
    """
    logs = torques.log(joint, column)
    found = min((-logs[0], 1.0, 1.0), (SIGN - logs[1], -1.0, 1.0))
    size = abs(torques.size(joint, column))
    if size > LARGE or size < 1 / LARGE:
        logs = torques.log(joint, column, size)
        found = min(found, (GAIN - logs[0], 1.0, size), (GAIN + SIGN - logs[1], -1.0, size))
    return found
