"""Likely signals of joints and force plates among the columns of foreign files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from testbed.core.base.arrays import Array
from testbed.importing.column_names import (
    ColumnGroup,
    ColumnName,
    as_joint_torque,
    column_groups,
    is_tool_wrench,
    likeliest_group,
    plate_columns,
)
from testbed.importing.derivative import (
    MIN_EXPLAINED_VARIANCE,
    DerivativeRegression,
    regress_on_integrals,
    unit_of_size,
)
from testbed.importing.foreign_table import (
    JOINT_QUANTITIES,
    UNITS_BY_QUANTITY,
    JointQuantity,
)
from testbed.importing.known_layouts import layout_of_logger
from testbed.importing.likely_clock import find_clock
from testbed.importing.likely_sources import LikelySource
from testbed.importing.signal_maps import detected_sign_bit

SIZE_EVIDENCE = "by their size"
"""Evidence for a unit by the size of the values, as text in a mapping file."""
DEGREE_RANGE = (4 * np.pi, 720.0)
"""Range of the largest position that is taken as degrees, not radians."""

PER_CENT_RANGE = (99.0, 100.5)
"""Range of the largest position taken as per cent of a calibrated range (LeRobot, SO arms)."""

COUNTS_PER_TURN, MIN_COUNTS = 4096, 1000
"""Counts in a turn of servos (Dynamixel's X, Feetech's STS); lower bound of the largest count."""

VELOCITY_EVIDENCE = "by velocity and position"
"""Evidence for a unit or sign by velocities and positions, as text in a mapping file."""


@dataclass(frozen=True, eq=False)
class LikelySignal:
    """Likely columns of a signal of the joints.

    Attributes:
        source: Source of the columns.
        group: Columns.
        other_columns: Names of other columns that resemble the signal.
        units: Unit of each column; None if unknown.
        sign: Sign of each column, 1 or -1; empty if all are positive.
        unit_evidence: Evidence for the units, if the column names do not state them.
        counts_per_turn: Counts per turn if the columns are integers of a servo; otherwise 0.
        column_evidence: Evidence that the columns are the signal, if their names do not state it.
        sign_bit: Smallest value with the sign bit set; 0 if there is no sign bit.
    """

    source: LikelySource
    group: ColumnGroup
    other_columns: tuple[str, ...]
    units: tuple[str | None, ...]
    sign: tuple[int, ...] = ()
    unit_evidence: str = ""
    counts_per_turn: int = 0
    column_evidence: str = ""
    sign_bit: int = 0


_UnitPair = tuple[str | None, str | None]
"""Units of position and velocity; None if unknown."""


def _signals_with_source(
    signals: Mapping[JointQuantity, LikelySignal],
    before: LikelySource,
    after: LikelySource,
) -> Mapping[JointQuantity, LikelySignal]:
    """Signals with one source replaced by another."""
    return {
        kind: replace(each, source=after) if each.source is before else each
        for kind, each in signals.items()
    }


def find_signals(
    sources: Sequence[LikelySource], joints: Sequence[str]
) -> Mapping[JointQuantity, LikelySignal]:
    """Columns that most likely belong to the joints, keyed by signal.

    Columns are chosen by their names (`likeliest_group`), or else by their values: velocities are
    the derivatives of positions, and torques are the only remaining columns. Signs, and units that
    names do not state, follow from the values.

    Args:
        sources: Sources whose columns are searched.
        joints: Joint names of the robot's model, in its order; empty if unknown.
    """
    signals: dict[JointQuantity, LikelySignal] = {}
    count = len(joints) or None
    for kind in JOINT_QUANTITIES:
        groups = [
            (group, source)
            for source in sources
            for group in column_groups(
                [
                    c
                    for c in source.columns
                    if _has_kind(as_joint_torque(c, joints), kind)
                ],
                joints,
            )
        ]
        best = likeliest_group([group for group, _ in groups], count)
        if best is None:
            continue
        source = next(source for group, source in groups if group is best)
        signals[kind] = _signal(source, best, joints, signals)
        count = count or len(best.columns)
    for kind, source, group, evidence in _signals_without_names(
        signals, sources, joints
    ):
        signals[kind] = replace(
            _signal(source, group, joints, signals), column_evidence=evidence
        )
    return _with_derivative_units(
        _with_position_units_by_size(
            _with_raw_loads(_with_clock_of_position_rows(signals))
        )
    )


def _with_clock_of_position_rows(
    signals: Mapping[JointQuantity, LikelySignal],
) -> Mapping[JointQuantity, LikelySignal]:
    """Signals with a clock found from only the rows that contain positions."""
    if (q := signals.get("position")) is None:
        return signals
    finite = np.isfinite(signal_values(q))
    rows = np.asarray(finite.all(axis=1))
    if not rows.any():  # rows of several devices
        rows = finite[:, int(finite.sum(axis=0).argmax())]
    if rows.all():
        return signals
    table = q.source.table
    source = replace(
        q.source, clock=find_clock(table, layout_of_logger(table.columns), rows)
    )
    return _signals_with_source(signals, q.source, source)


def _with_raw_loads(
    signals: Mapping[JointQuantity, LikelySignal],
) -> Mapping[JointQuantity, LikelySignal]:
    """Signals with unit "raw" for torques that are whole numbers without a unit.

    `detected_sign_bit` determines their sign bit.
    """
    if (tau := signals.get("torque")) is None or any(tau.units):
        return signals
    values = signal_values(tau)
    values = values[np.isfinite(values).all(axis=1)]
    if (values != np.round(values)).any() or not values.any():
        return signals
    units = ("raw",) * len(tau.units)
    tau = replace(
        tau,
        units=units,
        unit_evidence="whole numbers",
        sign_bit=detected_sign_bit(values),
    )
    return {**signals, "torque": tau}


def _signal(
    source: LikelySource,
    group: ColumnGroup,
    joints: Sequence[str],
    signals: Mapping[JointQuantity, LikelySignal],
) -> LikelySignal:
    """Signal of a group of columns, ordered as the model's joints or the first signal."""
    group = group.with_model_joints(joints)
    group = (
        group.reordered_as(next(iter(signals.values())).group.names)
        if signals
        else group
    )
    kind, used = group.columns[0].kind, set(group.columns)
    others = [
        c.name for c in source.columns if kind and _has_kind(c, kind) and c not in used
    ]
    return LikelySignal(
        source, group, tuple(others), tuple(c.unit for c in group.columns)
    )


