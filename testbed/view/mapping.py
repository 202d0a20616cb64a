"""HTML page of a solved column mapping: wrench and best fit, before and after."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from testbed.core.base.diagnostics import sentences
from testbed.core.recordings.columns import WRENCH_COMPONENTS, WRENCH_UNITS
from testbed.importing.check.draft_mapping import note_rows
from testbed.importing.check.mapping_solution import MappingSolution
from testbed.importing.check.plate import WrenchFit
from testbed.importing.import_report import MappingDraft
from testbed.view.figures import Panel
from testbed.view.output import write_page
from testbed.view.section import Section, Table


def write_mapping_page(path: Path, solution: MappingSolution) -> None:
    """Write the HTML page of a solved column mapping.

    Args:
        path: The HTML file, replaced if it exists.
        solution: Mapping with diagnostics and with fits to the force plate's wrench.
    """
    write_page(path, "mapping.html", mapping_contents(path.stem, solution))


def mapping_table(draft: MappingDraft) -> Table:
    """Table of the mapping keys that were assumed or solved, with value and evidence.

    Args:
        draft: The mapping.
    """
    return Table(
        ["key", "value", "known by"], note_rows(draft), left=["value", "known by"]
    )


def mapping_contents(title: str, solved: MappingSolution) -> dict[str, Any]:
    """Template variables of the mapping page: title, summary, table and figures.

    The figures show the plate's wrench before and after the solution, where there are fits.

    Args:
        title: Name of the mapping.
        solved: Mapping with diagnostics and with fits to the force plate's wrench.
    """
    figures = []
    pairs = (
        (solved.initial_fit, "before", "by the columns' names alone"),
        (solved.final_fit, "after", "by this mapping"),
    )
    for fit, anchor, origin in pairs:
        if fit is not None:
            figures.append(_wrench_section(fit, anchor, origin))
    return {
        "title": f"Mapping {title}",
        "summary": [
            "The data determine what the column names do not state.",
            *(f"Warning: {line}." for line in sentences(solved.diagnostics)),
        ],
        "table": mapping_table(solved.draft),
        "figures": figures,
    }


def _wrench_section(wrench_fit: WrenchFit, anchor: str, origin: str) -> Section:
    """Section with the plate's six channels as read, and their best fit.

    The fit has the robot's parameters as unknowns. The table contains the fraction of each
    channel's variance that the fit leaves unexplained.

    Args:
        wrench_fit: Wrench as read from the log, and its fit.
        anchor: Anchor on the page.
        origin: Description of the mapping that gave the wrench, for the title.
    """
    panels = [
        Panel(
            f"{axis} [{unit}]",
            {
                "measured": (wrench_fit.time, wrench_fit.wrench[:, k]),
                "wrench": (wrench_fit.time, wrench_fit.fit[:, k]),
            },
            "time [s]",
        )
        for k, (axis, unit) in enumerate(
            zip(WRENCH_COMPONENTS, WRENCH_UNITS, strict=True)
        )
    ]
    return Section(
        id=anchor,
        title=f"The plate {origin}",
        explanation=(
            "The six channels and their best fit by any parameters of the robot. They agree if "
            "the mapping is right."
        ),
        legend={"measured": "measured", "wrench": "explained"},
        panels=panels,
        caption="Through a low-pass of 8 Hz, in the bedplate's frame.",
        table=Table(
            ["channel", "unexplained"],
            [
                [axis, f"{share:.3%}"]
                for axis, share in zip(
                    WRENCH_COMPONENTS, wrench_fit.unexplained, strict=True
                )
            ],
        ),
    )
