"""A table of poses at rest: a row a pose, its heading read as that of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import RecordingError, UnknownName, few
from testbed.core.recordings.columns import AXES
from testbed.core.robot.tree import Tree
from testbed.importing.column_names import read_name
from testbed.importing.foreign_table import (
    ANGLES,
    FORCES,
    LENGTHS,
    MOMENTS,
    ForeignTable,
)
from testbed.importing.likely_clock import clock_of
from testbed.importing.likely_signals import (
    BY_SIZE,
    LikelySignal,
    LikelySource,
    likely_plates,
    likely_signals,
)
from testbed.importing.readers import open_foreign

LEAST = 4
"""Poses that leave more numbers than unknowns, in forces and in moments."""


def read_static_poses(
    path: Path, tree: Tree, *, degrees: bool = False
) -> tuple[Array, Array, tuple[Diagnostic, ...]]:
    """Joint positions, (P, n) [rad or m], wrenches, (P, 6) [N, N m], and what was repaired.

    Args:
        path: Of any format that is imported.
        tree: Its joints have a column each.
        degrees: Whether angles without a unit are in degrees.

    Raises:
        RecordingError: It is no such table.
        UnknownName: A heading has a unit of something else.
    """
    table = open_foreign(path)
    source = _source(path, table)
    signal = likely_signals([source], tree.names).get("position")
    wrench = next((each for _, _, each in likely_plates([source], {})), [])
    if (
        signal is None
        or set(tree.names) - set(signal.group.names)
        or len(wrench) < len(AXES)
    ):
        raise RecordingError(
            f"'{path}' has no columns of numbers for {few([*tree.names, *AXES], 90)}: a row has "
            f"the joints' positions and the wrench; found {few(table.columns, 90)}"
        )
    asked = [*_positions(tree, signal, degrees=degrees)]
    asked += [(each.name, each.unit or "N", FORCES) for each in wrench[:3]]
    asked += [(each.name, each.unit or "N m", MOMENTS) for each in wrench[3:]]
    rows = np.column_stack([_values(table, *each) for each in asked])
    whole = rows[np.isfinite(rows).all(axis=1)]
    if len(whole) < LEAST:
        raise RecordingError(
            f"'{path}' holds {len(whole)} whole rows of numbers, a row a pose; {LEAST} poses are "
            "the least, a dozen are better"
        )
    lost = len(rows) - len(whole) + table.cut
    repairs = [diagnose("tool.rows", value=lost)] * (lost > 0)
    repairs += [diagnose("tool.by-size")] * (signal.because == BY_SIZE)
    return whole[:, : tree.n], whole[:, tree.n :], tuple(repairs)


def _source(path: Path, table: ForeignTable) -> LikelySource:
    """Columns of a table but its times; those without a name of a signal may be positions."""
    clock = clock_of(table)
    names = [
        read_name(each, table.unit(each))
        for each in table.columns
        if each != clock.column
    ]
    columns = [
        replace(x, kind="position") if x.kind is x.unit is None else x for x in names
    ]
    return LikelySource("poses", path, None, table, tuple(columns), clock)


def _values(
    table: ForeignTable, name: str, unit: str, units: Mapping[str, float]
) -> Array:
    """A column in SI, (P,)."""
    if unit not in units:
        raise UnknownName(f"unit of column '{name}'", unit, units)
    return table.read([name])[name] * units[unit]


def _positions(
    tree: Tree, signal: LikelySignal, *, degrees: bool
) -> Iterator[tuple[str, str, Mapping[str, float]]]:
    """Column, unit and known units of each joint's position."""
    for joint in tree.joints:
        k = signal.group.names.index(joint.name)
        usual, units = (
            ("deg" if degrees else "rad", ANGLES) if joint.revolute else ("m", LENGTHS)
        )
        yield signal.group.columns[k].name, signal.units[k] or usual, units