def _signals_without_names(
    signals: Mapping[JointQuantity, LikelySignal],
    sources: Sequence[LikelySource],
    joints: Sequence[str],
) -> Iterator[tuple[JointQuantity, LikelySource, ColumnGroup, str]]:
    """Yield signals that names do not state: velocities by integration, torques by elimination.

    Candidates are groups with a column for each joint, either without a named signal or named as
    forces without an axis. A pair that passes `_is_derivative` is position and velocity; if a
    single other group remains, it is the torque.
    """
    known = next(iter(signals.values()), None)
    count = len(known.group.columns) if known else len(joints)
    for source in sources:
        unnamed = [c for c in source.columns if c.kind is None and not c.is_excluded]
        loads = [
            c
            for c in source.columns
            if c.kind == "wrench" and c.wrench_component is None
        ]
        groups = {
            group.columns: group
            for columns in (unnamed, loads)
            for group in column_groups(columns, joints)
            if len(group.columns) == count > 0
        }
        by_kind = {
            k: each.group for k, each in signals.items() if each.source is source
        }
        kinds: tuple[JointQuantity, JointQuantity] = ("position", "velocity")
        options = ([by_kind[k]] if k in by_kind else [*groups.values()] for k in kinds)
        pairs = [
            (position, velocity)
            for position, velocity in product(*options)
            if position is not velocity and _is_derivative(source, position, velocity)
        ]
        for kind, group in zip(kinds, pairs[0] if pairs else (), strict=False):
            if kind not in by_kind:
                yield kind, source, group, VELOCITY_EVIDENCE
            groups.pop(group.columns, None)
        if (
            "torque" not in signals
            and len(groups) == 1
            and (pairs or "position" in by_kind)
        ):
            (torque,) = groups.values()
            yield (
                "torque",
                source,
                torque,
                "ASSUMED: no other columns are left, joint by joint",
            )


def _velocity_fit(
    source: LikelySource, position: ColumnGroup, velocity: ColumnGroup
) -> DerivativeRegression:
    """Regress increments of positions on integrals of velocities.

    All values are zero if the shapes differ.
    """
    values, rates = (source.group_values(group) for group in (position, velocity))
    time = source.clock.time(source.table, len(values))
    same_shape = values.shape == rates.shape and len(values) == len(time)
    return (
        regress_on_integrals(values, rates, time)
        if same_shape
        else DerivativeRegression(*np.zeros((2, 1, 1)))
    )


