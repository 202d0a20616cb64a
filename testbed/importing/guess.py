"""Draft of a mapping file from foreign files, with empty values for unknown keys."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import (
    RecordingError,
    count_with_noun,
    printable_line,
    shortened_list,
)
from testbed.importing.column_names import (
    TEMPERATURE_WORDS,
    ColumnName,
    column_groups,
    is_tool_wrench,
)
from testbed.importing.foreign_table import (
    RAW_UNITS,
    UNITS_BY_QUANTITY,
    DescribedPlate,
    ForeignTable,
    JointQuantity,
    canonical_unit,
)
from testbed.importing.import_report import MappingDraft
from testbed.importing.likely_signals import (
    PER_CENT_RANGE,
    VELOCITY_EVIDENCE,
    LikelySignal,
    find_plates,
    find_signals,
    signal_values,
)
from testbed.importing.likely_sources import LikelySource, find_sources

MAX_LISTED_COLUMNS = 100
"""Largest number of columns of a source that are listed."""

AnnotatedKey = tuple[str, Any, str]
"""Key of a mapping file, value, and comment beside it."""


def guess_mapping(
    paths: Sequence[Path],
    folder: Path,
    joints: Sequence[str] = (),
    subsets: Iterable[Sequence[str]] = (),
) -> MappingDraft:
    """Draft of a mapping file from names, units and values of foreign columns.

    Keys that these do not determine get empty values, which `read_mapping` refuses.

    Args:
        paths: Files of other programs.
        folder: Folder for the mapping file; file names are relative to it.
        joints: Joint names of the robot's model, in its order; empty if unknown.
        subsets: Subsets of the joints, tried in this order if the columns do not fit all joints.

    Raises:
        RecordingError: A file cannot be read, or no file contains numeric columns.
        UnknownName: A file has an unknown extension.
    """
    sources = find_sources(paths)
    if not sources:
        file_list = ", ".join(f"'{path}'" for path in paths)
        raise RecordingError(f"no columns of numbers in {file_list}")
    signals, joints = _matched_signals(sources, joints, subsets)
    by_name = {each.source.name: each.source for each in signals.values()}
    sources = [by_name.get(each.name, each) for each in sources]
    signals = {**signals, **_temperature_signal(sources, joints, signals)}
    files = ", ".join(printable_line(path.name, 100) for path in paths)
    draft = MappingDraft().with_comment_lines(
        "",
        f"# What {files} {'holds' if len(paths) == 1 else 'hold'}, made into a recording by",
        "#   testbed import THIS.toml --out recording.parquet --model ROBOT",
        "# once nothing is empty or 0. See docs/your-recording.md.",
        "",
    )
    rate = _recording_rate(sources, signals)
    reason = "" if rate else f": unknown, {sources[0].clock.rate_evidence}"
    draft = draft.with_key("", "rate", rate, f"of the recording [Hz]{reason}")
    draft = draft.with_key("", "joints", *_joint_names(signals, joints))
    plates = find_plates(sources, signals)
    used = {each.source.name for each in signals.values()} | {
        each[1].name for each in plates
    }
    for each in sources:
        if each.name in used or not used:
            draft = _draft_with_source(draft, each, folder)
        else:
            unused = f"{shortened_list(each.table.columns)} of {each.file.name} {each.topic or ''}"
            draft = draft.with_comment_lines(
                "", f"# not used: {printable_line(unused)}"
            )
        if not rate:  # rate of the recording is to be filled in
            draft = draft.with_key(f"sources.{each.name}", "rate", None)
    for kind in get_args(JointQuantity):
        draft = _draft_with_signal(draft, kind, signals, sources)
    names, single = [name for name, _, _ in plates], len(plates) == 1
    for name, source, columns in plates:
        plate_name = name if names.count(name) == 1 else f"{source.name} {name}"
        table = "wrench" if single else f"plates.{_plate_key(plate_name)}"
        draft = draft.with_keys(table, _plate_keys(source, columns, single=single))
    return draft


def _draft_with_source(
    draft: MappingDraft, source: LikelySource, folder: Path
) -> MappingDraft:
    """Draft extended by the table of a source, with comments that list the source's columns."""
    name = f"sources.{source.name}"
    file = os.path.relpath(source.file.resolve(), folder.resolve())
    comments = (
        [f"# {source.logger} names its columns like this"] if source.logger else []
    )
    rows = max(source.table.lengths.values(), default=0)
    comments += (
        [f"# the last line is incomplete: {rows} rows are read"]
        if source.table.is_incomplete
        else []
    )
    draft = draft.with_comment_lines(name, *comments, *_column_listing(source.table))
    keys = [
        ("file", file, ""),
        ("topic", source.topic, ""),
        *source.clock.mapping_keys(),
    ]
    return draft.with_keys(name, keys)


