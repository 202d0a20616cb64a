"""Friction over velocity, load and temperature as a table of local means: no law is assumed.

The plate's estimate gives the load of a joint, the torque that moves its link, without friction
and without a torque constant; what the motor's torque has more is friction. One number is no local
mean: the torque constant, which is that of the joint's regression.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from testbed.applications.drives.friction_curves import LEAST
from testbed.applications.drives.joint_regression import JointRegression, Torques, torques_beside
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import round_significant
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.robot.friction import ROOM, VISCOUS, WARM_VISCOUS
from testbed.core.robot.tree import Joint

SPEEDS = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 8.0)
"""Least speeds of the cells of either direction [rad/s or m/s]."""

LOADS = 8
"""Cells on either side of a load of zero; what is beyond the last counts as its."""

FINE = 0.4
"""Their size, in the load's root mean square."""

TEMPERATURES, WARMER = 3, 2.0
"""Cells over temperature, a standard deviation each, if it varies by so much at least [K]."""


@dataclass(frozen=True, eq=False)
class FrictionMap:
    """One joint's friction over velocity, load and, if it varies, temperature.

    Cells with too few data are not there.

    Where velocity and load have one sign the gear drives the link, else the link drives it back.

    Attributes:
        joint: Its name.
        speeds: From which velocity to which each cell is, (k, 2) [rad/s or m/s].
        loads: Likewise of the load, (k, 2) [N m or N].
        temperatures: Likewise of the drive's temperature, (k, 2) [degC]; infinite for all.
        speed: Mean velocity of the data in a cell, (k,) [rad/s or m/s].
        load: Mean load, (k,) [N m or N].
        temperature: Mean temperature, (k,) [degC]; NaN where it is not recorded.
        friction: What friction takes there, with the sign of the motion, (k,) [N m or N].
        sigma: Standard deviations by noise, plate and torque constant, (k,).
        rows: How many rows there are, (k,).
        constant: What the drive reports over what the torque is.
        unit: N m or N.
    """

    joint: str
    speeds: Array
    loads: Array
    temperatures: Array
    speed: Array
    load: Array
    temperature: Array
    friction: Array
    sigma: Array
    rows: Array
    constant: float
    unit: str

    def __post_init__(self) -> None:
        k = len(self.rows)
        freeze(self, speeds=(k, 2), loads=(k, 2), temperatures=(k, 2), speed=(k,), load=(k,))
        freeze(self, temperature=(k,), friction=(k,), sigma=(k,), rows=(k,))

    def by_temperature(self) -> Iterator[FrictionMap]:
        """Maps of the same temperatures each, the coldest first."""
        for first in np.unique(self.temperatures[:, 0]):
            own = self.temperatures[:, 0] == first
            yield replace(self, **{name: getattr(self, name)[own] for name in COLUMNS})


COLUMNS = tuple(each.name for each in fields(FrictionMap) if each.type == "Array")
"""Of the cells."""


def friction_maps(
    problem: Problem, bodies: Estimate, found: Sequence[JointRegression]
) -> tuple[FrictionMap, ...]:
    """Friction over velocity, load and temperature, joint by joint, by one pass over the rows.

    Args:
        problem: By joint torques.
        bodies: The external estimate: of this recording or of another.
        found: Each joint's regression, for its torque constant and the noise of its rows.
    """
    warm = "temperature" in problem.source.signals
    torques = torques_beside(problem, bodies, (VISCOUS, WARM_VISCOUS) if warm else (VISCOUS,))
    laws = np.array([term.law.kind for term in torques.drives.asked])
    velocity, warmth = (  # and velocity times temperature over ROOM; a channel has no other's
        torques.drives.columns[:, laws == law.kind].sum(axis=1) for law in (VISCOUS, WARM_VISCOUS)
    )
    load = torques.lift @ bodies.values
    columns = np.column_stack([velocity, warmth, load, torques.lift])
    cells = {joint: _Cells.of(torques, columns, joint) for joint in torques.joints}
    with one_blas_thread():
        for rows, measured in torques.passes.rows(columns):
            for joint, own in cells.items():
                own.add(rows[joint], measured[joint])
    joints = problem.tree.joints
    return tuple(_map(joints[each.joint], cells[each.joint], each, bodies, warm) for each in found)


