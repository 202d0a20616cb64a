"""What would cure a recording: lines of its mapping, as values."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from testbed.arrays import Array
from testbed.recordings.columns import AXES
from testbed.recordings.importing.foreign_units import factor, plain
from testbed.robot.rotations import from_rpy, to_rpy
from testbed.robot.tree import Tree
from testbed.sanity.mistakes import Frame, Mistake

Line: TypeAlias = tuple[str, str, Any]
"""A table of the mapping, a key of it, and the value that it should have."""

WHAT = {
    "position_sign": "the opposite sign of the position",
    "torque_sign": "the opposite sign of the torque",
    "torque_size": "torques of another size",
    "sense": "the opposite sense of the wrench",
    "degrees": "degrees taken for radians",
    "radians": "radians taken for degrees",
    "zero": "another zero of the position",
    "position_order": "positions in another order of joints",
    "torque_order": "torques in another order of joints",
    "units": "other units of the plate",
    "plate_order": "the plate's columns in another order",
    "turn": "a plate's frame that is turned",
    "shift": "a plate's frame that lies elsewhere",
    "tare": "a plate that was not zero without the robot",
    "late": "a clock of the plate that is off",
    "base_unit": "another unit of the base's position",
    "quaternion_order": "x, y, z, w of the base's quaternion taken for w, x, y, z",
}
"""By the kind of mistake."""

OF_PLATE = ("sense", "units", "plate_order", "turn", "shift", "tare", "late")
"""Mistakes about plates."""

OF_BASE = ("base_unit", "quaternion_order")
"""Mistakes about a base that moves."""


@dataclass(frozen=True)
class Cure:
    """One thing to change in a mapping, and what it does to the data.

    Attributes:
        kind: Of the mistake, a key of `WHAT`.
        joints: Names of the joints that it is about; empty where it is about plate or base.
        values: As of the `Mistake`: angles, an order, units, roll, pitch and yaw, ...
        lines: What the mapping should say.
        channel: Which channel the cure helps most.
        before: Part of its variance that is unexplained as recorded.
        after: The same with all cures.
    """

    kind: str
    joints: tuple[str, ...]
    values: tuple[Any, ...]
    lines: tuple[Line, ...]
    channel: str
    before: float
    after: float


def remedy(cures: Iterable[Cure]) -> str:
    """What the mapping should say: of lines about one key the last, which builds on the others.

    Args:
        cures: To be made together, in this order.
    """
    last = {(table, key): value for each in cures for table, key, value in each.lines}
    return "; ".join(_written(*names, value) for names, value in last.items())


def frame_of(mapping: Mapping[str, Any]) -> Frame:
    """How a mapping has read its plate; as the bedplate's own where it has none, or several.

    Args:
        mapping: What the recording's mapping file says; empty if it has none.
    """
    table = mapping.get("wrench") or {}
    place = table.get("place") or {"xyz": [0.0] * 3, "rpy": [0.0] * 3}
    force, moment = (plain(each) for each in table.get("units", ("N", "N m")))
    return Frame(from_rpy(place["rpy"]), np.array(place["xyz"], float), (force, moment))


def lines_of(tree: Tree, mistakes: Sequence[Mistake], mapping: Mapping[str, Any]
             ) -> dict[Mistake, tuple[Line, ...]]:  # fmt: skip
    """What to write for each of several mistakes, one after the other.

    Args:
        tree: The robot.
        mistakes: That were undone, in this order.
        mapping: What the recording's mapping file says; empty if it has none.
    """
    found: dict[Mistake, tuple[Line, ...]] = {}
    said: dict[str, Any] = {**mapping}
    for each in mistakes:
        lines = tuple(_lines(tree, each, said))
        found[each] = lines
        said = with_lines(said, lines)
    return found


def with_lines(mapping: Mapping[str, Any], lines: Sequence[Line]) -> dict[str, Any]:
    """A mapping that says other values.

    Args:
        mapping: As a recording keeps it.
        lines: What it should say.
    """
    said: dict[str, Any] = {**mapping}
    for table, key, value in lines:
        first, _, plate = table.partition(".")
        if plate:
            plates = said.get(first, {})
            said[first] = {**plates, plate: {**plates.get(plate, {}), key: value}}
        else:
            said[first] = {**(said.get(first) or {}), key: value}
    return said


def _lines(tree: Tree, mistake: Mistake, mapping: Mapping[str, Any]) -> Iterator[Line]:
    """What to write of one mistake, in terms of what is written if that is known."""
    if mistake.kind in OF_PLATE:
        plates = {f"plates.{name}": said for name, said in (mapping.get("plates") or {}).items()}
        tables = plates or {"wrench": mapping.get("wrench") or {}}
        for name, said in tables.items():
            yield (name, *_of_plate(mistake, said, alone=not plates))
    elif mistake.kind in OF_BASE:
        yield ("base", *_of_base(mistake, mapping.get("base") or {}))
    elif mistake.kind.endswith("order"):
        yield _order_line(tree, mistake, mapping)
    else:
        yield from _of_joints(tree, mistake, mapping)


def _of_plate(mistake: Mistake, table: Mapping[str, Any], *, alone: bool) -> tuple[str, Any]:
    """A key of a plate's table and its value; several plates are moved as one."""
    if mistake.kind == "sense":
        return "sense", "on_plate" if table.get("sense") != "on_plate" else "on_robot"
    if mistake.kind == "plate_order":
        columns = table.get("columns", AXES)
        columns = columns if len(columns) == len(AXES) else AXES
        return "columns", [columns[k] for k in mistake.values]
    if mistake.kind == "late":
        return "delay", round(float(table.get("delay", 0.0)) + mistake.values[0], 4)
    if mistake.kind in ("units", "tare"):
        return mistake.kind, list(mistake.values)
    place = table.get("place") or {"xyz": [0.0] * 3, "rpy": [0.0] * 3}
    given, turn = from_rpy(place["rpy"]), np.eye(3)
    rpy, xyz = place["rpy"], np.array(place["xyz"], float)
    if mistake.kind == "turn":
        turn = from_rpy(mistake.values)
        rpy = mistake.values if alone else to_rpy(turn @ given)
        xyz = xyz if alone else turn @ xyz
    else:
        xyz = np.array(mistake.values) if alone else xyz + mistake.values
    return "place", {"xyz": np.round(xyz, 4).tolist(), "rpy": [round(a, 5) + 0.0 for a in rpy]}


