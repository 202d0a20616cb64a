"""A mapping that was solved: the plate before and after, and what else was tried."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from testbed.diagnostics import sentences
from testbed.plausibility.mapping_solution import MappingSolution, table_of
from testbed.plausibility.plate import WrenchFit
from testbed.recordings.columns import AXES, PLATE_UNITS
from testbed.recordings.importing.import_report import Draft
from testbed.reporting.figures import Panel, named_panels
from testbed.reporting.output import write_page
from testbed.reporting.section import Section, Table

LEAST = 1e-4
"""Where bars begin [%]."""


def write_mapping_page(path: Path, solved: MappingSolution) -> None:
    """Write the page of a mapping.

    Args:
        path: The HTML file; what stands there is replaced.
        solved: The mapping, and what was found on the way.
    """
    write_page(path, "mapping.html", mapping_contents(path.stem, solved))


def solved_table(draft: Draft) -> Table:
    """What was solved.

    Args:
        draft: The mapping.
    """
    return Table(["key", "value", "known by"], table_of(draft), left=["value", "known by"])


def mapping_contents(title: str, solved: MappingSolution) -> dict[str, Any]:
    """All that the page shows.

    Args:
        title: Of the page.
        solved: The mapping, and what was found on the way.
    """
    figures = []
    pairs = ((solved.before, "before", "by the columns' names alone"),
             (solved.after, "after", "by this mapping"))  # fmt: skip
    for read, place, how in pairs:
        if read is not None:
            figures.append(_channels(read, place, how))
    if solved.shares:
        figures.append(_runner_ups(solved))
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
            {"measured": (read.time, read.wrench[:, k]), "external": (read.time, read.fit[:, k])},
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
            [[axis, f"{left:.3%}"] for axis, left in zip(AXES, read.unexplained, strict=True)],
        ),
    )


def _runner_ups(solved: MappingSolution) -> Section:
    words = [each for each, _ in solved.shares]
    shares = 100 * np.array([share for _, share in solved.shares])
    numbers = [str(k) for k in range(1, len(words) + 1)]
    bars = {"external": (np.full(len(shares), LEAST), shares)}
    return Section(
        id="runner-ups",
        title="Alternatives",
        says=(
            "Mean unexplained share of the plate's channels for the mapping (first) and for the "
            "alternatives that come nearest."
        ),
        legend={"external": "unexplained"},
        panels=(
            named_panels(
                "unexplained", numbers, {"external": shares}, "unexplained [%]", bars=bars, log=True
            )
        ),
        caption=(
            "; ".join(f"{k}: {each}" for k, each in zip(numbers, words, strict=True))
            + ". Logarithmic."
        ),
        table=Table(
            ["explanation", "unexplained"],
            [[each, f"{share:.3g} %"] for each, share in zip(words, shares, strict=True)],
        ),
    )
