"""Static poses from a table of any supported format, with one row for each pose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import RecordingError, UnknownName, shortened_list
from testbed.core.recordings.columns import WRENCH_COMPONENTS
from testbed.core.robot.tree import Tree
from testbed.importing.column_names import parse_column_name
from testbed.importing.foreign_table import (
    ANGLE_UNITS,
    FORCE_UNITS,
    LENGTH_UNITS,
    MOMENT_UNITS,
    ForeignTable,
)
from testbed.importing.likely_clock import find_clock
from testbed.importing.likely_signals import (
    SIZE_EVIDENCE,
    LikelySignal,
    find_plates,
    find_signals,
)
from testbed.importing.likely_sources import LikelySource
from testbed.importing.readers import open_foreign_table

MIN_ROWS = 4
"""Smallest number of poses, with more measurements than unknowns in forces and in moments."""


def read_static_poses(
    path: Path, tree: Tree, *, degrees: bool = False
) -> tuple[Array, Array, tuple[Diagnostic, ...]]:
    """Read joint positions, (P, n) [rad or m], and wrenches, (P, 6) [N, N m], of static poses.

    P is the number of poses. Wrenches are in the frame and sense of the file, force before moment.

    Args:
        path: File of any supported format.
        tree: Robot; the file has a column for each joint.
        degrees: True if angles without a unit are in degrees.

    Returns:
        Joint positions, wrenches, and diagnostics of omitted rows and assumed units.

    Raises:
        RecordingError: Columns are missing, or there are fewer than `MIN_ROWS` complete rows.
        UnknownName: A column has a unit of another quantity.
    """
    table = open_foreign_table(path)
    source = _pose_source(path, table)
    signal = find_signals([source], tree.names).get("position")
    wrench = next((each for _, _, each in find_plates([source], {})), [])
    if (
        signal is None
        or set(tree.names) - set(signal.group.names)
        or len(wrench) < len(WRENCH_COMPONENTS)
    ):
        raise RecordingError(
            f"'{path}' has no columns of numbers for "
            f"{shortened_list([*tree.names, *WRENCH_COMPONENTS], 90)}: a row has "
            f"the joints' positions and the wrench; found {shortened_list(table.columns, 90)}"
        )
    columns = [*_position_columns(tree, signal, degrees=degrees)]
    columns += [(each.name, each.unit or "N", FORCE_UNITS) for each in wrench[:3]]
    columns += [(each.name, each.unit or "N m", MOMENT_UNITS) for each in wrench[3:]]
    values = np.column_stack([_column_in_si(table, *each) for each in columns])
    rows = values[np.isfinite(values).all(axis=1)]
    if len(rows) < MIN_ROWS:
        raise RecordingError(
            f"'{path}' holds {len(rows)} whole rows of numbers, a row a pose; {MIN_ROWS} poses are "
            "the least, a dozen are better"
        )
    omitted = len(values) - len(rows) + table.is_incomplete
    repairs = [make_diagnostic("tool.rows", value=omitted)] * (omitted > 0)
    repairs += [make_diagnostic("tool.by-size")] * (
        signal.unit_evidence == SIZE_EVIDENCE
    )
    return rows[:, : tree.n], rows[:, tree.n :], tuple(repairs)


def _pose_source(path: Path, table: ForeignTable) -> LikelySource:
    """Source of a table, without the time column.

    Columns whose names state neither a signal nor a unit are taken as positions.
    """
    clock = find_clock(table)
    names = [
        parse_column_name(each, table.unit(each))
        for each in table.columns
        if each != clock.column
    ]
    columns = [
        replace(name, kind="position") if name.kind is name.unit is None else name
        for name in names
    ]
    return LikelySource("poses", path, None, table, tuple(columns), clock)


def _column_in_si(
    table: ForeignTable, name: str, unit: str, units: Mapping[str, float]
) -> Array:
    """Column of a table in SI units, (P,), where P is the number of poses.

    Args:
        table: Table of poses.
        name: Column name.
        unit: Unit of the column.
        units: Sizes of the known units in SI, keyed by unit.

    Raises:
        UnknownName: The unit is not known.
    """
    if unit not in units:
        raise UnknownName(f"unit of column '{name}'", unit, units)
    return table.column_values([name])[name] * units[unit]


def _position_columns(
    tree: Tree, signal: LikelySignal, *, degrees: bool
) -> Iterator[tuple[str, str, Mapping[str, float]]]:
    """Yield column name, unit, and SI sizes of the known units for each joint's position.

    An angle without a unit is in rad, or in degrees if `degrees` is True; a length without a unit
    is in m.
    """
    for joint in tree.joints:
        k = signal.group.names.index(joint.name)
        default, units = (
            ("deg" if degrees else "rad", ANGLE_UNITS)
            if joint.revolute
            else ("m", LENGTH_UNITS)
        )
        yield signal.group.columns[k].name, signal.units[k] or default, units