def _matched_signals(
    sources: Sequence[LikelySource],
    joints: Sequence[str],
    subsets: Iterable[Sequence[str]],
) -> tuple[Mapping[JointQuantity, LikelySignal], Sequence[str]]:
    """Signals of all joints, or of a subset of the joints that fits the columns.

    Subsets are tried until the columns of all signals are matched with joints.

    Returns:
        Signals, and the joints to which they belong.
    """
    signals = find_signals(sources, joints)
    for subset in subsets:
        if signals and all(each.group.matched for each in signals.values()):
            break
        subset_signals = find_signals(sources, subset)
        if any(each.group.matched for each in subset_signals.values()):
            signals, joints = subset_signals, subset
    return signals, joints


def _recording_rate(
    sources: Sequence[LikelySource], signals: Mapping[JointQuantity, LikelySignal]
) -> float:
    """Sampling rate of the positions, or the highest of all sources [Hz]; 0 if unknown."""
    if "position" in signals and (
        position_rate := signals["position"].source.clock.rate
    ):
        return position_rate
    return max((each.clock.rate for each in sources), default=0.0)


def _joint_names(
    signals: Mapping[JointQuantity, LikelySignal], joints: Sequence[str]
) -> tuple[Sequence[str], str]:
    """Joint names of the model or of the columns, and a comment; [""] if unknown."""
    description = "as in the model file, in the order of the columns below"
    group = next((each.group for each in signals.values()), None)
    if group is None:
        return list(joints) or [""], description
    missing = [name for name in joints if name not in group.names]
    if group.matched or not joints:
        unnamed = [name for name in group.names if not re.search("[A-Za-z]", name)]
        remark = "" if unnamed or group.matched else "; these are by the columns' names"
        remark += f"; no columns of {', '.join(missing)}" if missing else ""
        return [""] if unnamed else list(group.names), description + remark
    counts = (
        f"{count_with_noun(len(group.names), 'column')} for "
        f"{count_with_noun(len(joints), 'joint')}"
    )
    return [""], f"{description}, {counts}: {', '.join(joints)}"


def _column_listing(table: ForeignTable) -> Iterator[str]:
    """Comment lines that list the columns of a table: name, samples, range and unit."""
    yield "# column, samples, from .. to, unit by the file"
    lengths = table.lengths
    for column in table.columns[:MAX_LISTED_COLUMNS]:
        try:
            value_range = _value_range(table.column_values([column])[column])
        except RecordingError as error:  # the column may not be needed
            value_range = str(error)
        yield (
            f"#   {printable_line(json.dumps(column), 80)}  {lengths[column]}  {value_range}  "
            f"{printable_line(table.unit(column) or '-', 20)}"
        )
    omitted = len(table.columns) - MAX_LISTED_COLUMNS
    if omitted > 0:
        yield f"#   and {omitted} more"


def _value_range(values: Array) -> str:
    """Smallest and largest finite value of a column, as text."""
    finite = values[np.isfinite(values)]
    missing = (
        f" ({len(values) - len(finite)} no numbers)"
        if len(finite) < len(values)
        else ""
    )
    return (
        f"{finite.min():.4g} .. {finite.max():.4g}" if len(finite) else "nothing"
    ) + missing