@dataclass(frozen=True, eq=False)
class _Cells:
    """Sums of one joint's rows over velocity, load and temperature.

    Attributes:
        sums: Number of rows, torque and columns, (velocities, loads, temperatures, 2 + columns).
        step: Size of a cell in load [N m or N].
        warmth: Edges between temperatures over ROOM [K]; () for one cell.
    """

    sums: Array
    step: float
    warmth: Array

    @staticmethod
    def of(torques: Torques, columns: Array, joint: int) -> _Cells:
        """Empty ones, as wide as the joint's data ask for."""
        velocity, warm, load = columns[:, :3].T
        normal, used = torques.equations.of_channel(joint)[0], torques.equations.used[joint]
        rms = float(np.sqrt(load @ normal @ load / max(used, 1.0)))
        square = max(float(velocity @ normal @ velocity), TINY)
        mean = float(warm @ normal @ velocity) / square  # where it is fast: that shows viscosity
        spread = np.sqrt(max(float(warm @ normal @ warm) / square - mean**2, 0.0))
        edges = np.zeros(0)
        if np.sqrt(12) * spread > WARMER:  # the range of what is spread evenly
            edges = mean + spread * (np.arange(1, TEMPERATURES) - TEMPERATURES / 2)
        shape = 2 * len(SPEEDS), 2 * LOADS, len(edges) + 1, 2 + columns.shape[1]
        return _Cells(np.zeros(shape), round_significant(FINE * rms, 1) or 1.0, np.round(edges, 1))

    def add(self, rows: Array, measured: Array) -> None:
        """Adds rows to the cells in which they are."""
        side = np.sign(rows[:, 2])
        same = side[1:] == side[:-1]
        counted = np.append(same, True) & np.append(True, same) & (rows[:, 0] != 0)
        rows, measured = rows[counted], measured[counted]  # rows near a reversal are zero
        speed, load = rows[:, 0], rows[:, 2]
        node = np.searchsorted(SPEEDS, np.abs(speed), side="right") - 1
        row = np.where(speed > 0, len(SPEEDS) + node, len(SPEEDS) - 1 - node)
        column = LOADS + np.clip(np.floor(load / self.step), -LOADS, LOADS - 1).astype(np.int64)
        warmth = np.searchsorted(self.warmth, rows[:, 1] / speed)
        whole = np.column_stack([np.ones(len(rows)), measured, rows])
        np.add.at(self.sums, (row, column, warmth), whole)


def _map(
    joint: Joint, cells: _Cells, found: JointRegression, bodies: Estimate, warm: bool
) -> FrictionMap:
    """Of one joint's cells those with enough rows."""
    row, column, warmth = np.nonzero(cells.sums[..., 0] >= LEAST)
    sums = cells.sums[row, column, warmth]
    rows = sums[:, 0]
    torque, speed, warm_speed, load = (sums[:, 1:5] / rows[:, None]).T
    columns = sums[:, 5:] / rows[:, None]
    constant = float(found.values[0])
    by_bodies = -columns - np.outer(torque / constant**2, found.by_bodies[0])
    spread = bodies.covariance
    own = float(found.covariance[0, 0] - found.by_bodies[0] @ spread @ found.by_bodies[0])
    variance = (found.noise / constant) ** 2 / rows
    variance += np.einsum("ki,ij,kj->k", by_bodies, spread, by_bodies)
    variance += max(own, 0.0) * (torque / constant**2) ** 2
    speeds, loads, temperatures = (
        np.array([*SPEEDS, np.inf]),
        cells.step * np.arange(-LOADS, LOADS + 1),
        np.array([-np.inf, *(ROOM + cells.warmth), np.inf]),
    )
    speeds = np.concatenate([-speeds[::-1], speeds[1:]])
    return FrictionMap(
        joint=joint.name,
        speeds=np.column_stack([speeds[row], speeds[row + 1]]),
        loads=np.column_stack([loads[column], loads[column + 1]]),
        temperatures=np.column_stack([temperatures[warmth], temperatures[warmth + 1]]),
        speed=speed,
        load=load,
        temperature=ROOM + warm_speed / speed if warm else np.full(len(rows), np.nan),
        friction=torque / constant - load,
        sigma=np.sqrt(variance),
        rows=rows,
        constant=constant,
        unit="N m" if joint.revolute else "N",
    )
