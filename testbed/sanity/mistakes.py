"""Mistakes that mappings hold, as values; what positions and plate would be without each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product
from typing import Any, Literal

import numpy as np

from testbed.arrays import Array
from testbed.recordings.importing.foreign_units import FORCES, MOMENTS
from testbed.robot.free_base import FREE
from testbed.robot.rotations import to_rpy
from testbed.robot.tree import Tree
from testbed.sanity.plate_map import placed, quarter_turns

Kind = Literal[
    "degrees", "radians", "position_sign", "position_order", "zero", "base_unit",
    "quaternion_order", "torque_sign", "torque_order", "torque_size", "units", "plate_order",
    "turn", "shift", "sense", "tare", "late",
]  # fmt: skip

QUARTERS = (np.pi / 2, -np.pi / 2, np.pi)
"""Zeros that model files and controllers put elsewhere [rad]."""

SCANNED = tuple(np.deg2rad([-135, -45, 45, 135]).tolist())
"""Other zeros to try [rad]."""

BEYOND = 2 * np.pi
"""Positions below this are no degrees taken for radians: nobody moves so little [rad]."""

LITTLE = np.deg2rad(2 * BEYOND)
"""Excursions below this may be radians that were taken for degrees [rad]."""

PLATE_ORDERS = (
    (3, 4, 5, 0, 1, 2), (1, 0, 2, 3, 4, 5), (0, 2, 1, 3, 4, 5), (2, 1, 0, 3, 4, 5),
    (0, 1, 2, 4, 3, 5), (0, 1, 2, 3, 5, 4), (0, 1, 2, 5, 4, 3),
)  # fmt: skip
"""Moments before forces, and two channels exchanged; axes in another order are a turn."""

BASE_UNITS = (1e-3, 1e-2, 1e2, 1e3)
"""Times that a base's positions are taken too small or too large: mm or cm for m."""

SCALAR_LAST = (3, 0, 1, 2)
"""Where w, x, y, z of a quaternion stand that is x, y, z, w."""

DOUBT: dict[str, float] = {
    "plate_order": 1.0, "position_order": 1.5, "position_sign": 1.5, "zero": 4.0, "late": 4.0,
}  # fmt: skip
"""Of two mistakes that explain the same, the one that files hold more often comes first [nats]."""

STEPS, ODD = (np.pi / 2, np.pi / 12), 2.0
"""Steps of angles that people write [rad]; what another turn must explain more [nats]."""

MOST_JOINTS = 12
"""Joints of a robot up to which orders and zeros are tried: their number grows fast."""


@dataclass(frozen=True)
class Mistake:
    """One mistake that a mapping may hold, as what must be done to the data.

    Attributes:
        kind: What is wrong.
        joints: Indices of the joints that it is about.
        values: Of zeros the angles to add, one a joint [rad]; of orders, in which column the k-th
            joint or channel is; of units their names; of a turn the frame's roll, pitch and yaw
            [rad]; of a shift the frame's origin [m]; of a plate that is late by how much [s]; of
            sizes, and of a base's unit, how many times too large the numbers are.
    """

    kind: Kind
    joints: tuple[int, ...] = ()
    values: tuple[Any, ...] = ()

    @property
    def doubt(self) -> float:
        """What it must explain more than another mistake [nats]."""
        if self.kind == "turn":  # people turn by right angles, and then by what is on a protractor
            angles = np.array(self.values)
            odd = [np.abs(angles - np.round(angles / step) * step).max() > 1e-4 for step in STEPS]
            return float(ODD * sum(odd))
        odd_zeros = self.kind == "zero" and not set(self.values) <= set(QUARTERS)
        times = len(self.joints) + odd_zeros if self.kind == "zero" else 1
        return DOUBT.get(self.kind, 0.0) * times


@dataclass(frozen=True, eq=False)
class Frame:
    """How a mapping has read the plate.

    Attributes:
        turn: Of the sensor's frame, (3, 3).
        place: Of its origin, (3,) [m].
        units: Of forces and moments.
    """

    turn: Array
    place: Array
    units: tuple[str, str]

    def map(
        self, turn: Array, units: tuple[str, str], order: Sequence[int], ratio: float = 1.0
    ) -> Array:
        """The wrench in the bedplate's frame by another reading, of that by this one, (6, 6).

        Args:
            turn: Of the sensor's frame, (3, 3).
            units: Of forces and moments.
            order: In which column each channel is.
            ratio: Times that moments are larger than in these units.
        """
        sizes = (FORCES[units[0]], ratio * MOMENTS[units[1]])
        given = (FORCES[self.units[0]], MOMENTS[self.units[1]])
        scale = np.repeat(sizes, 3)
        columns = (
            np.diag(scale) @ np.eye(6)[list(order)] @ np.diag(np.repeat(1 / np.array(given), 3))
        )
        found: Array = (
            placed(turn, self.place) @ columns @ np.linalg.inv(placed(self.turn, self.place))
        )
        return found


AS_READ = (0, 1, 2, 3, 4, 5)


@lru_cache(maxsize=3)
def plain_hypotheses(frame: Frame) -> tuple[tuple[tuple[Mistake, ...], Array], ...]:
    """Nothing wrong about a plate, or one mistake, and the map that undoes it.

    The sense is the sign of what the model file predicts; a shift is fitted.

    Args:
        frame: How the mapping has read the plate.
    """
    turns = [turn @ frame.turn for turn in quarter_turns()[1:]]
    pairs = [units for units in product(FORCES, MOMENTS) if units != frame.units]
    return (
        ((), np.eye(6)),
        *(((Mistake("plate_order", (), order),), frame.map(frame.turn, frame.units, order))
          for order in PLATE_ORDERS),
        *(((Mistake("units", (), units),), frame.map(frame.turn, units, AS_READ))
          for units in pairs),
        *(((turned(turn),), frame.map(turn, frame.units, AS_READ)) for turn in turns),
    )  # fmt: skip


