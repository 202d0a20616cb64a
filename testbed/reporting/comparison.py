"""A comparison on the terminal: a line a variant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from rich.console import Console

from testbed.errors import plural, printable
from testbed.experiment.comparison import Compared, Comparison
from testbed.experiment.run import Run
from testbed.experiment.summary import obtained, verdict
from testbed.identification.estimate import METHODS, Method
from testbed.reporting.output import print_tables
from testbed.reporting.section import Table

_NAMED: Mapping[bool | None, str] = {True: "right", False: "WRONG", None: "-"}


def print_comparison(out: Console, comparison: Comparison, rows: Sequence[Compared]) -> None:
    """Print what came of every variant, which claims fail, and the verdict.

    Args:
        out: Where to.
        comparison: What was compared.
        rows: What came of it.
    """
    methods = [m for m in METHODS if m in comparison.methods]
    print_tables(
        out,
        [_table(comparison.name, rows, methods, said=True)],
        [
            *(_table(comparison.name, rows, [m], said=False) for m in methods),
            _table("", rows, [], said=True),
        ],
    )
    for row in rows:
        for line in _failures(row):
            out.print(f"{printable(row.variant.name)}: {printable(line)}", soft_wrap=True)
    if comparison.claim:
        out.print(f"claim: {printable(comparison.claim)}")
    held = sum(row.as_expected for row in rows)
    verdict = "the claim holds" if held == len(rows) else "THE CLAIM FAILS"
    out.print(f"verdict: {verdict} ({held} of {plural(len(rows), 'line')} as expected)")


def _table(title: str, rows: Sequence[Compared], methods: Sequence[Method], *, said: bool) -> Table:
    """Errors by some methods, and, if it is wanted, what is said first; the remedy's errors."""
    errors = [head for method in methods for head in (f"{method}: error", "max z")]
    heads = ["variant", *errors, *(["said first", "named"] if said else [])]
    heads += [head for _ in methods for head in ("remedied", "max z")]
    cells = [
        [
            row.variant.name,
            *_numbers(row.run, methods),
            *([row.said[0] if row.said else "nothing", _NAMED[row.named]] if said else []),
            *_numbers(row.remedied, methods),
        ]
        for row in rows
    ]
    return Table(heads, cells, title, left=["said first", "named"])


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
