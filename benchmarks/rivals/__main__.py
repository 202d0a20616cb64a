"""Other tools on the same recordings: docs/rivals.md."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from benchmarks.rivals.compare import GOAL, rivals


def main(
    folder: Annotated[
        Path | None, typer.Argument(help="Of recordings and answers, resumed; default none kept.")
    ] = None,
    python: Annotated[
        list[str] | None, typer.Option(help="figaroh, idyntree, mujoco: NAME=INTERPRETER.")
    ] = None,
    draws: Annotated[int, typer.Option(min=1, help="Of every robot and noise.")] = 20,
    jobs: Annotated[int, typer.Option(help="Processes at a time.")] = 2,
    docs: Annotated[bool, typer.Option("--docs", help="Write docs/rivals.md.")] = False,
) -> None:
    """Other tools on the same recordings; exit code 1 if testbed's answers are poor."""
    pythons = dict(each.split("=", 1) for each in python or ())
    with TemporaryDirectory() as unkept:
        over = rivals(folder or Path(unkept) / "set", pythons, draws, jobs, docs)
    raise typer.Exit(int(over > GOAL))
