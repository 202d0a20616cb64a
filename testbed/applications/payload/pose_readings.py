"""Readings of a table of poses other than as it was said, each tried on the poses.

Of one that is proposed, poses that were left out of the fit are far better predicted than of the
table as it was said, and what it leaves is small beside the tool's weight.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import least_squares

from testbed.applications.payload.static_fit import RestFit, rest_fit
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.dynamics.newton_euler import sensor_poses
from testbed.core.recordings.columns import AXES
from testbed.core.robot.tree import Tree

FEW = 60
"""Poses by which the best of many readings is found."""

TRIALS = 6
"""Parts of the poses that are left out, one after the other."""

ALIKE = 2.0
"""Squares of what two readings leave over one another, up to which nothing distinguishes them."""

BASES = {"base-axes": (1, 1, 1), "turned-base": (-1, -1, 1)}
"""By code: signs of a base's axes; UR's `base` is turned against the model's about the vertical."""

LEVEL = float(np.deg2rad(3.0))
"""Tilt of gravity up to which a base is called level [rad]."""


@dataclass(frozen=True, eq=False)
class StaticPoses:
    """Poses at rest: joint positions, and what a force sensor showed.

    Attributes:
        position: Of the joints that lead to the sensor, (P, n) [rad or m].
        wrench: (P, 6) [N, N m].
        diagnostics: What was repaired in reading.
    """

    position: Array
    wrench: Array
    diagnostics: tuple[Diagnostic, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, wrench=(None, 6))
        shape = (len(self.wrench), np.shape(self.position)[-1])
        freeze(self, position=shape)


@dataclass(frozen=True, eq=False)
class PoseReading:
    """A reading of a table of poses.

    Attributes:
        back: From the base's axes to the sensor's, (P, 3, 3).
        wrench: In the sensor's axes, (P, 6) [N, N m].
        code: Of what it takes for wrong; "" for the table as it was said.
        subject: Which columns or joints that is.
        turn: Where a search for the sensor's axes begins, (3, 3); None takes them as said.
    """

    back: Array
    wrench: Array
    code: str = ""
    subject: str = ""
    turn: Array | None = None

    @cached_property
    def fit(self) -> RestFit:
        """Least-squares fit of a tool's weight and moments to the poses."""
        return rest_fit(self.back, self.wrench, self.turn)

    @cached_property
    def held_out(self) -> float:
        """Rms errors in poses left out of the fit, of forces times those of moments [N^2 m]."""
        errors, part = np.empty_like(self.wrench), np.arange(len(self.back)) % TRIALS
        for k in range(TRIALS):
            used, out = self.only(part != k), self.only(part == k)
            errors[part == k] = used.fit.errors(out.back, out.wrench)
        return float(np.prod(np.sqrt((errors.reshape(-1, 2, 3) ** 2).mean(axis=(0, 2)))))

    @property
    def few(self) -> PoseReading:
        """At most `FEW` of the poses."""
        return self.only(slice(None, None, -(-len(self.back) // FEW)))

    def only(self, poses: Array | slice) -> PoseReading:
        """Some of the poses."""
        return replace(self, back=self.back[poses], wrench=self.wrench[poses])


def reading_of(tree: Tree, position: Array, wrench: Array) -> PoseReading:
    """Reading of a table of poses as its options state it.

    Args:
        tree: What the sensor feels.
        position: Of the joints, (P, n) [rad or m].
        wrench: (P, 6) [N, N m].
    """
    return PoseReading(np.swapaxes(sensor_poses(tree, position)[0], 1, 2), wrench)


def other_readings(tree: Tree, table: StaticPoses) -> Iterator[PoseReading]:
    """Other readings: moments along base axes, degrees, opposite signs, exchanged columns.

    Args:
        tree: What the sensor feels.
        table: The poses.
    """
    position, shown, n = table.position, table.wrench, tree.n
    said = reading_of(tree, position, shown)
    for code, flip in BASES.items():
        along = np.einsum("pij,pkj->pki", said.back, shown.reshape(-1, 2, 3) * flip).reshape(-1, 6)
        for subject, part in {"wrench": (0, 1), "forces": (0,), "moments": (1,)}.items():
            mixed = np.where(np.isin(np.arange(6) // 3, part), along, shown)
            yield replace(said, wrench=mixed, code=code, subject=subject)
    yield replace(reading_of(tree, np.deg2rad(position), shown), code="degrees")
    names, columns = (*tree.names, *AXES), np.hstack([position, shown])
    for a, b in combinations_with_replacement(range(n + 6), 2):
        if (a >= n) + (a >= n + 3) == (b >= n) + (b >= n + 3):
            order = np.eye(n + 6)
            order[[a, b]] = order[[b, a]] if a < b else -order[[a, b]]
            mixed = columns @ order
            code, subject = (
                ("exchanged", f"{names[a]} and {names[b]}") if a < b else ("sign", names[a])
            )
            found = reading_of(tree, mixed[:, :n], mixed[:, n:])
            yield replace(found, code=code, subject=subject)


def with_zero(tree: Tree, table: StaticPoses) -> PoseReading:
    """Reading with the joint offset that fits the poses best under the model's gravity.

    Gravity shows no zero of the first joint: it turns with the base.

    Args:
        tree: What the sensor feels.
        table: The poses.
    """
    scale = reading_of(tree, table.position, table.wrench).few.fit.scale[:, None]
    level = tree.gravity / np.linalg.norm(tree.gravity)

    def shifted(joint: int, shift: float) -> PoseReading:
        moved = table.position + shift * np.eye(tree.n)[joint]
        name = f"'{tree.names[joint]}' by {np.rad2deg(shift):+.1f}"
        return replace(reading_of(tree, moved, table.wrench), code="zeros", subject=name)

    def rest(shift: Array, joint: int) -> Array:
        few = shifted(joint, shift[0]).few
        errors = few.fit.errors(few.back, few.wrench).reshape(-1, 2, 3) / scale
        return np.append(errors, (few.fit.weight / np.linalg.norm(few.fit.weight) - level) / LEVEL)

    found = [least_squares(rest, 0.0, args=(joint,)) for joint in range(1, tree.n)]
    least = min(each.cost for each in found)
    alike = [shifted(k, x.x[0]) for k, x in enumerate(found, 1) if x.cost < ALIKE * least]
    return replace(alike[0], subject=" or ".join(each.subject for each in alike))
