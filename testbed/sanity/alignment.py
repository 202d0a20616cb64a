"""Delays and clocks' drifts that were found, taken back by the mapping's own words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from testbed.recordings.importing.import_report import ImportReport
from testbed.recordings.importing.mapping import AnyTable
from testbed.recordings.importing.mapping import Mapping as MappingFile
from testbed.sanity.clock_offset import ClockOffset


def aligned(
    mapping: MappingFile, report: ImportReport, found: Iterable[ClockOffset]
) -> MappingFile:
    """The mapping with `delay`, and `skew` of sources with clocks of their own, as found.

    Args:
        mapping: By which the recording was made.
        report: What was found on the way.
        found: Delays of its signals; those that may be noise are left alone.
    """
    changed: dict[str, Any] = {}
    sources = dict(mapping.sources)
    for each in found:
        if not each.late and not each.drifts:
            continue
        tables: dict[str, AnyTable] = {each.signal: getattr(mapping, each.signal)}
        if each.signal == "wrench" and mapping.plates:
            tables = dict(mapping.plates)
        for name, table in tables.items():
            own = table.source != mapping.position.source
            skew = each.skew if each.drifts and own else 0.0
            lead = report.clocks[table.source].lead
            begins = (-lead - table.delay - each.delay + skew * each.middle) / (1 + skew)
            tables[name] = table.model_copy(update={"delay": -lead - begins})
            if skew:
                source = mapping.sources[table.source]
                faster = (1 + source.skew) / (1 + skew) - 1
                sources[table.source] = source.model_copy(update={"skew": faster})
        changed |= {"plates": tables} if tables.keys() == mapping.plates.keys() else tables
    return mapping.model_copy(update={**changed, "sources": sources})


def cure(each: ClockOffset, mapping: Mapping[str, Any]) -> str:
    """What to write where a signal is late, as a line of the mapping.

    Args:
        each: How late it is.
        mapping: What the mapping file says, as a recording keeps it.
    """
    if each.drifts:
        return "import with --model and --align takes both back"
    plates = mapping.get("plates", {}) if each.signal == "wrench" else {}
    tables = {f"plates.{name}": said for name, said in plates.items()}
    tables = tables or {each.signal: mapping.get(each.signal, {})}
    lines = [
        f"[{name}] delay = {float(said.get('delay', 0.0)) + each.delay:.6g}"
        for name, said in tables.items()
    ]
    return f"in the mapping: {'; '.join(lines)}, or import with --model and --align"
