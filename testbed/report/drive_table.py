"""What the plate says of the drives, as a table for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from testbed.errors import printable
from testbed.report.tables import number_with_sigma
from testbed.report.widths import first_that_fits

if TYPE_CHECKING:
    from testbed.identification.torque_constants import DriveEstimate


def drive_tables(console: Console, drives: Sequence[DriveEstimate]) -> list[Table]:
    """Torque constants and the joints' own terms: one table, or one a term where that is too wide.

    Args:
        console: Where they are to be printed.
        drives: One a joint.
    """
    kinds = [term.law.kind for term in drives[0].terms]
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
    term = next(term for term in drive.terms if term.law.kind == head)
    return f"{number_with_sigma(term.value, term.sigma, short=True)} {term.unit}"


def drives_as_json(drives: Sequence[DriveEstimate]) -> dict[str, Any]:
    """For programs.

    Args:
        drives: One a joint.
    """
    return {
        each.joint: {
            "torque_constant": {"value": each.constant, "sigma": each.sigma},
            "terms": {
                term.law.kind: {"value": term.value, "sigma": term.sigma, "unit": term.unit}
                for term in each.terms
            },
            "residual": each.residual,
            "unit": each.unit,
            "rows": each.rows,
        }
        for each in drives
    }
