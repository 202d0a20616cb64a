"""What is wrong with a recording in words, and the line of the mapping file that would cure it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.identification.finding import Finding, few
from testbed.recordings.columns import AXES
from testbed.robot.tree import Tree
from testbed.sanity.mistakes import Mistake, own_joints
from testbed.sanity.search import Reading

WHAT = {
    "position_sign": "the opposite sign of the position",
    "torque_sign": "the opposite sign of the torque",
    "wrench_sense": "the opposite sense of the wrench",
    "degrees": "degrees taken for radians",
    "zero": "another zero of the position",
    "position_order": "positions in another order of joints",
    "torque_order": "torques in another order of joints",
    "joint_order": "joints in another order",
    "radians": "radians taken for degrees",
    "force_unit": "another unit of the plate's forces",
    "moment_unit": "another unit of the plate's moments",
    "plate_order": "the plate's columns in another order",
    "base_unit": "another unit of the base's position",
    "quaternion_order": "x, y, z, w of the base's quaternion taken for w, x, y, z",
}
"""By the kind of mistake."""

OF_PLATE = ("wrench_sense", "force_unit", "moment_unit", "plate_order")
"""Mistakes about plates."""

OF_BASE = ("base_unit", "quaternion_order")
"""Mistakes about a base that moves."""

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Units of a base's position [m]."""

OTHER_UNIT = {
    ("N", 1e-3): "kN",
    ("kN", 1e3): "N",
    ("N m", 1e3): "N mm",
    ("N m", 1e-3): "kN m",
    ("N mm", 1e-3): "N m",
    ("kN m", 1e3): "N m",
}
"""What a unit was taken for, and how many times too large its numbers came out."""


def mistake_finding(
    tree: Tree, mistake: Mistake, given: Reading, found: Reading, mapping: Mapping[str, Any]
) -> Finding:
    """A mistake as a person reads it.

    Args:
        tree: The robot.
        mistake: What is wrong.
        given: The data as they are.
        found: The data without their mistakes.
        mapping: What the recording's mapping file says; empty if it has none.
    """
    names = [tree.names[k] for k in mistake.joints]
    subject = f"joint '{names[0]}'" if len(names) == 1 else f"joints {few(names)}"
    if not names:
        subject = "the base" if mistake.kind in OF_BASE else "the plate"
    elif len(names) == len(own_joints(tree)) > 1:
        subject = "all joints"
    worst = int(np.argmax(given.fit.left - found.fit.left))
    before, after = float(given.fit.left[worst]), float(found.fit.left[worst])
    return Finding(
        subject,
        f"cannot be as recorded: whatever the masses, {min(before, 1):.0%} of a channel is "
        f"unexplained, {after:.0%} without the mistake",
        before,
        (WHAT[mistake.kind],),
        f"in the mapping: {_line(tree, mistake, mapping)}",
    )


def gain_finding(
    tree: Tree, sizes: Array, least: float, most: float, mapping: Mapping[str, Any]
) -> Finding:
    """Torques that are far from what masses of that order make.

    Args:
        tree: The robot.
        sizes: Times what the model file's masses say, (n,).
        least: Below this they are doubted.
        most: Above this.
        mapping: What the recording's mapping file says; empty if it has none.
    """
    told = [k for k in range(tree.n) if np.isfinite(sizes[k])]
    odd = [k for k in told if not least < sizes[k] < most]
    said = ", ".join(f"{tree.names[k]} {sizes[k]:.2g}" for k in odd[:6])
    needed = _numbers([1 / sizes[k] if k in told else 0.0 for k in range(tree.n)])
    small = all(sizes[k] < 1 for k in odd)
    causes = (
        ("torques on the motors' side of the gears", "currents taken for torques")
        if small
        else ("a unit such as N mm", "masses of another robot")
    )
    cure = (
        f'[torque] side = "motor" with a table [gear] (ratio about {needed}), or unit = "A" with '
        f"gain about {needed}"
        if small
        else f"[torque] unit{_smaller_unit(sizes[told], mapping)}"
    )
    return Finding(
        "the torque",
        f"is too {'small' if small else 'large'}: it is so many times what the model's masses "
        f"make: {said}",
        float(sizes[odd[0]]),
        causes,
        f"in the mapping: {cure}",
    )


def _smaller_unit(sizes: Array, mapping: Mapping[str, Any]) -> str:
    """The unit a thousand times smaller than the mapping's, where torques are so many too large."""
    smaller = {"N m": "N mm", "A": "mA", "V": "mV", "kN m": "N m"}
    unit = mapping.get("torque", {}).get("unit")
    thousand = 0.5 < np.median(sizes) / 1e3 < 2.0
    return f' = "{smaller[unit]}"' if thousand and unit in smaller else ""


def position_finding(tree: Tree, position: Array, outside: float) -> Iterator[Finding]:
    """Positions that no joint of this robot can have.

    Args:
        tree: The robot.
        position: (M, n) [rad or m].
        outside: Ranges by which they leave the joint's range.
    """
    said, turning = [], False
    for joint, q in zip(tree.joints, position.T, strict=True):
        low, high = joint.position_range
        room = outside * (high - low)
        if q.min() < low - room or q.max() > high + room:
            turning |= joint.revolute
            said.append(
                f"'{joint.name}' {q.min():.4g} to {q.max():.4g} (its range is {low:.4g} to "
                f"{high:.4g} {'rad' if joint.revolute else 'm'})"
            )
    if said:
        more = f" and {len(said) - 2} more" if len(said) > 2 else ""
        unit = "deg" if turning else "mm"
        yield Finding(
            "positions",
            f"are such as no joint has: {', '.join(said[:2])}{more}",
            float(len(said)),
            (f"positions in {unit}", "positions on the motors' side of the gears"),
            f'in the mapping: [position] unit = "{unit}", or side = "motor" and a table [gear]',
        )


