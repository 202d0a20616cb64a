"""What commands write to the terminal: progress, lines, JSON, warnings. Quick to import."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from testbed.errors import printable


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

    def with_best(self, done: int, total: int, best: float) -> None:
        """Show how much is done, and the relative sigma of the best motion so far."""
        said = f"searching, best sigma so far {best:.3g}" if done else "searching"
        self._bar.update(self._task, completed=done, total=total, description=said)


def console() -> Console:
    """Standard output; 120 columns where it is no terminal and nobody says otherwise."""
    plain = Console(markup=False, highlight=False)
    if plain.is_terminal or "COLUMNS" in os.environ:
        return plain
    return Console(markup=False, highlight=False, width=120)


def print_json(value: dict[str, Any]) -> None:
    """Print for programs."""
    sys.stdout.write(json.dumps(value, indent=1, sort_keys=True) + "\n")


def print_lines(lines: Sequence[str], warnings: Sequence[str]) -> None:
    """Print sentences.

    Args:
        lines: One each.
        warnings: What a careful reader should know.
    """
    out = console()
    for line in lines:
        out.print(line, soft_wrap=True)
    print_warnings(out, warnings)


def print_warnings(out: Console, warnings: Iterable[str]) -> None:
    """Print warnings, a line each, none twice."""
    for warning in dict.fromkeys(warnings):
        out.print(f"warning: {printable(warning)}", style="yellow", soft_wrap=True)
