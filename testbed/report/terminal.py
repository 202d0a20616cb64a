"""What the terminal shows: progress, tables, notes."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from testbed.report.tables import (
    estimate_table,
    quality_lines,
    result_table,
)

if TYPE_CHECKING:
    from testbed.identification.estimate import Estimate


WIDE = 110
"""Columns that the full table of results takes."""


class Progress:
    """A progress bar on standard error, if that is a terminal."""

    def __init__(self, label: str) -> None:
        """A bar with a label in front."""
        shown = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
        self._bar = Bar(*shown, console=Console(stderr=True), transient=True)
        self._bar.disable = not sys.stderr.isatty()
        self._task = self._bar.add_task(label)

    def __enter__(self) -> Progress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: int, total: int) -> None:
        """Show how much is done."""
        self._bar.update(self._task, completed=done, total=total)


def console() -> Console:
    """Standard output; 120 columns where it is no terminal."""
    plain = Console(markup=False, highlight=False)
    return plain if plain.is_terminal else Console(markup=False, highlight=False, width=120)


def print_json(value: dict[str, Any]) -> None:
    """Print for programs."""
    sys.stdout.write(json.dumps(value, indent=1, sort_keys=True) + "\n")


def print_estimates(estimates: list[Estimate], warnings: tuple[str, ...]) -> None:
    """Print what was found.

    Args:
        estimates: Of one recording.
        warnings: About the robot.
    """
    out = console()
    out.print(estimate_table(estimates, out.width < WIDE))
    for line in quality_lines(estimates):
        out.print(line, soft_wrap=True)
    print_warnings(out, (*warnings, *(d for e in estimates for d in e.warnings)))


def print_outcome(outcome: Any, folder: Path) -> None:
    """Print what came of an experiment.

    Args:
        outcome: `campaign.carry_out.Outcome`.
        folder: Where it is kept.
    """
    out = console()
    external, internal, title = outcome.external, outcome.internal, outcome.experiment.name
    out.print(result_table(external, internal, outcome.truths, title, out.width < WIDE))
    for line in quality_lines((external, internal)):
        out.print(line, soft_wrap=True)
    print_warnings(out, outcome.warnings)
    verdicts = outcome.verdicts
    for name, value in outcome.comparison.metrics.items():
        claim = ""
        if name in verdicts:
            wanted = outcome.experiment.expect[name].wanted
            claim = f"  ({wanted}: {'holds' if verdicts[name] else 'FAILS'})"
        out.print(f"{name:30s} {value:9.3g}{claim}")
    out.print(f"run folder: {folder}", soft_wrap=True)


def print_warnings(out: Console, warnings: tuple[str, ...]) -> None:
    """Print notes, a line each."""
    for warning in warnings:
        out.print(f"note: {warning}", style="yellow", soft_wrap=True)