def turned(turn: Array) -> Mistake:
    """The mistake of a frame that is turned so, (3, 3)."""
    return Mistake("turn", (), tuple(np.round(to_rpy(turn), 6).tolist()))


def position_hypotheses(
    tree: Tree, position: Array, beside: Sequence[Mistake]
) -> Iterator[Mistake]:
    """Mistakes about positions that may be there besides others.

    Args:
        tree: The robot.
        position: (T, n) [rad or m].
        beside: Mistakes that were undone.
    """
    own = own_joints(tree)
    turning = [k for k in own if tree.joints[k].revolute]
    before = {each.kind for each in beside}
    if turning and not before & {"degrees", "radians"}:
        if np.abs(position[:, turning]).max() > BEYOND:
            yield Mistake("degrees", tuple(turning))
        if np.ptp(position[:, turning], axis=0).max() < LITTLE:
            yield Mistake("radians", tuple(turning))
    if tree.floating and "base_unit" not in before:
        yield from (Mistake("base_unit", (), (factor,)) for factor in BASE_UNITS)
    if tree.floating and "quaternion_order" not in before:
        yield Mistake("quaternion_order", (), SCALAR_LAST)
    yield from (Mistake("position_sign", (joint,)) for joint in own)
    if tree.n > MOST_JOINTS:
        return
    for joint, angle in product(turning, QUARTERS):
        if tree.children(
            joint
        ):  # another zero of the last joint only renames its body's parameters
            yield Mistake("zero", (joint,), (angle,))
    for order in _orders(tree, own):
        moved = tuple(k for k in own if order[k] != k)
        if all(tree.joints[k].kind == tree.joints[order[k]].kind for k in moved):
            yield Mistake("position_order", moved, order)


def rarer_hypotheses(tree: Tree, *, pairs: bool) -> Iterator[Mistake]:
    """Zeros of neighbours that are wrong together, and zeros by any angle.

    Args:
        tree: The robot.
        pairs: Whether to try neighbours.
    """
    own = own_joints(tree) if tree.n <= MOST_JOINTS else ()
    turning = [k for k in own if tree.joints[k].revolute and tree.children(k)]
    for joint in turning:
        for other, angles in product(tree.children(joint), product(QUARTERS, repeat=2)):
            if pairs and other in turning:
                yield Mistake("zero", (joint, other), angles)
        yield from (Mistake("zero", (joint,), (angle,)) for angle in SCANNED)


def joint_map(mistake: Mistake, n: int, offset: Array) -> tuple[Array, Array]:
    """Positions without a mistake are scale @ position + added: (n, n) and (n,).

    Args:
        mistake: About positions, but for the order of a quaternion.
        n: Joints.
        offset: What the mapping has added to the positions, (n,).
    """
    scale, added, here = np.ones(n), np.zeros(n), list(mistake.joints)
    if mistake.kind == "position_order":
        return np.eye(n)[list(mistake.values)], added
    if mistake.kind == "position_sign":
        scale[here] = -1.0
    if mistake.kind == "degrees":
        scale[here] = np.pi / 180
    if mistake.kind == "radians":
        scale[here] = 180 / np.pi
        added[here] = ((1 - 180 / np.pi) * offset)[here]
    if mistake.kind == "zero":
        added[here] = mistake.values
    if mistake.kind == "base_unit":
        scale[:3] = 1 / mistake.values[0]
    return np.diag(scale), added


def merged(mistakes: Sequence[Mistake]) -> tuple[Mistake, ...]:
    """Signs and zeros of several joints, each kind as one mistake: it is one line of a mapping.

    Args:
        mistakes: In the order in which they are undone.
    """
    signs: dict[Kind, set[int]] = {"position_sign": set(), "torque_sign": set()}
    zeros: dict[int, float] = {}
    for each in mistakes:
        if each.kind in signs:
            signs[each.kind] ^= set(each.joints)
        if each.kind == "position_sign":  # of what was added before, too
            zeros |= {joint: -zeros[joint] for joint in each.joints if joint in zeros}
        if each.kind == "zero":
            for joint, angle in zip(each.joints, each.values, strict=True):
                zeros[joint] = zeros.get(joint, 0.0) + angle
    zeros = {joint: angle for joint, angle in sorted(zeros.items()) if angle}
    found = [m for m in mistakes if m.kind not in (*signs, "zero")]
    found += [Mistake(kind, tuple(sorted(joints))) for kind, joints in signs.items() if joints]
    found += [Mistake("zero", tuple(zeros), tuple(zeros.values()))] if zeros else []
    return tuple(found)


def own_joints(tree: Tree) -> range:
    """The robot's own joints: all, but for the coordinates of a free base.

    Args:
        tree: The robot.
    """
    return range(FREE if tree.floating else 0, tree.n)


def _orders(tree: Tree, own: range) -> Iterator[tuple[int, ...]]:
    """Two joints exchanged; all of them rolled or in reverse."""
    same = list(range(tree.n))
    for one, other in combinations(own, 2):
        order = list(same)
        order[one], order[other] = other, one
        yield tuple(order)
    if len(own) > 2:
        base, rest = same[: own.start], np.array(own)
        yield from ((*base, *np.roll(rest, k).tolist()) for k in range(1, len(own)))
        if len(own) > 3:
            yield (*base, *rest[::-1].tolist())
