"""A comparison on the terminal: a line a variant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from testbed.errors import plural, printable
from testbed.experiment.comparison import Compared, Comparison
from testbed.experiment.run import Run
from testbed.experiment.summary import obtained, verdict
from testbed.identification.estimate import METHODS, Method
from testbed.reporting.widths import first_that_fits

_NAME = 10
"""Columns that names and words have at least, when they give way."""

_NAMED: Mapping[bool | None, str] = {True: "right", False: "WRONG", None: "-"}


def print_comparison(out: Console, comparison: Comparison, rows: Sequence[Compared]) -> None:
    """Print what came of every variant, which claims fail, and the verdict.

    Args:
        out: Where to.
        comparison: What was compared.
        rows: What came of it.
    """
    for table in comparison_tables(out, comparison, rows):
        out.print(table)
    for row in rows:
        for line in _failures(row):
            out.print(f"{printable(row.variant.name)}: {printable(line)}", soft_wrap=True)
    if comparison.claim:
        out.print(f"claim: {printable(comparison.claim)}")
    held = sum(row.as_expected for row in rows)
    verdict = "the claim holds" if held == len(rows) else "THE CLAIM FAILS"
    out.print(f"verdict: {verdict} ({held} of {plural(len(rows), 'line')} as expected)")


def comparison_tables(
    out: Console, comparison: Comparison, rows: Sequence[Compared]
) -> list[Table]:
    """Of every variant: errors, what is said first, whether that is right; the remedy's errors.

    One table where it fits; else one a method, and one of what is said.

    Args:
        out: Where they are to be printed.
        comparison: What was compared.
        rows: What came of it.
    """
    methods = [m for m in METHODS if m in comparison.methods]

    def layouts() -> Iterator[list[Table]]:
        yield [_table(rows, methods, said=True)]
        yield [*(_table(rows, [m], said=False) for m in methods), _table(rows, [], said=True)]

    tables = first_that_fits(out, layouts())
    tables[0].title, tables[0].title_justify = printable(comparison.name), "left"
    return tables


def _table(rows: Sequence[Compared], methods: Sequence[Method], *, said: bool) -> Table:
    """Errors by some methods, and, if it is wanted, what is said."""
    table = Table(box=SIMPLE_HEAD)
    table.add_column("variant", overflow="fold", min_width=_NAME)
    for method in methods:
        table.add_column(f"{method}: error", justify="right", no_wrap=True)
        table.add_column("max z", justify="right", no_wrap=True)
    if said:
        table.add_column("said first", overflow="fold", min_width=_NAME)
        table.add_column("named", no_wrap=True)
    for _ in methods:
        table.add_column("remedied", justify="right", no_wrap=True)
        table.add_column("max z", justify="right", no_wrap=True)
    for row in rows:
        first = printable(row.said[0]) if row.said else "nothing"
        table.add_row(
            printable(row.variant.name),
            *_numbers(row.run, methods),
            *([first, _NAMED[row.named]] if said else []),
            *_numbers(row.remedied, methods),
        )
    return table


def _numbers(run: Run | None, methods: Sequence[Method]) -> list[str]:
    """Rms relative error and largest z of each method; dashes for a run that is not there."""
    names = [f"{m}_{what}" for m in methods for what in ("rms_relative_error", "max_z")]
    return ["-" if run is None else obtained(run, name) for name in names]


def _failures(row: Compared) -> Iterator[str]:
    """Why a variant is not as expected, a line each."""
    if not row.run.as_expected:
        yield verdict(row.run)
    if row.remedied is not None and not row.remedied.as_expected:
        yield f"with its remedy: {verdict(row.remedied)}"
    if row.named is False:
        wanted = f"'{row.variant.says}'" if row.variant.says else "nothing"
        found = f"'{row.said[0]}'" if row.said else "nothing"
        yield f"what is said first is {found}, claimed {wanted}"
