"""Hypotheses on errors of a mapping file, and the corrected lines of the file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.base.errors import round_significant, shortened_list
from testbed.core.recordings.columns import WRENCH_COMPONENTS
from testbed.core.robot import gravity
from testbed.core.robot.free_base import (
    N_BASE_COORDINATES,
    base_coordinates,
    base_poses,
)
from testbed.core.robot.rotations import matrix_to_rpy, rpy_to_matrix
from testbed.core.robot.tree import Tree
from testbed.importing.foreign_table import LENGTH_UNITS, unit_size
from testbed.importing.import_report import MappingLine
from testbed.importing.vocabulary import read_table


class HypothesisKind(NamedTuple):
    """Kind of hypothesis: description, table of the mapping, and penalty.

    Attributes:
        words: Description of the error.
        table: Table of the mapping that contains the error.
        penalty: Additional log-likelihood ratio that the hypothesis must gain [nats].
    """

    words: str
    table: Literal["position", "torque", "wrench", "base", ""]
    penalty: float = 0.0


HYPOTHESIS_KINDS = {
    name: HypothesisKind(**each) for name, each in read_table("hypotheses").items()
}
"""Kinds of hypotheses by name."""

USUAL_ZERO_OFFSETS = (np.pi / 2, -np.pi / 2, np.pi)
"""Usual differences between the zeros of model files and controllers [rad]."""

DEGREES_THRESHOLD = 2 * np.pi
"""Positions of a moving robot below this are not in degrees [rad]."""

RADIANS_THRESHOLD = np.deg2rad(2 * DEGREES_THRESHOLD)
"""Excursions below this may be radians taken for degrees [rad]."""

POSITION_FACTORS = {
    "position_sign": -1.0,
    "degrees": np.pi / 180,
    "radians": 180 / np.pi,
}
"""Factors on positions, by kind of hypothesis."""

FRAME_ANGLE_STEPS, ODD_ANGLE_PENALTY = (np.pi / 2, np.pi / 12), 2.0
"""Steps of usual angles between frames [rad]; penalty of a rotation that is no multiple of a step
[nats]."""

MAX_SEARCHED_JOINTS = 12
"""Largest number of joints for the search over orders and zeros, whose number grows fast."""


@dataclass(frozen=True)
class Hypothesis:
    """Hypothesis on an error of a mapping file, as a correction of the data.

    Attributes:
        kind: Kind of error, a key of `HYPOTHESIS_KINDS`.
        joints: Indices of the affected joints.
        values: Values of the correction, depending on the kind. Zeros: angles to be added, one per
            joint [rad]; orders: column index of each joint or channel; units: names; turn: roll,
            pitch and yaw of the frame [rad]; shift: origin of the frame [m]; late and delay: delay
            [s]; gravity: vector [m/s^2]; sizes and base unit: factors by which the numbers are too
            large.
    """

    kind: str
    joints: tuple[int, ...] = ()
    values: tuple[Any, ...] = ()

    @property
    def penalty(self) -> float:
        """Additional log-likelihood ratio that the hypothesis must gain [nats].

        Rotation: 2 for angles that are not multiples of 90 deg, 4 for angles that are not multiples
        of 15 deg. Zero: the penalty of its kind, once per joint, and once more for angles other
        than 90 or 180 deg.
        """
        # right angles are the most frequent, then multiples of 15 degrees
        if self.kind == "turn":
            angles = np.array(self.values)
            off_grid = [
                np.abs(angles - np.round(angles / step) * step).max() > 1e-4
                for step in FRAME_ANGLE_STEPS
            ]
            return float(ODD_ANGLE_PENALTY * sum(off_grid))
        times = 1
        if self.kind == "zero":
            times = len(self.joints) + (not set(self.values) <= set(USUAL_ZERO_OFFSETS))
        return HYPOTHESIS_KINDS[self.kind].penalty * times


def hypothesis_description(tree: Tree, hypothesis: Hypothesis) -> str:
    """Description of a hypothesis, with its joints and the changes of their zeros.

    Args:
        tree: Robot.
        hypothesis: Hypothesis on an error of the mapping.
    """
    words = HYPOTHESIS_KINDS[hypothesis.kind].words
    if len(hypothesis.joints) in (0, len(joints_without_free_base(tree))):
        return words
    names = shortened_list([tree.names[k] for k in hypothesis.joints])
    by = ", ".join(f"{np.rad2deg(angle):.0f}" for angle in hypothesis.values)
    return f"{words} ({names}{f' by {by} deg' if hypothesis.kind == 'zero' else ''})"


def joints_without_free_base(tree: Tree) -> range:
    """Indices of the robot's joints without the coordinates of a free base.

    Args:
        tree: Robot.
    """
    return range(N_BASE_COORDINATES if tree.floating else 0, tree.n)


def pair_exchanges(joints: range, count: int) -> Iterator[tuple[int, ...]]:
    """Yield all orders of joints or channels in which two are exchanged.

    Args:
        joints: Indices that may be exchanged.
        count: Number of joints or channels.
    """
    yield from (exchanged_order(*pair, count) for pair in combinations(joints, 2))


def exchanged_order(first: int, second: int, count: int) -> tuple[int, ...]:
    """Order of joints or channels in which two are exchanged.

    Args:
        first: Index of the first.
        second: Index of the second.
        count: Number of joints or channels.
    """
    order = [*range(count)]
    order[first], order[second] = second, first
    return tuple(order)


def candidate_orders(joints: range) -> Iterator[tuple[int, ...]]:
    """Yield orders with two joints exchanged, all joints rotated cyclically, or all reversed.

    Args:
        joints: Indices of the joints; joints with lower indices keep their position in the order.
    """
    yield from pair_exchanges(joints, joints.stop)
    base, rest = [*range(joints.start)], [*joints]
    if len(rest) > 2:
        for k in range(1, len(rest)):
            yield (*base, *rest[-k:], *rest[:-k])
        yield (*base, *rest[::-1])


def corrected_positions(
    hypothesis: Hypothesis, position: Array, offset: Array
) -> Array:
    """Positions corrected by a hypothesis, (M, n).

    Args:
        hypothesis: Hypothesis on the positions.
        position: Positions as recorded, (M, n) [rad or m].
        offset: Offsets that the mapping has added to the positions, (n,).

    Raises:
        RecordingError: The corrected orientation of the base is near the singularity of its angles.
    """
    kind, values, joints = hypothesis.kind, hypothesis.values, list(hypothesis.joints)
    if kind == "position_order":
        return position[:, list(values)]
    if kind == "quaternion_order":
        pose = base_poses(position[:, :N_BASE_COORDINATES])
        pose[:, 3:] = pose[:, 3:][:, list(values)]
        return np.hstack([base_coordinates(pose), position[:, N_BASE_COORDINATES:]])
    result = position.copy()
    result[:, joints] *= POSITION_FACTORS.get(kind, 1.0)
    if kind == "radians":
        result[:, joints] -= (POSITION_FACTORS[kind] - 1) * offset[joints]
    if kind == "zero":
        result[:, joints] += values
    if kind == "base_unit":
        result[:, :3] /= values[0]
    return result


def position_offset(tree: Tree, mapping: Mapping[str, Any]) -> Array:
    """Offsets that a mapping adds to the positions, in the order of the joints, (n,).

    Args:
        tree: Robot.
        mapping: Content of the recording's mapping file; empty if there is no mapping.
    """
    offsets = (mapping.get("position") or {}).get("offset") or ()
    by_name = dict(zip(mapping.get("joints", tree.names), offsets, strict=False))
    return np.array([by_name.get(name, 0.0) for name in tree.names])


def merge_hypotheses(hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Combine signs and zeros of several joints into one hypothesis per kind.

    Two reversals of a sign cancel; the reversal of a position reverses zeros applied before it.

    Args:
        hypotheses: Hypotheses in the order of application.
    """
    count = 1 + max((k for each in hypotheses for k in each.joints), default=0)
    signs = {"position_sign": np.ones(count), "torque_sign": np.ones(count)}
    zeros = np.zeros(count)
    merged = []
    for each in hypotheses:
        joints = list(each.joints)
        if each.kind in signs:
            signs[each.kind][joints] *= -1
            if each.kind == "position_sign":  # offsets added before change sign, too
                zeros[joints] *= -1
        elif each.kind == "zero":
            zeros[joints] += each.values
        else:
            merged.append(each)
    for kind, sign in signs.items():
        merged += joint_hypothesis(kind, sign < 0)
    return (*merged, *joint_hypothesis("zero", zeros != 0, zeros[zeros != 0]))


