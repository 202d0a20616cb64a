"""Commands for the first hour: new, doctor."""

from __future__ import annotations

import tomllib
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
    strict: Annotated[
        bool,
        typer.Option("--strict", help="Refuse bodies that cannot be instead of repairing them."),
    ] = False,
    exact_torque_constants: Annotated[
        bool,
        typer.Option("--exact-torque-constants", help="Leave out the error assumed of them."),
    ] = False,
) -> None:
    """Write an experiment file for a robot, commented and ready to run.

    Limits and counts are the model file's; what it does not say is assumed, and marked. Bodies that
    no matter can make are repaired ([robot.repair]). A second of it is simulated before it is
    written. With --recording, a mapping that turns somebody's log into a recording.

    Example: testbed new models/puma562.xml
    """
    if robot is not None and recording is not None:
        raise typer.BadParameter("name a robot's model file or --recording FILE, not both")
    if robot is None and recording is None:
        raise typer.BadParameter("name a robot's model file, or --recording and a logger's file")
    source = robot or recording
    assert source is not None
    folder = out.parent if out else Path()
    if out:
        _check_free(out)
    if robot is None:
        path, text = out or Path(f"{source.stem}.toml"), _mapping(source, folder)
    else:
        text = _experiment(source, folder, strict, exact_torque_constants)
        path = out or Path(f"{tomllib.loads(text)['name']}.toml")
    _check_free(path)
    from testbed.files import replacing

    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
    further = (
        f"testbed run {path}" if robot else f"fill in what is empty, then testbed import {path}"
    )
    typer.echo(f"{path}: {further}")


def _check_free(path: Path) -> None:
    if path.exists():
        raise typer.BadParameter(f"{path} is there and is not replaced; choose another --out")


def _experiment(model: Path, folder: Path, strict: bool, exact: bool) -> str:
    from testbed.experiment.new_experiment import new_experiment

    return new_experiment(
        model, folder, strict=strict, exact_torque_constants=exact, say=typer.echo
    )


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
