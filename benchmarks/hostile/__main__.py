"""Hostile inputs and killed writers, through the real commands."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from benchmarks.hostile.inputs import KINDS
from benchmarks.hostile.kills import kills as faults_of_writers
from benchmarks.hostile.program import Worker, hostile
from benchmarks.lines import print_lines


def main(
    inputs: Annotated[int, typer.Option(help="Of each kind.")] = 1000,
    kills: Annotated[int, typer.Option(help="Writers that are killed.")] = 60,
    seed: Annotated[int, typer.Option(help="Of all choices.")] = 0,
    only: Annotated[str, typer.Option(help="Only kinds whose names hold this.")] = "",
    seconds: Annotated[float, typer.Option(help="Of all inputs; 0 for no limit.")] = 0.0,
) -> None:
    """Hostile inputs through the real commands; exit code 1 if one is not treated well."""
    kinds = [kind for kind in KINDS if only in kind]
    each = seconds / max(len(kinds), 1) or math.inf
    with Worker() as worker:
        lines = print_lines(hostile(worker, kind, inputs, seed, each) for kind in kinds)
    if kills:
        lines += print_lines([faults_of_writers(kills, seed)])
    raise typer.Exit(int(any(line["not treated well"] for line in lines)))
