"""What a mapping may say wrongly, as values, and the lines that would make it right."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.base.errors import few, round_significant
from testbed.core.recordings.columns import AXES
from testbed.core.robot import gravity
from testbed.core.robot.free_base import FREE, coordinates, poses
from testbed.core.robot.rotations import from_rpy, to_rpy
from testbed.core.robot.tree import Tree
from testbed.importing.foreign_table import LENGTHS, factor
from testbed.importing.import_report import Line
from testbed.importing.vocabulary import read_table


class Kind(NamedTuple):
    """A kind of hypothesis: what is wrong in words, in which table, and what it must explain more.

    Of two that explain the same, the one that files hold more often comes first [nats].
    """

    words: str
    table: Literal["position", "torque", "wrench", "base", ""]
    penalty: float = 0.0


KINDS = {name: Kind(**each) for name, each in read_table("hypotheses").items()}

QUARTERS = (np.pi / 2, -np.pi / 2, np.pi)
"""Zeros that model files and controllers put elsewhere [rad]."""

BEYOND = 2 * np.pi
"""Positions below this are no degrees taken for radians: nobody moves so little [rad]."""

LITTLE = np.deg2rad(2 * BEYOND)
"""Excursions below this may be radians that were taken for degrees [rad]."""

FACTORS = {"position_sign": -1.0, "degrees": np.pi / 180, "radians": 180 / np.pi}
"""What positions are multiplied by."""

STEPS, ODD = (np.pi / 2, np.pi / 12), 2.0
"""Steps of angles that people write [rad]; what another turn must explain more [nats]."""

MOST_JOINTS = 12
"""Joints of a robot up to which orders and zeros are tried: their number grows fast."""


@dataclass(frozen=True)
class Hypothesis:
    """One thing that a mapping may say wrongly, as what must be done to the data.

    Attributes:
        kind: What is wrong, a key of `KINDS`.
        joints: Indices of the joints that it is about.
        values: Of zeros the angles to add, one a joint [rad]; of orders, in which column the k-th
            joint or channel is; of units their names; of a turn the frame's roll, pitch and yaw
            [rad]; of a shift the frame's origin [m]; of what is late by how much [s]; of gravity
            itself [m/s^2]; of sizes and of a base's unit how many times too large the numbers are.
    """

    kind: str
    joints: tuple[int, ...] = ()
    values: tuple[Any, ...] = ()

    @property
    def penalty(self) -> float:
        """What it must explain more than another hypothesis [nats]."""
        # people turn by right angles, and then by what is on a protractor
        if self.kind == "turn":
            angles = np.array(self.values)
            odd = [
                np.abs(angles - np.round(angles / step) * step).max() > 1e-4
                for step in STEPS
            ]
            return float(ODD * sum(odd))
        times = 1
        if self.kind == "zero":
            times = len(self.joints) + (not set(self.values) <= set(QUARTERS))
        return KINDS[self.kind].penalty * times


def in_words(tree: Tree, hypothesis: Hypothesis) -> str:
    """A hypothesis with the joints that it is about, and by how much zeros are off.

    Args:
        tree: The robot.
        hypothesis: What may be wrong.
    """
    words = KINDS[hypothesis.kind].words
    if len(hypothesis.joints) in (0, len(own_joints(tree))):
        return words
    names = few([tree.names[k] for k in hypothesis.joints])
    by = ", ".join(f"{np.rad2deg(angle):.0f}" for angle in hypothesis.values)
    return f"{words} ({names}{f' by {by} deg' if hypothesis.kind == 'zero' else ''})"


def own_joints(tree: Tree) -> range:
    """The robot's own joints: all, but for the coordinates of a free base.

    Args:
        tree: The robot.
    """
    return range(FREE if tree.floating else 0, tree.n)


def exchanges(own: range, count: int) -> Iterator[tuple[int, ...]]:
    """Orders of joints or channels of which two are exchanged.

    Args:
        own: Those that may be.
        count: How many there are in all.
    """
    yield from (exchanged(*pair, count) for pair in combinations(own, 2))


def exchanged(one: int, other: int, count: int) -> tuple[int, ...]:
    """The order of joints or channels of which two are exchanged.

    Args:
        one: Index of the first of them.
        other: Of the second.
        count: How many there are in all.
    """
    order = [*range(count)]
    order[one], order[other] = other, one
    return tuple(order)


def orders(own: range) -> Iterator[tuple[int, ...]]:
    """Orders with two joints exchanged, or with all of them rolled or in reverse.

    Args:
        own: Indices of the joints.
    """
    yield from exchanges(own, own.stop)
    base, rest = [*range(own.start)], [*own]
    if len(rest) > 2:
        for k in range(1, len(rest)):
            yield (*base, *rest[-k:], *rest[:-k])
        yield (*base, *rest[::-1])


def corrected(hypothesis: Hypothesis, position: Array, offset: Array) -> Array:
    """Positions by a hypothesis about them, (M, n).

    Args:
        hypothesis: What the mapping may say wrongly.
        position: As it was read, (M, n).
        offset: What the mapping has added to it, (n,).

    Raises:
        RecordingError: A base would stand on its head.
    """
    kind, values, here = hypothesis.kind, hypothesis.values, list(hypothesis.joints)
    if kind == "position_order":
        return position[:, list(values)]
    if kind == "quaternion_order":
        pose = poses(position[:, :FREE])
        pose[:, 3:] = pose[:, 3:][:, list(values)]
        return np.hstack([coordinates(pose), position[:, FREE:]])
    fixed = position.copy()
    fixed[:, here] *= FACTORS.get(kind, 1.0)
    if kind == "radians":
        fixed[:, here] -= (FACTORS[kind] - 1) * offset[here]
    if kind == "zero":
        fixed[:, here] += values
    if kind == "base_unit":
        fixed[:, :3] /= values[0]
    return fixed


def position_offset(tree: Tree, mapping: Mapping[str, Any]) -> Array:
    """What a mapping has added to the positions, in the order of the tree's joints, (n,).

    Args:
        tree: The robot.
        mapping: What the recording's mapping file says; empty if it has none.
    """
    offsets = (mapping.get("position") or {}).get("offset") or ()
    by_name = dict(zip(mapping.get("joints", tree.names), offsets, strict=False))
    return np.array([by_name.get(name, 0.0) for name in tree.names])


def merge(hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Signs and zeros of several joints, each kind as one: it is one line of a mapping.

    Args:
        hypotheses: In the order in which they are applied.
    """
    count = 1 + max((k for each in hypotheses for k in each.joints), default=0)
    signs = {"position_sign": np.ones(count), "torque_sign": np.ones(count)}
    zeros = np.zeros(count)
    merged = []
    for each in hypotheses:
        here = list(each.joints)
        if each.kind in signs:
            signs[each.kind][here] *= -1
            if each.kind == "position_sign":  # of what was added before, too
                zeros[here] *= -1
        elif each.kind == "zero":
            zeros[here] += each.values
        else:
            merged.append(each)
    for kind, sign in signs.items():
        merged += of_joints(kind, sign < 0)
    return (*merged, *of_joints("zero", zeros != 0, zeros[zeros != 0]))