def _is_derivative(
    source: LikelySource, position: ColumnGroup, velocity: ColumnGroup
) -> bool:
    """Test whether velocity columns are derivatives of position columns.

    The explained variance must exceed 0.9 for half of the joints or more.
    """
    explained = (
        np.diagonal(_velocity_fit(source, position, velocity).explained_variance)
        > MIN_EXPLAINED_VARIANCE
    )
    return bool(2 * explained.sum() >= len(explained))


def _has_kind(column: ColumnName, kind: str) -> bool:
    """Test whether a column is a measured signal of a given kind."""
    return column.kind == kind and not column.is_excluded


def _velocity_slopes(signals: Mapping[JointQuantity, LikelySignal]) -> Array | None:
    """Slopes of position increments as a function of velocity integrals, (n,), in the file's units.

    Slopes with an explained variance of at most 0.9 are nan. The result is None if all slopes are
    nan, or if position or velocity is missing.
    """
    q, v = signals.get("position"), signals.get("velocity")
    if q is None or v is None or q.source is not v.source or q.counts_per_turn:
        return None
    fit = _velocity_fit(q.source, q.group, v.group)
    valid = np.diagonal(fit.explained_variance) > MIN_EXPLAINED_VARIANCE
    return np.where(valid, np.diagonal(fit.slope), np.nan) if valid.any() else None


def _with_derivative_units(
    signals: Mapping[JointQuantity, LikelySignal],
) -> Mapping[JointQuantity, LikelySignal]:
    """Signals with signs, units and clock from a regression of positions on velocity integrals.

    Negative slopes determine the signs of velocities. The size of the slopes determines the clock's
    unit or rate if it is unknown, and otherwise missing units of positions and velocities.
    """
    slope = _velocity_slopes(signals)
    if slope is None:
        return signals
    q, v = signals["position"], signals["velocity"]
    if np.nanmin(slope) < 0:
        v = replace(v, sign=tuple(-1 if each < 0 else 1 for each in slope))
    clock, units, ratios = (
        q.source.clock,
        [*zip(q.units, v.units, strict=True)],
        np.abs(slope),
    )
    if clock.seconds_per_unit is None:
        sizes = [
            ratio * UNITS_BY_QUANTITY["position"][a] / UNITS_BY_QUANTITY["velocity"][b]
            for (a, b), ratio in zip(units, ratios, strict=True)
            if a in UNITS_BY_QUANTITY["position"]
            and b in UNITS_BY_QUANTITY["velocity"]
            and np.isfinite(ratio)
        ]
        clock = clock.with_unit_by_velocity(float(np.median(sizes))) if sizes else clock
    else:
        ratios[np.isnan(ratios)] = np.nanmedian(ratios)  # joints at rest
        pairs = zip(units, ratios / clock.seconds_per_unit, strict=True)
        units = [_unit_pair(a, b, float(ratio)) for (a, b), ratio in pairs]
    position_units, velocity_units = ([pair[k] for pair in units] for k in (0, 1))
    changed = {
        **signals,
        "position": _with_units(q, position_units),
        "velocity": _with_units(v, velocity_units),
    }
    return _signals_with_source(changed, q.source, replace(q.source, clock=clock))


def _unit_pair(position: str | None, velocity: str | None, ratio: float) -> _UnitPair:
    """Units of position and velocity from the slope of their regression.

    The ratio is the slope of position increments as a function of velocity integrals, in the units
    of the file. If both units are unknown, only deg with rad/s is recognised.
    """
    if position in UNITS_BY_QUANTITY["position"] and velocity is None:
        return position, unit_of_size(
            "velocity", ratio * UNITS_BY_QUANTITY["position"][position]
        )
    if velocity in UNITS_BY_QUANTITY["velocity"] and position is None:
        return unit_of_size(
            "position", UNITS_BY_QUANTITY["velocity"][velocity] / ratio
        ), velocity
    if (
        position is None
        and velocity is None
        and unit_of_size("position", 1 / ratio) == "deg"
    ):
        return "deg", "rad/s"
    return position, velocity


