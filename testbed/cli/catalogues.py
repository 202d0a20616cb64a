"""Commands that list what can be asked for: faults of instruments, effects in the plant."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import app

if TYPE_CHECKING:
    from testbed.kind_table import Entry

Kind = Annotated[str | None, typer.Argument(metavar="KIND", help="One of them, with its keys.")]


@app.command()
def faults(kind: Kind = None) -> None:
    """List what may be wrong with encoders, drives and plate in an experiment.

    Example: testbed faults plate_pose
    """
    from testbed.instruments.faults import KINDS, fault_named
    from testbed.kind_table import in_words

    if kind is None:
        _list(map(in_words, KINDS.values()), "faults")
    else:
        _describe(in_words(fault_named(kind)), "[measurement] fault")


@app.command()
def effects(kind: Kind = None) -> None:
    """List what else may be in the plant of an experiment: friction, rotors, payload, supports.

    Example: testbed effects lugre_friction
    """
    from testbed.kind_table import in_words
    from testbed.simulation.effects import EFFECTS, effect_named

    if kind is None:
        _list(map(in_words, EFFECTS), "effects")
    else:
        _describe(in_words(effect_named(kind)), "[simulation] effect")


def _list(entries: Iterable[Entry], command: str) -> None:
    for entry in entries:
        typer.echo(f"{entry.kind:26s}{entry.summary}")
    typer.echo(f"\nOne of them, with its keys: testbed {command} KIND")


def _describe(entry: Entry, key: str) -> None:
    typer.echo("\n".join(filter(None, (entry.summary, entry.details))))
    for name, default, meaning in entry.keys:
        typer.echo(f"  {name} = {default}: {meaning}")
    typer.echo(f"Source of the size: {entry.source}")
    typer.echo(f"In an experiment: {key} = [{entry.example}]")