def of_joints(
    kind: str, those: NDArray[np.bool_], values: AnyArray | None = None
) -> Iterator[Hypothesis]:
    """The hypothesis of a kind about some joints, if there are any.

    Args:
        kind: A key of `KINDS`.
        those: Which joints it is about, (n,).
        values: As of the hypothesis; none by default.
    """
    if those.any():
        joints = np.flatnonzero(those).tolist()
        yield Hypothesis(
            kind, tuple(joints), () if values is None else tuple(values.tolist())
        )


@dataclass(frozen=True)
class Remedy:
    """One thing to change in a mapping, and what it does to the data.

    Attributes:
        kind: Of the hypothesis, a key of `KINDS`.
        joints: Names of the joints that it is about; empty where it is about plate or base.
        values: As of the `Hypothesis`: angles, an order, units, roll, pitch and yaw, ...
        lines: What the mapping should say.
        channel: Which channel it helps most.
        before: Part of its variance that is unexplained as recorded.
        after: The same with all remedies.
    """

    kind: str
    joints: tuple[str, ...]
    values: tuple[Any, ...]
    lines: tuple[Line, ...]
    channel: str
    before: float
    after: float


def remedies_for(
    tree: Tree,
    hypotheses: Sequence[Hypothesis],
    before: Array,
    after: Array,
    mapping: Mapping[str, Any],
    torques: int,
) -> Iterator[Remedy]:
    """What to change in a mapping if hypotheses hold.

    Args:
        tree: The robot.
        hypotheses: In the order in which they are applied.
        before: Part of each channel's variance that is unexplained as recorded, (C,).
        after: The same by the hypotheses.
        mapping: What the recording's mapping file says; empty if it has none.
        torques: How many of the channels, the first, are torques.
    """
    channels = [*(f"the torque of '{name}'" for name in tree.names[:torques]), *AXES]
    for each in hypotheses:
        lines = tuple(_lines(tree, each, mapping))
        mapping = with_lines(mapping, lines)  # on which the next ones build
        every = range(len(before))
        table = KINDS[each.kind].table
        own: Sequence[int] = every[torques:] if table == "wrench" else every
        if table == "torque" and each.joints:
            own = each.joints
        best = max(own, key=lambda k: before[k] - after[k])
        joints = tuple(tree.names[k] for k in each.joints)
        shares = float(before[best]), float(after[best])
        yield Remedy(each.kind, joints, each.values, lines, channels[best], *shares)


