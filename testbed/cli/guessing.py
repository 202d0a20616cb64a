"""A mapping file for other programs' files, as import --guess and new --recording write it."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from testbed.recordings.importing.draft import Draft
    from testbed.robot.tree import Tree


def write_mapping(
    files: Sequence[Path], out: Path | None, model: Path | None, tree: Tree | None,
    page: Path | None = None, options: Sequence[str] = (),
) -> bool:  # fmt: skip
    """Write a mapping where it is wanted, or on standard output; say what to do with it.

    Args:
        files: Of other programs.
        out: Mapping file to write.
        model: The robot's file, if it is known.
        tree: The robot.
        page: HTML file to write of what was solved.
        options: Words of the command by which the model is read.

    Returns:
        Whether it is complete.

    Raises:
        typer.BadParameter: The mapping is there.
        RecordingError: The data are not of this robot.
    """
    from testbed.files import replacing
    from testbed.recordings.importing.guess import guessed
    from testbed.reporting import output
    from testbed.sanity.hypotheses import own_joints
    from testbed.sanity.mapping_solution import missing, solve_mapping

    if out is not None and out.exists():
        raise typer.BadParameter(f"--out {out} is there; a mapping is not replaced")
    folder = out.parent if out else Path()
    with output.Progress("reading"):
        draft = guessed(
            files, folder, () if tree is None else [tree.names[k] for k in own_joints(tree)]
        )
    if tree is not None:
        with output.Progress("solving for what names do not tell") as bar:
            found = solve_mapping(draft, out or folder / "mapping.toml", tree, bar)
        draft = found.draft
        output.print_lines((), found.diagnostics)
        if page is not None:
            from testbed.reporting.mapping import write_mapping_page

            write_mapping_page(page, found)
    if out is None:
        typer.echo(draft.text, nl=False)
        return False
    if tree is not None:
        _show(draft)
    with replacing(out) as fresh:
        fresh.write_text(draft.text, encoding="utf-8")
    empty = missing(draft)
    fill = f"fill in what is empty ({', '.join(empty)}), then " if empty else ""
    words = ["import", out, "--out", out.with_suffix(".parquet"), "--model", model or "ROBOT"]
    typer.echo(f"{out}: {fill}testbed {shlex.join(map(str, [*words, *options]))}")
    return not empty


def _show(draft: Draft) -> None:
    """What was solved; on a terminal a person says yes to it."""
    from testbed.reporting import output
    from testbed.reporting.mapping import solved_table

    output.print_tables(output.console(), [solved_table(draft)])
    if sys.stdin.isatty() and sys.stdout.isatty():
        typer.confirm("Write it so?", default=True, abort=True)