def _line(tree: Tree, mistake: Mistake, mapping: Mapping[str, Any]) -> str:
    """What to write, in terms of what is written if that is known."""
    signal = "torque" if mistake.kind.startswith("torque") else "position"
    table = mapping.get(signal, {})
    if mistake.kind in OF_BASE:
        return _base_line(mistake, mapping.get("base", {}))
    if mistake.kind in OF_PLATE:
        plates = {f"plates.{name}": said for name, said in mapping.get("plates", {}).items()}
        tables = plates or {"wrench": mapping.get("wrench", {})}
        return "; ".join(_plate_line(mistake, name, said) for name, said in tables.items())
    if mistake.kind.endswith("sign"):
        keys = _keys(table)
        turned = "; ".join(_turned(tree, mistake, key, signal, mapping) for key in keys)
        rows = f"turn the signs of these joints' rows in the matrix of [{signal}]"
        return rows if "matrix" in table else turned
    if mistake.kind in ("degrees", "radians"):
        return f"[position] unit = {json.dumps(_angle_units(tree, mistake, table, mapping))}"
    if mistake.kind == "zero":
        offsets = _by_name(tree, table.get("offset"), mapping, 0.0)
        for joint, angle in zip(mistake.joints, mistake.angles, strict=True):
            offsets[joint] += angle
        return f"[position] offset = {_numbers(_by_mapping(tree, offsets, mapping))}"
    return _order_line(tree, mistake, mapping)


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


def _plate_line(mistake: Mistake, name: str, table: Mapping[str, Any]) -> str:
    """What to write of a plate's sense, units or columns in its table."""
    if mistake.kind == "wrench_sense":
        other = "on_plate" if table.get("sense") == "on_robot" else "on_robot"
        return f'[{name}] sense = "{other}"'
    if mistake.kind == "plate_order":
        columns = table.get("columns", AXES)
        if len(columns) != len(AXES):
            columns = AXES
        return f"[{name}] columns = {json.dumps([columns[k] for k in mistake.order])}"
    place = 0 if mistake.kind == "force_unit" else 1
    units = list(table.get("units", ("N", "N m")))
    units[place] = OTHER_UNIT.get((units[place], mistake.factor), f"{units[place]} of another size")
    times = f"{mistake.factor:g} times what they should be"
    return f"[{name}] units = {json.dumps(units)}: {('forces', 'moments')[place]} are {times}"


def _base_line(mistake: Mistake, table: Mapping[str, Any]) -> str:
    """What to write of the base's unit or quaternion."""
    if mistake.kind == "quaternion_order":
        columns = table.get("quaternion", ("x", "y", "z", "w"))
        return f"[base] quaternion = {json.dumps([columns[k] for k in mistake.order])}"
    wanted = LENGTHS.get(table.get("unit", "m"), 1.0) / mistake.factor
    other = [unit for unit, size in LENGTHS.items() if np.isclose(size, wanted)]
    times = f"positions are {mistake.factor:g} times what they should be"
    return f'[base] unit = "{other[0]}": {times}' if other else f"[base] unit: {times}"


def _keys(table: Mapping[str, Any]) -> tuple[str, ...]:
    """What turns with a signal's sign."""
    return ("sign", "offset") if any(table.get("offset", ())) else ("sign",)


def _turned(tree: Tree, mistake: Mistake, key: str, signal: str, mapping: Mapping[str, Any]) -> str:
    """A list of a signal's table with the signs of some joints turned."""
    default = 1.0 if key == "sign" else 0.0
    before = _by_name(tree, mapping.get(signal, {}).get(key), mapping, default)
    after = [-x if k in mistake.joints and x else x for k, x in enumerate(before)]
    return f"[{signal}] {key} = {_numbers(_by_mapping(tree, after, mapping))}"


def _order_line(tree: Tree, mistake: Mistake, mapping: Mapping[str, Any]) -> str:
    """Columns in their right order, if the mapping says which there are."""
    moved = {
        "torque_order": ("torque",),
        "position_order": ("position",),
        "joint_order": ("position", "torque"),
    }[mistake.kind]
    said = []
    for signal in moved:
        columns = mapping.get(signal, {}).get("columns", [])
        plain = "matrix" not in mapping.get(signal, {}) and len(columns) == tree.n
        if plain:
            found = _by_name(tree, columns, mapping, "")
            ordered = _by_mapping(tree, [found[k] for k in mistake.order], mapping)
            text = ", ".join(f'"{name}"' for name in ordered)
            said.append(f"[{signal}] columns = [{text}]")
        else:
            pairs = ", ".join(
                f"{tree.names[k]} is in the column of {tree.names[mistake.order[k]]}"
                for k in mistake.joints
            )
            said.append(f"[{signal}] columns: {pairs}")
    return "; ".join(said)


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


def position_offset(tree: Tree, mapping: Mapping[str, Any]) -> Array:
    """What a mapping has added to the positions, in the order of the tree's joints, (n,).

    Args:
        tree: The robot.
        mapping: What the recording's mapping file says; empty if it has none.
    """
    said = mapping.get("position", {}).get("offset")
    return np.array(_by_name(tree, said, mapping, 0.0), dtype=np.float64)


def _numbers(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{value:.5g}" for value in values) + "]"
