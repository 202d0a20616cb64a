"""Readings of a table of poses other than as it was said, each tried on the poses.

Of one that is proposed, poses that were left out of the fit are far better predicted than of the
table as it was said, and what it leaves is small beside the tool's weight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import minimize_scalar

from testbed.arrays import Array, freeze
from testbed.dynamics.newton_euler import sensor_poses
from testbed.identification.payload.static_fit import RestFit, rest_fit
from testbed.recordings.columns import AXES
from testbed.robot.tree import Tree

FEW = 60
"""Poses by which the best of many readings is found."""

TRIALS = 6
"""Parts of the poses that are left out, one after the other."""

BETTER = 0.5
"""Errors in poses left out over those as said, below which a reading is proposed."""

DOUBTFUL = 0.03
"""Part of a tool's weight in the residuals above which a reading does not explain the poses."""

ALIKE = 2.0
"""Errors over the least ones up to which a simpler reading is preferred."""

LEVEL = np.deg2rad(3.0)
"""Tilt of gravity up to which a base is called level [rad]."""

STEP = np.deg2rad(15)
STARTS = np.arange(-12, 12) * STEP
"""Zeros of a joint from which a search begins [rad]."""


@dataclass(frozen=True, eq=False)
class StaticPoses:
    """Poses at rest: joint positions, and what a force sensor showed.

    Attributes:
        position: Of the joints that lead to the sensor, (P, n) [rad or m].
        wrench: (P, 6) [N, N m].
        repairs: Codes of what was repaired in reading, and how often.
    """

    position: Array
    wrench: Array
    repairs: tuple[tuple[str, float], ...] = ()

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
        """What explains it best."""
        return rest_fit(self.back, self.wrench, self.turn)

    @cached_property
    def held_out(self) -> Array:
        """Rms errors of forces and of moments in poses that a fit has not used, (2,)."""
        errors, part = np.empty_like(self.wrench), np.arange(len(self.back)) % TRIALS
        for k in range(TRIALS):
            used, out = self.only(part != k), self.only(part == k)
            errors[part == k] = used.fit.errors(out.back, out.wrench)
        return np.asarray(np.sqrt((errors.reshape(-1, 2, 3) ** 2).mean(axis=(0, 2))))

    @property
    def few(self) -> PoseReading:
        """At most `FEW` of the poses."""
        return self.only(slice(None, None, -(-len(self.back) // FEW)))

    def only(self, poses: Array | slice) -> PoseReading:
        """Some of the poses."""
        return replace(self, back=self.back[poses], wrench=self.wrench[poses])


def as_said(tree: Tree, table: StaticPoses) -> PoseReading:
    """A table of poses, read as it was said.

    Args:
        tree: What the sensor feels.
        table: The poses.
    """
    return PoseReading(np.swapaxes(sensor_poses(tree, table.position)[0], 1, 2), table.wrench)


def best_other(tree: Tree, table: StaticPoses) -> PoseReading:
    """The best of `other_readings`.

    Args:
        tree: What the sensor feels.
        table: The poses.
    """
    return min(_others(tree, table), key=lambda each: float(np.prod(each.few.fit.scale)))


def _others(tree: Tree, table: StaticPoses) -> Iterator[PoseReading]:
    """Along the base's axes, in degrees, columns of opposite sign, two columns exchanged."""
    said = as_said(tree, table)
    along = np.einsum("pij,pkj->pki", said.back, table.wrench.reshape(-1, 2, 3)).reshape(-1, 6)
    for subject, part in (("wrench", slice(6)), ("forces", slice(3)), ("moments", slice(3, 6))):
        wrench = table.wrench.copy()
        wrench[:, part] = along[:, part]
        yield replace(said, wrench=wrench, code="base-axes", subject=subject)
    degrees = replace(table, position=np.deg2rad(table.position))
    yield replace(as_said(tree, degrees), code="degrees")
    names = (*tree.names, *AXES)
    kinds = [(k >= tree.n) + (k >= tree.n + 3) for k in range(len(names))]
    for a, b in combinations_with_replacement(range(len(names)), 2):
        if kinds[a] != kinds[b]:
            continue
        order = np.arange(len(names))
        order[[a, b]] = b, a
        columns = np.hstack([table.position, table.wrench])[:, order]
        columns[:, a] *= -1 if a == b else 1
        found = as_said(tree, StaticPoses(columns[:, : tree.n], columns[:, tree.n :]))
        code, subject = (
            ("sign", names[a]) if a == b else ("exchanged", f"{names[a]} and {names[b]}")
        )
        yield replace(found, code=code, subject=subject)


def with_zero(tree: Tree, table: StaticPoses) -> PoseReading:
    """With another zero of that joint which explains the poses best under the model's gravity.

    Gravity shows no zero of the first joint: it turns with the base.

    Args:
        tree: What the sensor feels.
        table: The poses.
    """
    scale = as_said(tree, table).few.fit.scale[:, None]
    level = tree.gravity / np.linalg.norm(tree.gravity)

    def shifted(shift: float, joint: int) -> PoseReading:
        return as_said(
            tree, replace(table, position=table.position + shift * np.eye(tree.n)[joint])
        )

    def cost(shift: float, joint: int) -> float:
        few = shifted(shift, joint).few
        errors = few.fit.errors(few.back, few.wrench).reshape(-1, 2, 3) / scale
        tilt = (few.fit.weight / np.linalg.norm(few.fit.weight) - level) / LEVEL
        return float(np.sum(errors**2) + tilt @ tilt)

    found = []
    for joint in range(1, tree.n):
        start = min(STARTS, key=lambda shift: cost(shift, joint))
        near = (start - STEP, start + STEP)
        best = minimize_scalar(cost, bounds=near, args=(joint,), method="bounded")
        found.append((float(best.fun), joint, float(best.x)))
    found.sort()
    alike = [
        f"'{tree.names[k]}' by {np.rad2deg(x):+.1f}" for e, k, x in found if e < ALIKE * found[0][0]
    ]
    _, joint, shift = found[0]
    return replace(shifted(shift, joint), code="zeros", subject=" or ".join(alike))


def likely_reading(said: PoseReading, others: Sequence[PoseReading]) -> PoseReading | None:
    """The reading that explains poses which it has not seen; None where none does, or all do.

    Args:
        said: As it was said.
        others: The simplest first.
    """
    most = BETTER**2 * float(np.prod(said.held_out))
    good = [each for each in others if each.fit.share < DOUBTFUL and not each.fit.open]
    errors = [float(np.prod(each.held_out)) for each in good]
    least = min([most, *errors])
    return next(
        (x for x, e in zip(good, errors, strict=True) if e < min(most, ALIKE * least)), None
    )
