"""Delays and clocks' drifts that were found, taken back by the mapping's own words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from testbed.recordings.importing.import_report import ImportReport
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
        if each.late or each.drifts:
            table = getattr(mapping, each.signal)
            own = table.source != mapping.position.source
            skew = each.skew if each.drifts and own else 0.0
            lead = report.clocks[table.source].lead
            begins = (-lead - table.delay - each.delay + skew * each.middle) / (1 + skew)
            changed[each.signal] = table.model_copy(update={"delay": -lead - begins})
            if skew:
                source = mapping.sources[table.source]
                faster = (1 + source.skew) / (1 + skew) - 1
                sources[table.source] = source.model_copy(update={"skew": faster})
    return mapping.model_copy(update={**changed, "sources": sources})


def cure(each: ClockOffset, mapping: Mapping[str, Any]) -> str:
    """What to write where a signal is late, as a line of the mapping.

    Args:
        each: How late it is.
        mapping: What the mapping file says, as a recording keeps it.
    """
    if each.drifts:
        return "import with --model and --align takes both back"
    before = float(mapping.get(each.signal, {}).get("delay", 0.0))
    return (
        f"in the mapping: [{each.signal}] delay = {before + each.delay:.6g}, or import with "
        "--model and --align"
    )
