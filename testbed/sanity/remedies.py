"""What would make a recording right: lines of its mapping, as values."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from testbed.arrays import Array
from testbed.recordings.columns import AXES
from testbed.recordings.importing.draft import in_toml
from testbed.recordings.importing.foreign_units import LENGTHS, factor
from testbed.robot.rotations import from_rpy, to_rpy
from testbed.robot.tree import Tree
from testbed.sanity.hypotheses import KINDS, Hypothesis

Line: TypeAlias = tuple[str, str, Any]
"""A table of the mapping, a key of it, and the value that it should have."""


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


def remedies_for(tree: Tree, hypotheses: Sequence[Hypothesis], before: Array, after: Array,
                 mapping: Mapping[str, Any], torques: int) -> tuple[Remedy, ...]:  # fmt: skip
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
    remedies = []
    for each in hypotheses:
        lines = tuple(_lines(tree, each, mapping))
        mapping = with_lines(mapping, lines)  # on which the next ones build
        every = range(len(before))
        own = {"wrench": every[torques:], "torque": each.joints}.get(KINDS[each.kind].table, every)
        best = max(own, key=lambda k: before[k] - after[k])
        joints = tuple(tree.names[k] for k in each.joints)
        shares = float(before[best]), float(after[best])
        remedies.append(Remedy(each.kind, joints, each.values, lines, channels[best], *shares))
    return tuple(remedies)


def in_mapping(lines: Iterable[Line]) -> str:
    """What the mapping should say: of lines about one key the last, which builds on the others.

    Args:
        lines: To be applied together, in this order.
    """
    last = {(table, key): value for table, key, value in lines}
    return "in the mapping: " + "; ".join(
        f"[{table}] {key} = {in_toml(value)}" for (table, key), value in last.items()
    )


def with_lines(mapping: Mapping[str, Any], lines: Iterable[Line]) -> dict[str, Any]:
    """A mapping that says other values.

    Args:
        mapping: As a recording keeps it.
        lines: What it should say.
    """
    edited = {**mapping}
    for table, key, value in lines:
        here = edited
        for part in table.split("."):
            here[part] = {**(here.get(part) or {})}
            here = here[part]
        here[key] = value
    return edited


def _lines(tree: Tree, hypothesis: Hypothesis, mapping: Mapping[str, Any]) -> Iterator[Line]:
    """What to write of one hypothesis, in terms of what is written if that is known."""
    name = KINDS[hypothesis.kind].table
    table = mapping.get(name) or {}
    if name == "wrench":
        plates = mapping.get("plates") or {}
        tables = {f"plates.{plate}": each for plate, each in plates.items()} or {name: table}
        for plate, each in tables.items():
            yield (plate, *_plate_line(hypothesis, each, alone=not plates))
    elif name == "base":
        yield (name, *_base_line(hypothesis, table))
    else:
        order = [tree.names.index(joint) for joint in mapping.get("joints", tree.names)]
        for key, value in _joint_lines(tree, hypothesis, table, order):
            yield name, key, value


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
    place = table.get("place") or {"xyz": [0.0] * 3, "rpy": [0.0] * 3}
    rpy, xyz = place["rpy"], np.array(place["xyz"], float)
    if kind == "turn":
        turn = from_rpy(values)
        rpy = values if alone else to_rpy(turn @ from_rpy(rpy))
        xyz = xyz if alone else turn @ xyz
    else:
        xyz = np.array(values) if alone else xyz + values
    return "place", {"xyz": np.round(xyz, 4).tolist(), "rpy": [round(a, 5) + 0.0 for a in rpy]}


def _base_line(hypothesis: Hypothesis, table: Mapping[str, Any]) -> tuple[str, Any]:
    """A key of the base's table and its value."""
    if hypothesis.kind == "quaternion_order":
        columns = table.get("quaternion", ("x", "y", "z", "w"))
        return "quaternion", [columns[k] for k in hypothesis.values]
    wanted = factor("position", table.get("unit", "m")) / hypothesis.values[0]
    units = [unit for unit, size in LENGTHS.items() if np.isclose(size, wanted)]
    return "unit", units[0] if units else f"one of {wanted:g} m"


def _joint_lines(
    tree: Tree, hypothesis: Hypothesis, table: Mapping[str, Any], order: Sequence[int]
) -> Iterator[tuple[str, Any]]:
    """Keys of the joints' columns and their values, in the mapping's own order of joints."""
    kind, matrix, offset = hypothesis.kind, table.get("matrix"), table.get("offset") or ()
    here = [k in hypothesis.joints for k in order]
    if kind.endswith("sign"):
        if matrix:
            rows = zip(matrix, here, strict=True)
            yield "matrix", [[-x for x in row] if turn else row for row, turn in rows]
        else:
            yield "sign", _opposite(table.get("sign") or [1] * len(order), here)
        if any(offset):
            yield "offset", _opposite(offset, here)
    if kind in ("degrees", "radians"):
        right, other = ("deg", "rad") if kind == "degrees" else ("rad", "deg")
        unit = table.get("unit")
        if not isinstance(unit, list):
            unit = [other if tree.joints[k].revolute else "m" for k in order]
        units = [right if turn else each for each, turn in zip(unit, here, strict=True)]
        yield "unit", right if set(units) == {right} else units
    if kind == "zero":
        angles = dict(zip(hypothesis.joints, hypothesis.values, strict=True))
        before = zip(order, offset or [0.0] * len(order), strict=True)
        yield "offset", [round(x + angles[k], 5) if k in angles else x for k, x in before]
    if kind.endswith("order"):
        columns = table.get("columns", ())
        if matrix or len(columns) != len(order):
            columns = [tree.names[k] for k in order]
        by_joint = dict(zip(order, columns, strict=True))
        yield "columns", [by_joint[hypothesis.values[k]] for k in order]


def _opposite(values: Sequence[float], here: Sequence[bool]) -> list[float]:
    """Numbers, some of them with the other sign; zero has none."""
    return [-x if turn and x else x for x, turn in zip(values, here, strict=True)]