def with_lines(mapping: Mapping[str, Any], lines: Iterable[Line]) -> dict[str, Any]:
    """A mapping that says other values.

    Args:
        mapping: As a recording keeps it.
        lines: What it should say.
    """
    edited = {**mapping}
    for table, key, value in lines:
        here = edited
        for part in table.split(".") if table else ():
            here[part] = {**(here.get(part) or {})}
            here = here[part]
        here[key] = value
    return edited


def _lines(
    tree: Tree, hypothesis: Hypothesis, mapping: Mapping[str, Any]
) -> Iterator[Line]:
    """What to write of one hypothesis, in terms of what is written if that is known."""
    signal = KINDS[hypothesis.kind].table
    if hypothesis.kind == "spring":
        return  # no line of a mapping says so
    if hypothesis.kind == "gravity":
        yield "", "gravity", gravity.in_words(hypothesis.values)
        return
    for name, table in tables_of(mapping, signal).items():
        if signal == "wrench":
            pairs = [
                _plate_line(hypothesis, table, alone=not name.startswith("plates."))
            ]
        elif signal == "base":
            pairs = [_base_line(hypothesis, table)]
        else:
            order = [
                tree.names.index(joint) for joint in mapping.get("joints", tree.names)
            ]
            pairs = [*_joint_lines(tree, hypothesis, table, order)]
        yield from ((name, *pair) for pair in pairs)


def tables_of(mapping: Mapping[str, Any], signal: str) -> dict[str, Mapping[str, Any]]:
    """Tables of which a recording's signal was made: a wrench by several plates, or a sensor.

    Args:
        mapping: As a recording keeps it.
        signal: Of the recording; its own table may be empty.
    """
    own = mapping.get(signal) or {}
    for group in ("plates", "sensors"):
        if signal == "wrench" and mapping.get(group) and not own:
            return {f"{group}.{name}": table for name, table in mapping[group].items()}
    return {signal: own}


def place_of(table: Mapping[str, Any]) -> tuple[Sequence[float], Array]:
    """Roll, pitch and yaw [rad] of a plate's frame, and its origin, (3,) [m].

    Args:
        table: What a mapping says of the plate; the bedplate's frame by default.
    """
    place = table.get("place") or {"xyz": [0.0] * 3, "rpy": [0.0] * 3}
    return place["rpy"], np.array(place["xyz"], float)