def _of_base(mistake: Mistake, table: Mapping[str, Any]) -> tuple[str, Any]:
    """A key of the base's table and its value."""
    if mistake.kind == "quaternion_order":
        columns = table.get("quaternion", ("x", "y", "z", "w"))
        return "quaternion", [columns[k] for k in mistake.values]
    wanted = factor("position", table.get("unit", "m")) / mistake.values[0]
    known = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
    other = [unit for unit, size in known.items() if np.isclose(size, wanted)]
    return "unit", other[0] if other else f"one of {wanted:g} m"


def _of_joints(tree: Tree, mistake: Mistake, mapping: Mapping[str, Any]) -> Iterator[Line]:
    """Signs, units and zeros of the joints' columns, in the mapping's own order."""
    signal = "torque" if mistake.kind.startswith("torque") else "position"
    table = mapping.get(signal) or {}
    if mistake.kind.endswith("sign") and "matrix" in table and table["matrix"]:
        rows = _by_name(tree, table["matrix"], mapping, [])
        turned = [[-x for x in r] if k in mistake.joints else r for k, r in enumerate(rows)]
        yield signal, "matrix", _by_mapping(tree, turned, mapping)
    if mistake.kind.endswith("sign"):
        keys = {"sign": 1, "offset": 0.0}
        given = {key for key in keys if any(table.get(key) or ())} | {"sign"}
        for key in sorted(given - ({"sign"} if table.get("matrix") else set()), reverse=True):
            before = _by_name(tree, table.get(key), mapping, keys[key])
            after = [-x if k in mistake.joints and x else x for k, x in enumerate(before)]
            yield signal, key, _by_mapping(tree, after, mapping)
    if mistake.kind in ("degrees", "radians"):
        yield "position", "unit", _angle_units(tree, mistake, table, mapping)
    if mistake.kind == "zero":
        offsets = _by_name(tree, table.get("offset"), mapping, 0.0)
        for joint, angle in zip(mistake.joints, mistake.values, strict=True):
            offsets[joint] = round(offsets[joint] + angle, 5)
        yield "position", "offset", _by_mapping(tree, offsets, mapping)


