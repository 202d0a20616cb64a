"""What the plate says of the drives, as a table for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from testbed.errors import printable
from testbed.identification.estimate_text import number_with_sigma
from testbed.reporting.widths import first_that_fits

if TYPE_CHECKING:
    from testbed.identification.drive_findings import DriveFindings
    from testbed.identification.drive_laws import Choice
    from testbed.identification.torque_constants import DriveEstimate


def drive_tables(console: Console, drives: Sequence[DriveEstimate]) -> list[Table]:
    """Torque constants and the joints' own terms: one table, or one a term where that is too wide.

    Args:
        console: Where they are to be printed.
        drives: One a joint.
    """
    kinds = list(dict.fromkeys(term.law.kind for each in drives for term in each.terms))
    heads = ["torque constant", *kinds, "residual"]
    layouts = (
        [_table(drives, part) for part in parts] for parts in ([heads], [[h] for h in heads])
    )
    return first_that_fits(console, layouts)


def _table(drives: Sequence[DriveEstimate], heads: Sequence[str]) -> Table:
    table = Table(
        title="drives, held against the plate",
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
    )
    table.add_column("joint", overflow="fold")
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    for each in drives:
        table.add_row(printable(each.joint), *(_cell(each, head) for head in heads))
    return table


def _cell(drive: DriveEstimate, head: str) -> str:
    if head == "torque constant":
        return number_with_sigma(drive.constant, drive.sigma, short=True)
    if head == "residual":
        return f"{drive.residual:.3g} {drive.unit}"
    term = next((term for term in drive.terms if term.law.kind == head), None)
    if term is None:
        return ""
    return f"{number_with_sigma(term.value, term.sigma, short=True)} {term.unit}"


def drive_lines(drives: DriveFindings) -> list[str]:
    """Which terms were chosen, and whether plate and torques agree, a sentence each.

    Args:
        drives: All that the plate says of them.
    """
    lines = []
    for each in drives.estimates:
        if each.choice is not None:
            lines.append(f"{printable(each.joint)}: {_chosen(each.choice)}")
    said = drives.combined.disagreement
    if not drives.diagnostics:
        lines.append(f"Plate and joint torques agree (chance {said.chance:.2g}).")
    return lines


def _chosen(choice: Choice) -> str:
    """Coulomb and viscous, then stribeck@0.08 (better by 5.1 standard errors); next ..., 0.4."""
    better = "better by {:.1f} standard errors"
    added = [f"{step.kind} ({better.format(step.gain)})" for step in choice.steps[1:]]
    text = " and ".join(law.kind for law in choice.laws[: len(choice.laws) - len(added)])
    text += f", then {', '.join(added)}" if added else ", nothing else"
    if choice.next_best is not None:
        text += f"; next would be {choice.next_best.kind}, by {choice.next_best.gain:.1f}"
    return text