def _plate_line(
    hypothesis: Hypothesis, table: Mapping[str, Any], *, alone: bool
) -> tuple[str, Any]:
    """A key of a plate's table and its value; several plates are moved as one."""
    kind, values = hypothesis.kind, hypothesis.values
    if kind == "sense":
        return "sense", "on_plate" if table.get("sense") != "on_plate" else "on_robot"
    if kind == "plate_order":
        columns = table.get("columns", AXES)
        columns = columns if len(columns) == len(AXES) else AXES
        return "columns", [columns[k] for k in values]
    if kind == "late":
        return "delay", round(float(table.get("delay", 0.0)) + values[0], 4)
    if kind in ("units", "tare"):
        return kind, list(values)
    rpy, xyz = place_of(table)
    if kind == "turn":
        turn = from_rpy(values)
        rpy = values if alone else to_rpy(turn @ from_rpy(rpy))
        xyz = xyz if alone else turn @ xyz
    else:
        xyz = np.array(values) if alone else xyz + values
    return "place", {
        "xyz": np.round(xyz, 4).tolist(),
        "rpy": [round(a, 5) + 0.0 for a in rpy],
    }


def _base_line(hypothesis: Hypothesis, table: Mapping[str, Any]) -> tuple[str, Any]:
    """A key of the base's table and its value."""
    if hypothesis.kind == "quaternion_order":
        columns = table.get("quaternion", ("x", "y", "z", "w"))
        return "quaternion", [columns[k] for k in hypothesis.values]
    wanted = factor("position", table.get("unit", "m")) / hypothesis.values[0]
    units = (unit for unit, size in LENGTHS.items() if np.isclose(size, wanted))
    return "unit", next(units, f"one of {wanted:g} m")


def _joint_lines(
    tree: Tree, hypothesis: Hypothesis, table: Mapping[str, Any], order: Sequence[int]
) -> Iterator[tuple[str, Any]]:
    """Keys of the joints' columns and their values, in the mapping's own order of joints."""
    kind, matrix, offset = (
        hypothesis.kind,
        table.get("matrix"),
        table.get("offset") or (),
    )
    here = [k in hypothesis.joints for k in order]
    if kind == "gravity_removed":
        yield "gravity", "removed"
    elif kind == "delay":
        delay = float(table.get("delay", 0.0)) + hypothesis.values[0]
        yield "delay", round(delay, 5)
    elif kind.endswith("sign"):
        factors = np.where(here, -1, 1)
        if matrix:
            yield "matrix", (factors[:, None] * matrix).tolist()
        else:
            yield "sign", (factors * (table.get("sign") or 1)).tolist()
        if any(offset):
            yield "offset", (factors * offset + 0.0).tolist()
    elif kind == "torque_size":
        gains = np.broadcast_to(table.get("gain") or np.nan, (len(order),))
        sizes = dict(zip(hypothesis.joints, hypothesis.values, strict=True))
        if np.isfinite(gains).all():  # of currents; torques have a unit and no gain
            pairs = zip(order, gains, strict=True)
            yield (
                "gain",
                [round_significant(g / sizes.get(k, 1.0), 4) for k, g in pairs],
            )
    elif kind in ("degrees", "radians"):
        yield "unit", _angle_units(tree, kind, table.get("unit"), order)
    elif kind == "zero":
        angles = dict(zip(hypothesis.joints, hypothesis.values, strict=True))
        before = zip(order, offset or [0.0] * len(order), strict=True)
        yield (
            "offset",
            [round(float(x + angles[k]), 5) if k in angles else x for k, x in before],
        )
    else:
        columns = table.get("columns", ())
        if matrix or len(columns) != len(order):
            columns = [tree.names[k] for k in order]
        by_joint = dict(zip(order, columns, strict=True))
        yield "columns", [by_joint[hypothesis.values[k]] for k in order]


def _angle_units(
    tree: Tree, kind: str, unit: Any, order: Sequence[int]
) -> str | list[str]:
    """Units of positions, those of joints that turn in the right one."""
    right = "deg" if kind == "degrees" else "rad"
    said = unit if isinstance(unit, list) else ["m"] * len(order)
    pairs = zip(order, said, strict=True)
    units = [right if tree.joints[k].revolute else each for k, each in pairs]
    return right if {*units} == {right} else units