def _draft_with_signal(
    draft: MappingDraft,
    kind: JointQuantity,
    signals: Mapping[JointQuantity, LikelySignal],
    sources: Sequence[LikelySource],
) -> MappingDraft:
    """Draft extended by the table of a signal.

    If no columns are recognised, comments replace the table of positions and torques; other signals
    are omitted.
    """
    excluded = [
        c.name for s in sources for c in s.columns if c.kind == kind and c.is_excluded
    ]
    if excluded:
        draft = draft.with_comment_lines(
            kind, f"# left out, by their names: {json.dumps(excluded)}"
        )
    if kind in signals:
        return draft.with_keys(kind, _signal_keys(kind, signals[kind]))
    optional = ", if there are any" if kind != "position" else ""
    lines = [
        f"# [{kind}]  # no column looks like it{optional}",
        f'# source = "{sources[0].name}"',
        "# columns = []  # one a joint",
        f'# unit = ""  # {_unit_list(kind)}',
    ]
    return (
        draft.with_comment_lines(kind, *lines)
        if kind in ("position", "torque")
        else draft
    )


def _signal_keys(kind: JointQuantity, signal: LikelySignal) -> Iterator[AnnotatedKey]:
    """Yield keys of a joint signal's table, with values and comments.

    The keys are source, columns and unit and, where recognised, matrix and offset for encoder
    counts, sign bit and signs.
    """
    others = (
        f"others that look like it: {json.dumps(signal.other_columns)}"
        if signal.other_columns
        else ""
    )
    yield "source", signal.source.name, ""
    columns = [each.name for each in signal.group.columns]
    yield "columns", columns, "; ".join(filter(None, (signal.column_evidence, others)))
    yield from _unit_keys(kind, signal)
    n = len(columns)
    if signal.counts_per_turn:
        turns = np.diag(np.full(n, 1 / signal.counts_per_turn)).tolist()
        description = (
            f"{signal.counts_per_turn} counts a turn, "
            "as of Dynamixel's and Feetech's servos"
        )
        yield "matrix", turns, description
        yield (
            "offset",
            [round(-np.pi, 6)] * n,
            "ASSUMED: zero is in the middle of a turn",
        )
    if signal.sign_bit:
        description = (
            f"values beyond {signal.sign_bit - 1} have a sign bit, as of servos' loads"
        )
        yield "sign_bit", signal.sign_bit, description
    yield "sign", list(signal.sign) or None, VELOCITY_EVIDENCE


def _unit_keys(kind: JointQuantity, signal: LikelySignal) -> Iterator[AnnotatedKey]:
    """Yield the unit of a signal's columns, and an empty `gain` for raw units.

    The unit is empty if the unit of a column is unknown, or if raw and other units are mixed.
    """
    known = UNITS_BY_QUANTITY[kind] | (RAW_UNITS if kind == "torque" else {})
    units = [unit for unit in signal.units if unit in known]
    raw = [unit for unit in units if unit in RAW_UNITS]
    if len(units) < len(signal.units) or 0 < len(raw) < len(units):
        hints = "; or A, V, raw with gain = [N m each]" * (kind == "torque")
        largest = (
            float(np.nanmax(np.abs(signal_values(signal))))
            if kind == "position"
            else 0.0
        )
        if PER_CENT_RANGE[0] <= largest <= PER_CENT_RANGE[1]:
            hints += "; per cent of each joint's range, as of SO arms: deg, matrix of ranges / 200"
        yield "unit", "", f"{_unit_list(kind)}{hints}"
        return
    yield "unit", units[0] if len(set(units)) == 1 else units, signal.unit_evidence
    if raw:
        yield "gain", "", f"torque of one {raw[0]}, joint by joint [N m]"