def _angle_units(
    tree: Tree, mistake: Mistake, table: Mapping[str, Any], mapping: Mapping[str, Any]
) -> str | list[str]:
    """Units of the positions: one for all joints, or a list in the mapping's order."""
    right, other = ("deg", "rad") if mistake.kind == "degrees" else ("rad", "deg")
    given = table.get("unit")
    said = _by_name(tree, given if isinstance(given, list) else None, mapping, None)
    units = []
    for k, (joint, unit) in enumerate(zip(tree.joints, said, strict=True)):
        kept = unit or (other if joint.revolute else "m")
        units.append(right if k in mistake.joints else kept)
    found = _by_mapping(tree, units, mapping)
    return right if set(found) == {right} else found


def _order_line(tree: Tree, mistake: Mistake, mapping: Mapping[str, Any]) -> Line:
    """Columns in their right order; joints' names in their place where the mapping has none."""
    signal = mistake.kind.partition("_")[0]
    table = mapping.get(signal) or {}
    plain_columns = not table.get("matrix") and len(table.get("columns", ())) == tree.n
    found = _by_name(tree, table["columns"], mapping, "") if plain_columns else list(tree.names)
    ordered = [found[k] for k in mistake.values]
    return signal, "columns", _by_mapping(tree, ordered, mapping)


def cures_of(tree: Tree, mistakes: Sequence[Mistake], before: Array, after: Array,
             mapping: Mapping[str, Any], torques: int) -> tuple[Cure, ...]:  # fmt: skip
    """What to change where mistakes were found.

    Args:
        tree: The robot.
        mistakes: That were undone, in this order.
        before: Part of each channel's variance that is unexplained as recorded, (C,).
        after: The same without the mistakes.
        mapping: What the recording's mapping file says; empty if it has none.
        torques: How many of the channels, the first, are torques.
    """
    names = [*(f"the torque of '{name}'" for name in tree.names[:torques]), *AXES]
    found = []
    for mistake, lines in lines_of(tree, mistakes, mapping).items():
        own = np.ones(len(before), bool)
        if mistake.kind in OF_PLATE:
            own[:torques] = False
        elif mistake.kind.startswith("torque"):
            own = np.isin(np.arange(len(before)), mistake.joints)
        best = int(np.argmax(np.where(own, before - after, -np.inf)))
        joints = tuple(tree.names[k] for k in mistake.joints)
        found.append(
            Cure(
                mistake.kind,
                joints,
                mistake.values,
                lines,
                names[best],
                float(before[best]),
                float(after[best]),
            )
        )
    return tuple(found)


def position_offset(tree: Tree, mapping: Mapping[str, Any]) -> Array:
    """What a mapping has added to the positions, in the order of the tree's joints, (n,).

    Args:
        tree: The robot.
        mapping: What the recording's mapping file says; empty if it has none.
    """
    said = (mapping.get("position") or {}).get("offset")
    return np.array(_by_name(tree, said, mapping, 0.0), dtype=np.float64)


def _by_name(tree: Tree, values: Sequence[Any] | None, mapping: Mapping[str, Any],
             default: Any) -> list[Any]:  # fmt: skip
    """A mapping's list in the order of the tree's joints."""
    joints = mapping.get("joints", list(tree.names))
    found = dict(zip(joints, values or [default] * len(joints), strict=False))
    return [found.get(name, default) for name in tree.names]


def _by_mapping(tree: Tree, values: Sequence[Any], mapping: Mapping[str, Any]) -> list[Any]:
    """A list in the order of the tree's joints, in the mapping's own order."""
    found = dict(zip(tree.names, values, strict=True))
    return [found[name] for name in mapping.get("joints", tree.names)]


def _written(table: str, key: str, value: Any) -> str:
    """A line of a mapping file."""
    if isinstance(value, dict):
        return (
            f"[{table}] {key} = {{ {', '.join(f'{k} = {_value(v)}' for k, v in value.items())} }}"
        )
    return f"[{table}] {key} = {_value(value)}"


def _value(value: Any) -> str:
    if isinstance(value, list) and value and all(isinstance(x, int | float) for x in value):
        return numbers(value)
    return json.dumps(value)


def numbers(values: Sequence[float]) -> str:
    """A list as a mapping file has it."""
    return "[" + ", ".join(f"{value:.5g}" for value in values) + "]"
