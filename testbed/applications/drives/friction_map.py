"""Friction over velocity and load as a table of local means: no law is assumed.

The plate's estimate gives the load of a joint, the torque that moves its link, without friction
and without a torque constant; what the motor's torque has more is friction. One number is no local
mean: the torque constant, which is that of the joint's regression.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.applications.drives.friction_curves import LEAST
from testbed.applications.drives.joint_regression import JointRegression, Torques, torques_beside
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import round_significant
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.robot.friction import VISCOUS
from testbed.core.robot.tree import Joint

SPEEDS = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 8.0)
"""Least speeds of the cells of either direction [rad/s or m/s]."""

LOADS = 8
"""Cells on either side of a load of zero; what is beyond the last counts as its."""

FINE = 0.4
"""Their size, in the load's root mean square."""


@dataclass(frozen=True, eq=False)
class FrictionMap:
    """One joint's friction over velocity and load.

    Cells with too few data are not there.

    Where velocity and load have one sign the gear drives the link, else the link drives it back.

    Attributes:
        joint: Its name.
        speeds: From which velocity to which each cell is, (k, 2) [rad/s or m/s].
        loads: Likewise of the load, (k, 2) [N m or N].
        speed: Mean velocity of the data in a cell, (k,) [rad/s or m/s].
        load: Mean load, (k,) [N m or N].
        friction: What friction takes there, with the sign of the motion, (k,) [N m or N].
        sigma: Standard deviations by noise, plate and torque constant, (k,).
        rows: How many rows there are, (k,).
        constant: What the drive reports over what the torque is.
        unit: N m or N.
    """

    joint: str
    speeds: Array
    loads: Array
    speed: Array
    load: Array
    friction: Array
    sigma: Array
    rows: Array
    constant: float
    unit: str

    def __post_init__(self) -> None:
        k = len(self.rows)
        freeze(self, speeds=(k, 2), loads=(k, 2), speed=(k,), load=(k,))
        freeze(self, friction=(k,), sigma=(k,), rows=(k,))


def friction_maps(
    problem: Problem, bodies: Estimate, found: Sequence[JointRegression]
) -> tuple[FrictionMap, ...]:
    """Friction over velocity and load, joint by joint, by one pass over the rows.

    Args:
        problem: By joint torques.
        bodies: The external estimate: of this recording or of another.
        found: Each joint's regression, for its torque constant and the noise of its rows.
    """
    torques = torques_beside(problem, bodies, (VISCOUS,))
    velocity = torques.drives.columns.sum(axis=1)  # a channel has no other's
    columns = np.column_stack([velocity, torques.lift @ bodies.values, torques.lift])
    cells = {joint: _Cells.of(torques, columns, joint) for joint in torques.joints}
    with one_blas_thread():
        for rows, measured in torques.passes.rows(columns):
            for joint, own in cells.items():
                own.add(rows[joint], measured[joint])
    joints = problem.tree.joints
    return tuple(_map(joints[each.joint], cells[each.joint], each, bodies) for each in found)


@dataclass(frozen=True, eq=False)
class _Cells:
    """Sums of one joint's rows over velocity and load.

    Attributes:
        sums: Number of rows, torque and columns, (velocities, loads, 2 + columns).
        step: Size of a cell in load [N m or N].
    """

    sums: Array
    step: float

    @staticmethod
    def of(torques: Torques, columns: Array, joint: int) -> _Cells:
        """Empty ones, as wide as the joint's data ask for."""
        load = columns[:, 1]
        normal, used = torques.equations.of_channel(joint)[0], torques.equations.used[joint]
        rms = float(np.sqrt(load @ normal @ load / max(used, 1.0)))
        sums = np.zeros((2 * len(SPEEDS), 2 * LOADS, 2 + columns.shape[1]))
        return _Cells(sums, round_significant(FINE * rms, 1) or 1.0)

    def add(self, rows: Array, measured: Array) -> None:
        """Adds rows to the cells in which they are."""
        side = np.sign(rows[:, 1])
        same = side[1:] == side[:-1]
        counted = np.append(same, True) & np.append(True, same) & (rows[:, 0] != 0)
        rows, measured = rows[counted], measured[counted]  # rows near a reversal are zero
        speed, load = rows[:, 0], rows[:, 1]
        node = np.searchsorted(SPEEDS, np.abs(speed), side="right") - 1
        row = np.where(speed > 0, len(SPEEDS) + node, len(SPEEDS) - 1 - node)
        column = LOADS + np.clip(np.floor(load / self.step), -LOADS, LOADS - 1).astype(np.int64)
        whole = np.column_stack([np.ones(len(rows)), measured, rows])
        np.add.at(self.sums, (row, column), whole)


def _map(joint: Joint, cells: _Cells, found: JointRegression, bodies: Estimate) -> FrictionMap:
    """Of one joint's cells those with enough rows."""
    row, column = np.nonzero(cells.sums[..., 0] >= LEAST)
    rows = cells.sums[row, column, 0]
    torque, speed, load, *columns = (cells.sums[row, column, 1:] / rows[:, None]).T
    constant = float(found.values[0])
    by_constant = torque / constant**2
    by_bodies = -np.array(columns).T - np.outer(by_constant, found.by_bodies[0])
    spread = bodies.covariance
    own = float(found.covariance[0, 0] - found.by_bodies[0] @ spread @ found.by_bodies[0])
    variance = (found.noise / constant) ** 2 / rows + max(own, 0.0) * by_constant**2
    variance += np.einsum("ki,ij,kj->k", by_bodies, spread, by_bodies)
    edges = np.array([*SPEEDS, np.inf])
    edges = np.concatenate([-edges[::-1], edges[1:]])
    loads = cells.step * np.arange(-LOADS, LOADS + 1)
    return FrictionMap(
        joint=joint.name,
        speeds=np.column_stack([edges[row], edges[row + 1]]),
        loads=np.column_stack([loads[column], loads[column + 1]]),
        speed=speed,
        load=load,
        friction=torque / constant - load,
        sigma=np.sqrt(variance),
        rows=rows,
        constant=constant,
        unit="N m" if joint.revolute else "N",
    )
