"""Commands for the first hour: new, and doctor, which says what an installation has and lacks."""

from __future__ import annotations

import os
import platform
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

from testbed.cli.importing import numbered, write_mapping
from testbed.cli.reading import Json, Lock, LockMimic, Reading, app
from testbed.installation import DISTRIBUTION, own_or_shipped
from testbed.installation import version as own_version

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
    """Everything that was looked at, what must be there first."""
    return [*_programs(), *_packages(), *_extras(), _kernel(), _viewer(), _folder()]


def _programs() -> Iterator[Check]:
    cores = os.cpu_count() or 1
    yield Check("testbed", f"{own_version()}, in {Path(__file__).parent.parent}")
    yield Check("Python", f"{platform.python_version()}, {sys.executable}")
    yield Check("machine", f"{platform.machine()}, {platform.system()}, {cores} processors")


def _packages() -> Iterator[Check]:
    """Packages that nothing works without."""
    for text in requires(DISTRIBUTION) or ():
        wanted = Requirement(text)
        if wanted.marker is None or wanted.marker.evaluate({"extra": ""}):
            fine, found = _there(wanted)
            remedy = f"pip install '{wanted.name}{wanted.specifier}'"
            yield Check(wanted.name, found, fine, True, remedy)


def _extras() -> Iterator[Check]:
    """Packages that only some commands need, extra by extra."""
    for extra in metadata(DISTRIBUTION).get_all("Provides-Extra") or ():
        if extra in NOT_FOR_USERS:
            continue
        wanted = [Requirement(text) for text in requires(DISTRIBUTION) or ()]
        own = [
            each
            for each in wanted
            if each.marker is not None
            and each.marker.evaluate({"extra": extra})
            and not each.marker.evaluate({"extra": ""})
        ]
        states = [_there(each) for each in own]
        found = ", ".join(f"{w.name} {s}" for w, (_, s) in zip(own, states, strict=True))
        remedy = f"from the project's folder, pip install -e '.[{extra}]'"
        yield Check(f"extra [{extra}]", found, all(fine for fine, _ in states), False, remedy)


def _there(wanted: Requirement) -> tuple[bool, str]:
    """Whether a package is there in a version that will do, and which."""
    try:
        found = version(wanted.name)
    except PackageNotFoundError:
        return False, "not installed"
    if wanted.specifier.contains(found, prereleases=True):
        return True, found
    return False, f"{found}, needed is {wanted.specifier}"


def _kernel() -> Check:
    """The compiled kernel's cache."""
    from testbed.kernel.compiler import cache_folder

    folder = cache_folder()
    if folder.is_relative_to(tempfile.gettempdir()):
        remedy = "make ~/.cache/testbed writable, and by you alone; else it is compiled every time"
        return Check("compiled kernel", f"kept in {folder}, for now", False, False, remedy)
    if any(folder.glob("**/*.nbi")):
        return Check("compiled kernel", f"ready, in {folder}")
    return Check("compiled kernel", f"not yet: the first run or estimate compiles it into {folder}")


def _viewer() -> Check:
    """Rerun's viewer, and a screen for it."""
    from testbed.viewer.live import has_screen, viewer_program

    program = viewer_program()
    if program is None:
        return Check("viewer", "no command 'rerun'", False, False, "pip install rerun-sdk")
    if not has_screen():
        return Check("viewer", f"{program}; no screen here: testbed view with --save or --serve")
    return Check("viewer", program)


def _folder() -> Check:
    """Whether runs can be written here."""
    here = Path.cwd()
    remedy = "work in a folder of your own, or give --out"
    return Check("this folder", str(here), os.access(here, os.W_OK), False, remedy)


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
    exact_torque_constants: Annotated[
        bool,
        typer.Option("--exact-torque-constants", help="Assume exact torque constants."),
    ] = False,
    lock: Lock = None,
    lock_mimic: LockMimic = False,
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
    from testbed.files import check_writable, replacing
    from testbed.reporting import output

    if out:
        check_writable(out, read=(robot, *(recording or ())))
        _check_free(out)
    reading = Reading(lock=lock, lock_mimic=lock_mimic)
    if recording:
        stem = recording[0].name.partition(".")[0]
        _recorded(recording, out or Path(f"{stem}.toml"), robot, reading)
        return
    assert robot is not None
    folder = out.parent if out else Path()
    with output.Progress("reading"):
        text = _experiment(robot, folder, strict, exact_torque_constants, reading)
    path = out or Path(f"{tomllib.loads(text)['name']}.toml")
    check_writable(path)
    _check_free(path)
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
    typer.echo(f"{path}: testbed run {path}")


def _recorded(files: list[Path], mapping: Path, robot: Path | None, reading: Reading) -> None:
    """A mapping for logs, and the recording that it makes of a robot."""
    from testbed.files import check_writable
    from testbed.plausibility.check import import_and_check
    from testbed.recordings.importing.import_report import ImportReport
    from testbed.reporting import output

    made = mapping.with_suffix(".parquet")
    for path in (mapping, made):
        check_writable(path, read=(robot, *files))
    _check_free(mapping)
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
    paths = numbered(made, len(several))
    for recording, path in zip(several, paths, strict=True):
        recording.save(path)
    listed, taken = (made, made) if len(paths) == 1 else (f"{paths[0]} to {paths[-1]}", mapping)
    last = f"{listed}: testbed identify {taken} --model {robot}"
    if several[0].wrench is not None:  # the plate's frame and clock are known to a sigma only
        last += """ --set 'identification.nuisances=["pose","skew"]'"""
    imported = ImportReport.from_dict(several[0].facts["import"]).diagnostics
    output.print_lines([last], [*cuts, *imported, *report.diagnostics])


def _check_free(path: Path) -> None:
    if path.exists():
        raise typer.BadParameter(f"{path} is there and is not replaced; choose another --out")


def _experiment(model: Path, folder: Path, strict: bool, exact: bool, reading: Reading) -> str:
    from testbed.experiment.new_experiment import new_experiment

    return new_experiment(
        model,
        folder,
        strict=strict,
        exact_torque_constants=exact,
        lock=reading.model_file(model).lock,
        say=typer.echo,
    )


@app.command()
def doctor(as_json: Json = False) -> None:
    """Say what is installed, what is missing and how to get it.

    Example: testbed doctor
    """
    found = checkup()
    if as_json:
        from testbed.reporting import output

        output.print_json({"checks": [vars(each) for each in found]})
    else:
        typer.echo("\n".join(each.line for each in found))
    raise typer.Exit(0 if all(each.fine or not each.needed for each in found) else 1)