def joint_hypothesis(
    kind: str, mask: NDArray[np.bool_], values: AnyArray | None = None
) -> Iterator[Hypothesis]:
    """Yield the hypothesis of a given kind on selected joints; nothing if none is selected.

    Args:
        kind: Kind of hypothesis, a key of `HYPOTHESIS_KINDS`.
        mask: True for the selected joints, (n,).
        values: Values of the hypothesis; empty by default.
    """
    if mask.any():
        joints = np.flatnonzero(mask).tolist()
        yield Hypothesis(
            kind, tuple(joints), () if values is None else tuple(values.tolist())
        )


@dataclass(frozen=True)
class Remedy:
    """Correction of a mapping file, with its effect on the residuals.

    Attributes:
        kind: Kind of hypothesis, a key of `HYPOTHESIS_KINDS`.
        joints: Names of the affected joints; empty for plate or base.
        values: Values of the correction, as in `Hypothesis`.
        lines: Corrected lines of the mapping.
        channel: Channel with the largest improvement.
        before: Unexplained share of this channel's variance as recorded.
        after: Unexplained share with all remedies.
    """

    kind: str
    joints: tuple[str, ...]
    values: tuple[Any, ...]
    lines: tuple[MappingLine, ...]
    channel: str
    before: float
    after: float


