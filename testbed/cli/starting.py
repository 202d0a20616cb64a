"""Commands for the first hour: new, and doctor, which says what an installation has and lacks."""

from __future__ import annotations

import platform
import shlex
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path
from typing import Annotated

import typer
from packaging.requirements import Requirement

from testbed.cli.importing import save_pieces, write_mapping
from testbed.cli.reading import Force, Json, Lock, LockMimic, Reading, app, check_outputs
from testbed.core.base.installation import DISTRIBUTION, own_or_shipped
from testbed.core.base.installation import version as own_version

NOT_FOR_USERS = ("dev",)
"""Extras for those who work on the program itself."""


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
    needed: bool = False
    remedy: str = ""

    @property
    def line(self) -> str:
        """For people."""
        mark = "ok" if self.fine else ("MISSING" if self.needed else "-")
        remedy = "" if self.fine or not self.remedy else f": {self.remedy}"
        return f"{mark:8s}{self.name:22s}{self.found}{remedy}"


def checkup() -> list[Check]:
    """Version and Python, packages, extras, the kernel's cache, the viewer."""
    found = f"{own_version()}, in {Path(__file__).parent.parent}"
    python = f"{platform.python_version()}, {sys.executable}"
    return [Check("testbed", found), Check("Python", python), *_packages(), _kernel(), _viewer()]


def _packages() -> Iterator[Check]:
    """Packages that nothing works without; then those that only some commands need, by extra."""
    wanted = [Requirement(text) for text in requires(DISTRIBUTION) or ()]
    needed = [each for each in wanted if each.marker is None or each.marker.evaluate({"extra": ""})]
    for each in needed:
        fine, found = _installed(each)
        yield Check(each.name, found, fine, True, f"pip install '{each.name}{each.specifier}'")
    for extra in metadata(DISTRIBUTION).get_all("Provides-Extra") or ():
        own = {
            each.name: _installed(each)
            for each in wanted
            if each not in needed and each.marker and each.marker.evaluate({"extra": extra})
        }
        if extra not in NOT_FOR_USERS:
            fine = all(there for there, _ in own.values())
            found = ", ".join(f"{name} {state}" for name, (_, state) in own.items())
            remedy = f"from the project's folder, pip install -e '.[{extra}]'"
            yield Check(f"extra [{extra}]", found, fine, False, remedy)


def _installed(wanted: Requirement) -> tuple[bool, str]:
    """Whether a package is there in a version that will do, and which."""
    try:
        found = version(wanted.name)
    except PackageNotFoundError:
        return False, "not installed"
    fine = wanted.specifier.contains(found, prereleases=True)
    return fine, found if fine else f"{found}, needed is {wanted.specifier}"


def _kernel() -> Check:
    """The compiled kernel's cache."""
    from testbed.core.kernel.compiler import compiled_folder

    folder = compiled_folder()
    if folder.is_relative_to(tempfile.gettempdir()):
        remedy = "make ~/.cache/testbed writable, and by you alone; else it is compiled every time"
        return Check("compiled kernel", f"kept in {folder}, for now", False, False, remedy)
    state = "ready" if any(folder.glob("**/*.nbi")) else "the first run or estimate compiles it"
    return Check("compiled kernel", f"{state}, in {folder}")


def _viewer() -> Check:
    """Rerun's viewer, and a screen for it."""
    from testbed.view.viewer.live import has_screen, viewer_program

    program = viewer_program()
    screen = "" if has_screen() else "; no screen here: testbed view with --save or --serve"
    found = f"{program}{screen}" if program else "no command 'rerun'"
    return Check("viewer", found, bool(program), False, "pip install rerun-sdk")


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
        typer.Option(help="A logger's file instead: writes a mapping; repeatable."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write; default NAME.toml here.")] = None,
    strict: Annotated[
        bool,
        typer.Option("--strict", help="Refuse impossible bodies instead of repairing them."),
    ] = False,
    lock: Lock = None,
    lock_mimic: LockMimic = False,
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
        raise typer.BadParameter("name a robot's model file, or --recording and a logger's file")
    from testbed.core.base.files import replacing
    from testbed.view import output

    check_outputs(out, force=force, read=(robot, *(recording or ())))
    reading = Reading(lock=lock, lock_mimic=lock_mimic)
    if recording:
        stem = recording[0].name.partition(".")[0]
        _recorded(recording, out or Path(f"{stem}.toml"), robot, reading, force=force)
        return
    assert robot is not None
    folder = out.parent if out else Path()
    with output.Progress("reading"):
        text = _experiment(robot, folder, strict, reading)
    path = out or Path(f"{tomllib.loads(text)['name']}.toml")
    check_outputs(path, force=force, read=(robot,))
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
    typer.echo(f"{path}: testbed run {path}")


def _recorded(
    files: list[Path], mapping: Path, robot: Path | None, reading: Reading, *, force: bool
) -> None:
    """Write a mapping for logs, and the recording that it makes of a robot."""
    from testbed.importing.check.check import import_and_check
    from testbed.importing.import_report import ImportReport
    from testbed.view import output

    made = mapping.with_suffix(".parquet")
    if any(made.resolve() == each.resolve() for each in files):
        made = made.with_stem(f"{made.stem}_recording")
    written = (mapping,) if robot is None else (mapping, made)
    check_outputs(*written, force=force, read=(robot, *files))
    found = write_mapping(files, mapping, robot, reading)
    if found is None or robot is None:
        return
    with output.Progress("importing, checking against the robot") as bar:
        several, cuts, report = import_and_check(
            mapping,
            lambda one: reading.robot_of(one, robot)[1:],
            progress=bar,
            assessment=found.assessment,
        )
    paths = save_pieces(several, made, force=force)
    listed, taken = (made, made) if len(paths) == 1 else (f"{paths[0]} to {paths[-1]}", mapping)
    words = ["identify", taken, "--model", robot]
    if several[0].wrench is not None:  # the plate's frame and clock are known to a sigma only
        words += ["--set", 'identification.nuisances=["pose","skew"]']
    last = f"{listed}: testbed {shlex.join(map(str, words))}"
    imported = ImportReport.from_dict(several[0].facts["import"]).diagnostics
    said = [*cuts, *imported, *report.diagnostics]
    output.print_lines([last], [each for each in said if each not in found.diagnostics])


def _experiment(model: Path, folder: Path, strict: bool, reading: Reading) -> str:
    from testbed.lab.experiment.new_experiment import new_experiment

    return new_experiment(
        model,
        folder,
        strict=strict,
        lock=reading.model_file(model).lock,
        say=typer.echo,
    )


@app.command()
def doctor(
    compile_: Annotated[
        bool, typer.Option("--compile", help="Compile the kernel ahead of its first use.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Say what is installed, what is missing and how to get it.

    Example: testbed doctor --compile
    """
    if compile_:
        from testbed.core.kernel.numba_engine import warm_up
        from testbed.view import output

        with output.Progress("compiling"):
            warm_up()
    found = checkup()
    if as_json:
        from testbed.view import output

        output.print_json({"checks": [vars(each) for each in found]})
    else:
        typer.echo("\n".join(each.line for each in found))
    raise typer.Exit(0 if all(each.fine or not each.needed for each in found) else 1)