def _temperature_signal(
    sources: Sequence[LikelySource],
    joints: Sequence[str],
    signals: Mapping[JointQuantity, LikelySignal],
) -> Mapping[JointQuantity, LikelySignal]:
    """Signal "temperature" of the drives if every joint has a column; empty otherwise."""
    position = signals.get("position")
    names = list(joints) if position is None else list(position.group.names)
    for source in sources:
        columns = [
            c for c in source.columns if not TEMPERATURE_WORDS.isdisjoint(c.words)
        ]
        for group in (
            each.with_model_joints(names).reordered_as(names)
            for each in column_groups(columns, names)
        ):
            if list(group.names) == names:
                units, because = ("degC",) * len(names), "the only one that is known"
                return {
                    "temperature": LikelySignal(
                        source, group, (), units, unit_evidence=because
                    )
                }
    return {}


def _plate_key(name: str) -> str:
    """TOML key for a plate, from the words that distinguish its columns."""
    return re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "plate"


def _plate_keys(
    source: LikelySource, columns: Sequence[ColumnName], *, single: bool
) -> Iterator[AnnotatedKey]:
    """Yield keys of a force plate's table, with values and comments.

    Units, matrix, pose and sense are taken from the file; a key that the file does not state is
    empty.

    Args:
        source: Source of the columns.
        columns: Columns of the plate: force, then moment.
        single: True if there is only one plate.
    """
    names = tuple(each.name for each in columns)
    unstated = DescribedPlate("", names)
    stated = next(
        (each for each in source.table.plates if each.columns == names), unstated
    )
    yield "source", source.name, ""
    six_required = "six are wanted: force x, y, z, moment x, y, z" * (
        len(columns) != 6 and stated is unstated
    )
    tool_remark = (
        "they look like those of a sensor at the tool: leave [wrench] out then"
    )
    yield (
        "columns",
        list(names),
        tool_remark if is_tool_wrench(columns[0]) else six_required,
    )
    units = [_common_unit(columns[:3], "force"), _common_unit(columns[3:], "moment")]
    raw = next(
        (
            each.unit
            for each in columns
            if each.unit and canonical_unit(each.unit) in RAW_UNITS
        ),
        None,
    )
    if raw or stated.matrix:
        description = (
            ""
            if stated.matrix
            else f"the file states {raw}: six rows, N and N m of one {raw}"
        )
        yield "units", ["N", "N m"], "by the matrix"
        yield "matrix", stated.matrix or "", description
    else:
        yield (
            "units",
            units,
            "" if all(units) else f"{_unit_list('force')}; {_unit_list('moment')}",
        )
    if stated is not unstated:
        yield "sense", "on_plate", "as in all files of its kind"
    else:
        mean_forces = [
            f"; {json.dumps(each.name)} is "
            f"{np.nanmean(source.table.column_values([each.name])[each.name]):.4g} on average"
            for each in columns
            if each.wrench_component == (0, 2)
        ]
        yield (
            "sense",
            "",
            f"on_robot (at rest upwards) or on_plate{''.join(mean_forces)}",
        )
    if (place := stated.sensor_pose) is not None:
        yield (
            "place",
            place,
            "by the file, in the laboratory's frame: it must be the bedplate's",
        )
    elif single:
        yield "# place", {"xyz": [0, 0, 0], "rpy": [0, 0, 0]}, "of the sensor [m, rad]"
    else:
        yield (
            "place",
            "",
            "of the sensor [m, rad], as { xyz = [0, 0, 0], rpy = [0, 0, 0] }",
        )


def _unit_list(kind: str) -> str:
    """Known units of a quantity, as text."""
    return ", ".join(UNITS_BY_QUANTITY[kind])


def _common_unit(columns: Sequence[ColumnName], kind: str) -> str:
    """Unit that all columns state; empty if the columns have no common, known unit."""
    units = {canonical_unit(each.unit or "") for each in columns}
    return (
        units.pop()
        if len(units) == 1 and units <= UNITS_BY_QUANTITY[kind].keys()
        else ""
    )