def remedies_for(
    tree: Tree,
    hypotheses: Sequence[Hypothesis],
    before: Array,
    after: Array,
    mapping: Mapping[str, Any],
    torque_count: int,
) -> Iterator[Remedy]:
    """Yield the corrections of a mapping for given hypotheses.

    Args:
        tree: Robot.
        hypotheses: Hypotheses in the order of application.
        before: Unexplained share of each of the C channels' variance as recorded, (C,).
        after: Unexplained share under the hypotheses, (C,).
        mapping: Content of the recording's mapping file; empty if there is no mapping.
        torque_count: Number of torque channels, which come first.
    """
    channels = [
        *(f"the torque of '{name}'" for name in tree.names[:torque_count]),
        *WRENCH_COMPONENTS,
    ]
    for each in hypotheses:
        lines = tuple(_corrected_lines(tree, each, mapping))
        mapping = mapping_with_lines(mapping, lines)  # the next lines build on these
        all_channels = range(len(before))
        table = HYPOTHESIS_KINDS[each.kind].table
        candidates: Sequence[int] = (
            all_channels[torque_count:] if table == "wrench" else all_channels
        )
        if table == "torque" and each.joints:
            candidates = each.joints
        best = max(candidates, key=lambda k: before[k] - after[k])
        joints = tuple(tree.names[k] for k in each.joints)
        shares = float(before[best]), float(after[best])
        yield Remedy(each.kind, joints, each.values, lines, channels[best], *shares)


def mapping_with_lines(
    mapping: Mapping[str, Any], lines: Iterable[MappingLine]
) -> dict[str, Any]:
    """Mapping with some values replaced.

    Args:
        mapping: Content of a mapping file, as stored in a recording.
        lines: Corrected lines: table, key, value.
    """
    edited = {**mapping}
    for table, key, value in lines:
        target = edited
        for part in table.split(".") if table else ():
            target[part] = {**(target.get(part) or {})}
            target = target[part]
        target[key] = value
    return edited


def _corrected_lines(
    tree: Tree, hypothesis: Hypothesis, mapping: Mapping[str, Any]
) -> Iterator[MappingLine]:
    """Yield the lines of a mapping that apply a hypothesis, combined with the current values."""
    table_name = HYPOTHESIS_KINDS[hypothesis.kind].table
    if hypothesis.kind == "spring":
        return  # no line of a mapping corrects a spring
    if hypothesis.kind == "gravity":
        yield "", "gravity", gravity.mounting_name(hypothesis.values)
        return
    for name, table in signal_tables(mapping, table_name).items():
        if table_name == "wrench":
            pairs = [
                _plate_line(hypothesis, table, alone=not name.startswith("plates."))
            ]
        elif table_name == "base":
            pairs = [_base_line(hypothesis, table)]
        else:
            order = [
                tree.names.index(joint) for joint in mapping.get("joints", tree.names)
            ]
            pairs = [*_joint_lines(tree, hypothesis, table, order)]
        yield from ((name, *pair) for pair in pairs)


