"""Page of a mapping that was solved: the plate before and after."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from testbed.core.base.diagnostics import sentences
from testbed.core.recordings.columns import AXES, PLATE_UNITS
from testbed.importing.check.draft_mapping import table_of
from testbed.importing.check.mapping_solution import MappingSolution
from testbed.importing.check.plate import WrenchFit
from testbed.importing.import_report import MappingDraft
from testbed.view.figures import Panel
from testbed.view.output import write_page
from testbed.view.section import Section, Table


def write_mapping_page(path: Path, solved: MappingSolution) -> None:
    """Write the page of a mapping.

    Args:
        path: The HTML file; what stands there is replaced.
        solved: The mapping, and what was found on the way.
    """
    write_page(path, "mapping.html", mapping_contents(path.stem, solved))


def solved_table(draft: MappingDraft) -> Table:
    """What was solved.

    Args:
        draft: The mapping.
    """
    return Table(
        ["key", "value", "known by"], table_of(draft), left=["value", "known by"]
    )


def mapping_contents(title: str, solved: MappingSolution) -> dict[str, Any]:
    """All that the page shows.

    Args:
        title: Of the page.
        solved: The mapping, and what was found on the way.
    """
    figures = []
    pairs = (
        (solved.before, "before", "by the columns' names alone"),
        (solved.after, "after", "by this mapping"),
    )
    for read, place, how in pairs:
        if read is not None:
            figures.append(_channels(read, place, how))
    return {
        "title": f"Mapping {title}",
        "summary": [
            "The data determine what the column names do not state.",
            *(f"Warning: {line}." for line in sentences(solved.diagnostics)),
        ],
        "table": solved_table(solved.draft),
        "figures": figures,
    }


def _channels(read: WrenchFit, place: str, how: str) -> Section:
    panels = [
        Panel(
            f"{axis} [{unit}]",
            {
                "measured": (read.time, read.wrench[:, k]),
                "external": (read.time, read.fit[:, k]),
            },
            "time [s]",
        )
        for k, (axis, unit) in enumerate(zip(AXES, PLATE_UNITS, strict=True))
    ]
    return Section(
        id=place,
        title=f"The plate {how}",
        says=(
            "The six channels and their best fit by any parameters of the robot. They agree if "
            "the mapping is right."
        ),
        legend={"measured": "measured", "external": "explained"},
        panels=panels,
        caption="Through a low-pass of 8 Hz, in the bedplate's frame.",
        table=Table(
            ["channel", "unexplained"],
            [
                [axis, f"{left:.3%}"]
                for axis, left in zip(AXES, read.unexplained, strict=True)
            ],
        ),
    )
