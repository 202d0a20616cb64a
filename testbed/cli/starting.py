"""Commands for the first hour: new, doctor."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.guessing import write_mapping
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
        list[Path] | None,
        typer.Option(help="Instead: a logger's file, again for more; writes a mapping for it."),
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
    written. With --recording, a mapping that turns somebody's logs into a recording; if ROBOT is
    named, what names do not tell is solved from the data, and the recording is made.

    Example: testbed new models/puma562.xml
    """
    if robot is None and not recording:
        raise typer.BadParameter("name a robot's model file, or --recording and a logger's file")
    from testbed.files import check_writable, replacing
    from testbed.reporting import output

    if out:
        check_writable(out, read=(robot, *(recording or ())))
        _check_free(out)
    if recording:
        _recorded(recording, out or Path(f"{recording[0].stem}.toml"), robot)
        return
    assert robot is not None
    folder = out.parent if out else Path()
    with output.Progress("reading"):
        text = _experiment(robot, folder, strict, exact_torque_constants)
    path = out or Path(f"{tomllib.loads(text)['name']}.toml")
    check_writable(path)
    _check_free(path)
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
    typer.echo(f"{path}: testbed run {path}")


def _recorded(files: list[Path], mapping: Path, robot: Path | None) -> None:
    """A mapping for logs, and the recording that it makes of a robot."""
    from testbed.cli.reading import Reading
    from testbed.files import check_writable
    from testbed.reporting import output
    from testbed.sanity.check import import_and_check

    made = mapping.with_suffix(".parquet")
    for path in (mapping, made):
        check_writable(path, read=(robot, *files))
    _check_free(mapping)
    tree = None if robot is None else Reading().tree(robot)
    if not write_mapping(files, mapping, robot, tree) or tree is None:
        return
    with output.Progress("importing, holding it against the robot") as bar:
        several, _, found = import_and_check(mapping, tree, progress=bar)
    recording = max(several, key=lambda each: each.samples)
    recording.save(made)
    last = f"{made}: testbed identify {made} --model {robot}"
    if recording.wrench is not None:  # the plate's frame and clock are known to a sigma only
        last += """ --set 'identification.nuisances=["pose","skew"]'"""
    output.print_lines([last], found.diagnostics)


def _check_free(path: Path) -> None:
    if path.exists():
        raise typer.BadParameter(f"{path} is there and is not replaced; choose another --out")


def _experiment(model: Path, folder: Path, strict: bool, exact: bool) -> str:
    from testbed.experiment.new_experiment import new_experiment

    return new_experiment(
        model, folder, strict=strict, exact_torque_constants=exact, say=typer.echo
    )


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
