"""Commands for the first hour: new, doctor."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.options import Json, app
from testbed.cli.reading import to_fill_in
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
    written. With --recording, a mapping that turns somebody's log into a recording, of ROBOT if it
    is named.

    Example: testbed new models/puma562.xml
    """
    if robot is None and recording is None:
        raise typer.BadParameter("name a robot's model file, or --recording and a logger's file")
    source = recording or robot
    assert source is not None
    from testbed.files import check_writable, replacing
    from testbed.reporting import output

    if out:
        check_writable(out)
        _check_free(out)
    folder = out.parent if out else Path()
    with output.Progress("reading"):
        if recording is not None:
            path, text = out or Path(f"{source.stem}.toml"), _mapping(source, robot, folder)
        else:
            text = _experiment(source, folder, strict, exact_torque_constants)
            path = out or Path(f"{tomllib.loads(text)['name']}.toml")
    check_writable(path)
    _check_free(path)
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
    typer.echo(to_fill_in(path, robot) if recording else f"{path}: testbed run {path}")


def _check_free(path: Path) -> None:
    if path.exists():
        raise typer.BadParameter(f"{path} is there and is not replaced; choose another --out")


def _experiment(model: Path, folder: Path, strict: bool, exact: bool) -> str:
    from testbed.experiment.new_experiment import new_experiment

    return new_experiment(
        model, folder, strict=strict, exact_torque_constants=exact, say=typer.echo
    )


def _mapping(file: Path, robot: Path | None, folder: Path) -> str:
    from testbed.cli.reading import Reading
    from testbed.recordings.importing.guess import guessed

    return guessed([file], folder, Reading().tree(robot).names if robot else ()).text


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
