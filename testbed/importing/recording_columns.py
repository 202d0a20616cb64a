"""Columns and metadata of a recording, from values in the units of foreign files."""

from __future__ import annotations

from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.codec import to_json_values
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.columns import column_members
from testbed.importing.import_report import ImportReport
from testbed.importing.mapping import (
    BaseTable,
    ForceSensorTable,
    Mapping,
    SixAxisTable,
    WrenchTable,
)
from testbed.importing.signal_maps import (
    base_pose_from_columns,
    joint_kinds,
    joint_signal,
    torque_quantities,
    wrench_from_columns,
)


def used_columns(mapping: Mapping) -> dict[str, list[str]]:
    """Names of the columns that signals use, keyed by source.

    Raises:
        RecordingError: A source is not used by any signal.
    """
    columns: dict[str, list[str]] = {}
    for table in mapping.all_signal_tables.values():
        columns.setdefault(table.source, []).extend(table.columns)
    unused = [name for name in mapping.sources if name not in columns]
    if unused:
        raise RecordingError(f"sources.{unused[0]}: no signal is of it")
    return columns


def signal_columns(mapping: Mapping, label: str, raw: Array) -> dict[str, Array]:
    """Columns of the recording from one signal's raw values on the grid, (L,) each.

    They are in SI units and are named SIGNAL/MEMBER, where members are joints or components.

    Args:
        mapping: Content of the mapping file.
        label: Label of the signal's table in the mapping, for example "torque" or "plates.NAME".
        raw: Values in the units of the file, (L, k).
    """
    table = mapping.all_signal_tables[label]
    signal, sensors = label, (label.removeprefix("sensors."),)
    if isinstance(table, SixAxisTable):
        values = wrench_from_columns(table, raw)
        signal = "sensors" if isinstance(table, ForceSensorTable) else "wrench"
    elif isinstance(table, BaseTable):
        values = base_pose_from_columns(table, raw)
    else:
        values = joint_signal(label, table, mapping.gear, raw)
    members = column_members(signal, tuple(mapping.joints), sensors)
    return {f"{signal}/{member}": values[:, k] for k, member in enumerate(members)}


def recording_metadata(mapping: Mapping, report: ImportReport) -> dict[str, Any]:
    """Metadata of the recording's file: "tare" and "facts".

    The tare is the sum of the plates' static wrenches, six numbers [N, N m]; None stands for the
    static wrench of the model's pedestal. The entry "facts" holds report, mapping, diagnostics,
    sensors, kinds of joints and torques, and gravity; empty values are omitted.
    """
    metadata = {
        "import": to_json_values(report),
        "mapping": mapping.model_dump(mode="json", exclude_none=True),
        "diagnostics": [each.as_dict() for each in report.diagnostics],
        "sensors": {
            name: {"link": each.link or name} for name, each in mapping.sensors.items()
        },
        "geometry": joint_kinds(mapping.position, mapping.joints),
        "effort": torque_quantities(mapping),
        "gravity": mapping.gravity,
    }
    plates = [
        each
        for each in mapping.wrench_and_base_tables.values()
        if isinstance(each, WrenchTable)
    ]
    tares = [
        t for each in plates if (t := each.static_wrench(mapping.gravity)) is not None
    ]
    tare = np.sum(tares, axis=0).tolist() if tares else None
    return {
        "tare": tare,
        "facts": {name: value for name, value in metadata.items() if value},
    }
