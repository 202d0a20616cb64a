"""Friction over velocity and load as a table of local means: no law is assumed.

The plate's estimate gives the load of a joint, the torque that moves its link, without friction
and without a torque constant; what the motor's torque has more is friction. One number is no local
mean: the torque constant, which is that of the joint's regression.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array, readonly
from testbed.blas import one_blas_thread
from testbed.errors import round_significant
from testbed.identification.drives.friction_curves import LEAST
from testbed.identification.drives.joint_regression import JointRegression, torques_beside
from testbed.identification.estimate import Estimate
from testbed.identification.problem import Problem
from testbed.robot.friction import VISCOUS
from testbed.robot.tree import Joint

SPEEDS = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 8.0)
"""Least speeds of the cells of either direction [rad/s or m/s]."""

LOADS = 8
"""Cells on either side of a load of zero; what is beyond the last counts as its."""

FINE = 0.4
"""Their size, in the load's root mean square."""


@dataclass(frozen=True, eq=False)
class FrictionMap:
    """One joint's friction over velocity and load; cells with too few data are not there.

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
        for name in ("speed", "load", "friction", "sigma", "rows"):
            values = getattr(self, name)
            object.__setattr__(self, name, readonly(values, (len(self.rows),), name))
        for name in ("speeds", "loads"):
            values = getattr(self, name)
            object.__setattr__(self, name, readonly(values, (len(self.rows), 2), name))


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
    lift = torques.lift
    load = lift @ bodies.values
    steps = {}
    for joint in torques.joints:
        square = load @ torques.equations.of_channel(joint)[0] @ load
        rms = float(np.sqrt(square / max(torques.equations.used[joint], 1.0)))
        steps[joint] = round_significant(FINE * rms, 1) or 1.0
    velocity = torques.drives.columns.sum(axis=1)  # a channel has no other joint's
    columns = np.column_stack([velocity, load, lift])
    shape = 2 * len(SPEEDS), 2 * LOADS, 4 + lift.shape[1]
    sums = {joint: np.zeros(shape) for joint in torques.joints}
    with one_blas_thread():
        for rows, measured in torques.passes.rows(columns):
            for joint, cells in sums.items():
                _add(cells, rows[joint], measured[joint], steps[joint])
    joints = problem.tree.joints
    return tuple(
        _map(joints[each.joint], sums[each.joint], steps[each.joint], each, bodies)
        for each in found
    )


def _add(sums: Array, rows: Array, measured: Array, step: float) -> None:
    """Adds rows to the cells in which they are: their number, columns and torques."""
    side = np.sign(rows[:, 1])
    steady = np.append(side[1:] == side[:-1], True) & np.append(True, side[1:] == side[:-1])
    counted = steady & (rows[:, 0] != 0)  # rows near a reversal are zero
    rows, measured = rows[counted], measured[counted]
    speed, load = rows[:, 0], rows[:, 1]
    node = np.searchsorted(SPEEDS, np.abs(speed), side="right") - 1
    row = np.where(speed > 0, len(SPEEDS) + node, len(SPEEDS) - 1 - node)
    column = LOADS + np.clip(np.floor(load / step), -LOADS, LOADS - 1).astype(np.int64)
    whole = np.column_stack([np.ones(len(rows)), measured, rows])
    np.add.at(sums, (row, column), whole)


def _map(
    joint: Joint, sums: Array, step: float, found: JointRegression, bodies: Estimate
) -> FrictionMap:
    """Of one joint's cells those with enough rows."""
    row, column = np.nonzero(sums[..., 0] >= LEAST)
    rows = sums[row, column, 0]
    torque, speed, load, *_ = (sums[row, column, 1:] / rows[:, None]).T
    columns = sums[row, column, 4:] / rows[:, None]
    constant = float(found.values[0])
    by_bodies = -columns - np.outer(torque / constant**2, found.by_bodies[0])
    spread = bodies.covariance
    own = float(found.covariance[0, 0] - found.by_bodies[0] @ spread @ found.by_bodies[0])
    variance = (found.noise / constant) ** 2 / rows
    variance += np.einsum("ki,ij,kj->k", by_bodies, spread, by_bodies)
    variance += max(own, 0.0) * (torque / constant**2) ** 2
    edges = np.array([*SPEEDS, np.inf])
    edges = np.concatenate([-edges[::-1], edges[1:]])
    loads = step * np.arange(-LOADS, LOADS + 1)
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
