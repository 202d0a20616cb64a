"""Commands for the first hour: new, doctor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.options import Json, app
from testbed.installation import own_or_shipped


@app.command()
def new(
    robot: Annotated[
        Path | None,
        typer.Argument(
            metavar="ROBOT", parser=own_or_shipped, help="MJCF or URDF file.", show_default=False
        ),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(help="Instead: a logger's file; writes a mapping for testbed import."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write; default NAME.toml here.")] = None,
) -> None:
    """Write an experiment file for a robot, commented and ready to run.

    Limits and counts are the model file's; what it does not say is assumed, and marked. With
    --recording, a mapping that turns somebody's log into a recording.

    Example: testbed new models/puma562.xml
    """
    if robot is not None and recording is not None:
        raise typer.BadParameter("name a robot's model file or --recording FILE, not both")
    if robot is None and recording is None:
        raise typer.BadParameter("name a robot's model file, or --recording and a logger's file")
    source = robot or recording
    assert source is not None
    path = out or Path(f"{source.stem}.toml")
    if path.exists():
        raise typer.BadParameter(f"{path} is there and is not replaced; choose another --out")
    from testbed.files import check_writable, replacing

    check_writable(path)
    text = _experiment(source, path.parent) if robot else _mapping(source, path.parent)
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
    further = (
        f"testbed run {path}" if robot else f"fill in what is empty, then testbed import {path}"
    )
    typer.echo(f"{path}: {further}")


def _experiment(model: Path, folder: Path) -> str:
    from testbed.experiment.new_experiment import new_experiment

    return new_experiment(model, folder)


def _mapping(file: Path, folder: Path) -> str:
    from testbed.recordings.importing.guess import guessed

    return guessed(file, folder)


@app.command()
def doctor(as_json: Json = False) -> None:
    """Say what is installed, what is missing and how to get it.

    Example: testbed doctor
    """
    from testbed.cli.checkup import checkup

    found = checkup()
    if as_json:
        from testbed.reporting import output

        output.print_json({"checks": [vars(each) for each in found]})
    else:
        typer.echo("\n".join(each.line for each in found))
    raise typer.Exit(0 if all(each.fine or not each.needed for each in found) else 1)