def _with_units(signal: LikelySignal, units: Sequence[str | None]) -> LikelySignal:
    """Signal with other units, and the evidence for a change."""
    unchanged = tuple(units) == signal.units
    return (
        signal
        if unchanged
        else replace(signal, units=tuple(units), unit_evidence=VELOCITY_EVIDENCE)
    )


def _with_position_units_by_size(
    signals: Mapping[JointQuantity, LikelySignal],
) -> Mapping[JointQuantity, LikelySignal]:
    """Signals with the position unit deduced from the values: degrees, or counts of a servo.

    Non-negative whole numbers with a maximum of 1000 to 4095 are counts. Values with a maximum
    between 4 pi and 720, but not near 100 (per cent), are in degrees. Units stated by names are
    kept, unless positions of a known logger exceed 4 pi.
    """
    if (q := signals.get("position")) is None:
        return signals
    values = signal_values(q)
    values = values[np.isfinite(values)]
    largest, whole = (
        float(np.nanmax(np.abs(values))),
        bool((values == np.round(values)).all()),
    )
    if any(q.units) and not (q.source.logger and largest > DEGREE_RANGE[0]):
        return signals  # loggers can be set to degrees
    if whole and MIN_COUNTS <= largest < COUNTS_PER_TURN and values.min() >= 0:
        q = replace(
            q,
            units=("turn",) * len(q.units),
            unit_evidence=SIZE_EVIDENCE,
            counts_per_turn=COUNTS_PER_TURN,
        )
    elif (
        DEGREE_RANGE[0] < largest <= DEGREE_RANGE[1]
        and not PER_CENT_RANGE[0] <= largest <= PER_CENT_RANGE[1]
    ):
        q = replace(q, units=("deg",) * len(q.units), unit_evidence=SIZE_EVIDENCE)
        v = signals.get("velocity")
        if v is not None and v.source.logger:
            signals = {**signals, "velocity": replace(v, units=(None,) * len(v.units))}
    return {**signals, "position": q}


def signal_values(signal: LikelySignal) -> Array:
    """Values of a signal's columns in the units of the file, (M, n)."""
    return signal.source.group_values(signal.group)


def find_plates(
    sources: Sequence[LikelySource], signals: Mapping[JointQuantity, LikelySignal]
) -> list[tuple[str, LikelySource, list[ColumnName]]]:
    """Columns of the force plates, preferably of plates with six columns.

    Plates that a file describes are preferred, then all plates with six columns that are not
    sensors at the tool. If there are none, the first sensor with six columns is taken or, if there
    are no torques, the first plate with any number of columns.

    Args:
        sources: Sources whose columns are searched.
        signals: Signals of the joints, whose columns are excluded.

    Returns:
        Words that distinguish the plate, source and columns, for each plate.
    """
    if plates := [each for source in sources for each in _stated_plates(source)]:
        return plates
    plates = []
    used = {column.name for each in signals.values() for column in each.group.columns}
    for source in sources:
        columns = [
            c for c in source.columns if _has_kind(c, "wrench") and c.name not in used
        ]
        at_plate = [c for c in columns if not is_tool_wrench(c)]
        if columns:
            plates += [
                (n, source, each)
                for n, each in plate_columns(at_plate or columns).items()
            ]
    complete = [each for each in plates if len(each[2]) == 6]
    complete_at_plate = [each for each in complete if not is_tool_wrench(each[2][0])]
    return complete_at_plate or (complete if "torque" in signals else plates)[:1]


MIN_LOAD_SHARE = 0.02
"""Range of force, relative to the plate with the largest range, below which a plate is unloaded."""


def _stated_plates(
    source: LikelySource,
) -> Iterator[tuple[str, LikelySource, list[ColumnName]]]:
    """Yield plates that the file describes, without unloaded plates.

    A plate is unloaded if the range of its forces is less than 2 % of the largest range of a plate.
    """
    table, by_name = source.table, {each.name: each for each in source.columns}
    plates = [each for each in table.plates if by_name.keys() >= set(each.columns)]
    spans = [
        float(np.ptp([*table.column_values(each.columns[:3]).values()]))
        for each in plates
    ]
    for plate, span in zip(plates, spans, strict=True):
        if span >= MIN_LOAD_SHARE * max(spans):
            yield plate.name, source, [by_name[name] for name in plate.columns]
