"""Commands for the first hour: new, and doctor, which says what an installation has and lacks."""

from __future__ import annotations

import platform
import shlex
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Annotated

import typer
from packaging.requirements import Requirement

from testbed.cli.importing import checked_import, write_mapping
from testbed.cli.options import Fields, Force, Json, check_outputs, command
from testbed.cli.reading import Reading
from testbed.core.base.installation import DISTRIBUTION, own_or_shipped
from testbed.core.base.installation import version as own_version

NOT_FOR_USERS = "dev"
"""Extra for those who work on the program itself."""


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: Of it.
        found: What is there.
        fine: Whether that will do.
        needed: Whether nothing works without it.
        remedy: What to do where it is not fine.
    """

    name: str
    found: str
    fine: bool = True
    needed: bool = True
    remedy: str = ""

    @property
    def line(self) -> str:
        """For people."""
        mark = "ok" if self.fine else ("MISSING" if self.needed else "-")
        remedy = "" if self.fine else f": {self.remedy}"
        return f"{mark:8s}{self.name:22s}{self.found}{remedy}"


def checkup() -> Iterator[Check]:
    """Version, Python and packages: those that all needs, and those that some commands need."""
    yield Check("testbed", f"{own_version()}, in {Path(__file__).parent.parent}")
    yield Check("Python", f"{platform.python_version()}, {sys.executable}")
    for each in map(Requirement, requires(DISTRIBUTION) or ()):
        needed = each.marker is None or each.marker.evaluate({"extra": ""})
        if needed or not (
            each.marker and each.marker.evaluate({"extra": NOT_FOR_USERS})
        ):
            found = _installed(each.name)
            fine = each.specifier.contains(found, prereleases=True) if found else False
            remedy = f"pip install '{each.name}{each.specifier}'"
            yield Check(each.name, found or "not installed", fine, needed, remedy)


def _installed(name: str) -> str:
    """The version of a package; empty where it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


@command()
def new(
    robot: Annotated[
        Path | None,
        typer.Argument(
            metavar="ROBOT",
            parser=own_or_shipped,
            help="MJCF or URDF file.",
            show_default=False,
        ),
    ] = None,
    *,
    recording: Annotated[
        list[Path] | None,
        typer.Option(help="A logger's file instead: writes a mapping; repeatable."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File to write; default NAME.toml here.")
    ] = None,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict", help="Refuse impossible bodies instead of repairing them."
        ),
    ] = False,
    reading: Annotated[Reading, Fields("gravity", "lock", "lock_mimic", "leave_out")],
    force: Force = False,
) -> None:
    """Write an experiment file for a robot, commented and ready to run.

    Limits and counts are the model file's; what it does not say is assumed, and marked. Bodies that
    are physically impossible are repaired ([robot.repair]). A second of it is simulated first.
    With --recording, a mapping that turns somebody's logs into a recording; if ROBOT is
    named, what names do not state is solved from the data, and the recording is made. Joints that
    the log lacks, as of a gripper, are held at rest.

    Example: testbed new models/puma562.xml
    """
    if robot is None and not recording:
        raise typer.BadParameter(
            "name a robot's model file, or --recording and a logger's file"
        )
    from testbed.core.base.whole_files import write_whole
    from testbed.view import output

    check_outputs(out, force=force, read=(robot, *(recording or ())))
    reading = replace(reading, model=robot)
    if reading.gravity is not None and not recording:
        raise typer.BadParameter(
            "--gravity is of a log: --recording goes with it; an experiment file has gravity = ..."
        )
    if recording:
        stem = recording[0].name.partition(".")[0]
        _recorded(recording, out or Path(f"{stem}.toml"), reading, force=force)
        return
    assert robot is not None
    from testbed.lab.experiment.new_experiment import new_experiment

    with output.Progress("reading"):
        text = new_experiment(
            robot,
            out.parent if out else Path(),
            strict=strict,
            lock=reading.file.lock,
            say=typer.echo,
        )
    path = out or Path(f"{tomllib.loads(text)['name']}.toml")
    check_outputs(path, force=force, read=(robot,))
    write_whole(path, text)
    typer.echo(f"{path}: testbed run {path}")


def _recorded(
    files: list[Path], mapping: Path, reading: Reading, *, force: bool
) -> None:
    """Write a mapping for logs, and the recording that it makes of a robot."""
    from testbed.importing.convert import concatenated
    from testbed.importing.import_report import ImportReport
    from testbed.view import output

    robot, made = reading.model, mapping.with_suffix(".parquet")
    if any(made.resolve() == each.resolve() for each in files):
        made = made.with_stem(f"{made.stem}_recording")
    written = (mapping,) if robot is None else (mapping, made)
    check_outputs(*written, force=force, read=(robot, *files))
    solution = write_mapping(files, mapping, reading)
    if solution is None or robot is None:
        return
    recordings, cuts, report = checked_import(
        mapping, reading, prepared=solution.prepared
    )
    concatenated(recordings, cuts).save(made)
    words = ["identify", made, "--model", robot]
    # the plate's frame and clock are known to a sigma only
    if recordings[0].wrench is not None:
        words += ["--set", 'identification.nuisances=["pose","skew"]']
    words += [
        word for each in reading.leave_out or () for word in ("--leave-out", each)
    ]
    imported = ImportReport.from_dict(recordings[0].metadata.report).diagnostics
    said = [*cuts, *imported, *report.diagnostics]
    output.print_result(
        lines=[f"{made}: testbed {shlex.join(map(str, words))}"],
        diagnostics=[each for each in said if each not in solution.diagnostics],
    )


@command()
def doctor(
    compile_: Annotated[
        bool,
        typer.Option("--compile", help="Compile the kernel ahead of its first use."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Say what is installed, what is missing and how to get it.

    Example: testbed doctor --compile
    """
    if compile_:
        from testbed.core.kernel.warm_up import warm_up
        from testbed.view import output

        with output.Progress("compiling"):
            warm_up()
    found = list(checkup())
    if as_json:
        from testbed.view import output

        output.print_json({"checks": [vars(each) for each in found]})
    else:
        typer.echo("\n".join(each.line for each in found))
    raise typer.Exit(0 if all(each.fine or not each.needed for each in found) else 1)