def signal_tables(
    mapping: Mapping[str, Any], signal: str
) -> dict[str, Mapping[str, Any]]:
    """Tables of a mapping that define a signal; several for a wrench of several plates.

    Args:
        mapping: Content of a mapping file, as stored in a recording.
        signal: Name of the signal; the table of this name may be empty.
    """
    signal_table = mapping.get(signal) or {}
    for group in ("plates", "sensors"):
        if signal == "wrench" and mapping.get(group) and not signal_table:
            return {f"{group}.{name}": table for name, table in mapping[group].items()}
    return {signal: signal_table}


def sensor_placement(table: Mapping[str, Any]) -> tuple[Sequence[float], Array]:
    """Roll, pitch, yaw [rad] and origin, (3,) [m], of a plate in the bedplate frame.

    Args:
        table: Table of the plate in a mapping; without a key `place`, all values are zero.
    """
    place = table.get("place") or {"xyz": [0.0] * 3, "rpy": [0.0] * 3}
    return place["rpy"], np.array(place["xyz"], float)


def _plate_line(
    hypothesis: Hypothesis, table: Mapping[str, Any], *, alone: bool
) -> tuple[str, Any]:
    """Key and value of a plate's table that apply a hypothesis.

    Args:
        hypothesis: Hypothesis on the plate.
        table: Table of the plate in the mapping.
        alone: False for one of several plates, which are moved together.
    """
    kind, values = hypothesis.kind, hypothesis.values
    if kind == "sense":
        return "sense", "on_plate" if table.get("sense") != "on_plate" else "on_robot"
    if kind == "plate_order":
        columns = table.get("columns", WRENCH_COMPONENTS)
        columns = (
            columns if len(columns) == len(WRENCH_COMPONENTS) else WRENCH_COMPONENTS
        )
        return "columns", [columns[k] for k in values]
    if kind == "late":
        return "delay", round(float(table.get("delay", 0.0)) + values[0], 4)
    if kind in ("units", "tare"):
        return kind, list(values)
    rpy, xyz = sensor_placement(table)
    if kind == "turn":
        turn = rpy_to_matrix(values)
        rpy = values if alone else matrix_to_rpy(turn @ rpy_to_matrix(rpy))
        xyz = xyz if alone else turn @ xyz
    else:
        xyz = np.array(values) if alone else xyz + values
    return "place", {
        "xyz": np.round(xyz, 4).tolist(),
        "rpy": [round(a, 5) + 0.0 for a in rpy],
    }


def _base_line(hypothesis: Hypothesis, table: Mapping[str, Any]) -> tuple[str, Any]:
    """Key and value of the base's table that apply a hypothesis."""
    if hypothesis.kind == "quaternion_order":
        columns = table.get("quaternion", ("x", "y", "z", "w"))
        return "quaternion", [columns[k] for k in hypothesis.values]
    length = unit_size("position", table.get("unit", "m")) / hypothesis.values[0]
    units = (unit for unit, size in LENGTH_UNITS.items() if np.isclose(size, length))
    return "unit", next(units, f"one of {length:g} m")


def _joint_lines(
    tree: Tree, hypothesis: Hypothesis, table: Mapping[str, Any], order: Sequence[int]
) -> Iterator[tuple[str, Any]]:
    """Yield keys and values of the table of positions or torques that apply a hypothesis.

    Lists of the table are in the mapping's order of joints; `order` has the robot's indices of
    these.
    """
    kind, matrix, offset = (
        hypothesis.kind,
        table.get("matrix"),
        table.get("offset") or (),
    )
    affected = [k in hypothesis.joints for k in order]
    if kind == "gravity_removed":
        yield "gravity", "removed"
    elif kind == "delay":
        delay = float(table.get("delay", 0.0)) + hypothesis.values[0]
        yield "delay", round(delay, 5)
    elif kind.endswith("sign"):
        factors = np.where(affected, -1, 1)
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
    """Units of positions, with the unit of revolute joints corrected."""
    angle_unit = "deg" if kind == "degrees" else "rad"
    present_units = unit if isinstance(unit, list) else ["m"] * len(order)
    pairs = zip(order, present_units, strict=True)
    units = [angle_unit if tree.joints[k].revolute else each for k, each in pairs]
    return angle_unit if {*units} == {angle_unit} else units
