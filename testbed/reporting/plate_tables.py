"""A plate's numbers as tables for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from testbed.identification.estimate_text import number_with_sigma
from testbed.recordings.columns import AXES
from testbed.reporting.widths import first_that_fits

if TYPE_CHECKING:
    from testbed.identification.calibration import Calibration

_HALVES = (AXES[:3], AXES[3:])


def plate_tables(console: Console, plate: Calibration) -> list[Table]:
    """The matrix of a plate: one table, or two where that is too wide.

    Args:
        console: Where it is to be printed.
        plate: The calibration.
    """
    layouts = ([_table(plate, felt) for felt in parts] for parts in ((AXES,), _HALVES))
    return first_that_fits(console, layouts)


def _table(plate: Calibration, felt: tuple[str, ...]) -> Table:
    table = Table(
        title="what a channel (row) shows of a component of the wrench (column)",
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
    )
    table.add_column("")
    for name in felt:
        table.add_column(name, justify="right", no_wrap=True)
    values, sigmas = plate.matrix, plate.matrix_sigma
    places = [AXES.index(name) for name in felt]
    for row, name in enumerate(AXES):
        cells = [_cell(float(values[row, c]), float(sigmas[row, c])) for c in places]
        table.add_row(name, *cells)
    return table


def _cell(value: float, sigma: float) -> str:
    return number_with_sigma(value, sigma, short=True) if sigma else f"{value:.6g}"


def plate_lines(plate: Calibration) -> list[str]:
    """The other numbers, a line each kind.

    Args:
        plate: The calibration.
    """
    kinds: dict[str, list[str]] = {}
    for each in plate.numbers:
        if each.kind != "matrix":
            number = f"{each.name} {number_with_sigma(each.value, each.sigma)} {each.unit}"
            kinds.setdefault(each.kind, []).append(number.rstrip())
    return [", ".join(numbers) for numbers in kinds.values()]
