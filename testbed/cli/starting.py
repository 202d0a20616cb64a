"""Commands for first steps: new, and doctor, which checks the installation."""

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
from testbed.cli.options import Force, Json, OptionFields, check_outputs, command
from testbed.cli.reading import ReadingOptions
from testbed.core.base.installation import (
    DISTRIBUTION,
    installed_version,
    user_or_shipped_file,
)

DEVELOPMENT_EXTRA = "dev"
"""Extra of packages for development only."""


@dataclass(frozen=True)
class InstallationCheck:
    """Check of one package in the installation.

    Attributes:
        name: Name of the package.
        found: Installed version, "not installed", or version with path.
        fine: True if the installed version satisfies the requirement.
        needed: True if all commands need the package.
        remedy: Command that installs the package.
    """

    name: str
    found: str
    fine: bool = True
    needed: bool = True
    remedy: str = ""

    @property
    def line(self) -> str:
        """Line with "ok", "MISSING" or "-" (optional package), name, version and remedy."""
        mark = "ok" if self.fine else ("MISSING" if self.needed else "-")
        remedy = "" if self.fine else f": {self.remedy}"
        return f"{mark:8s}{self.name:22s}{self.found}{remedy}"


def installation_checks() -> Iterator[InstallationCheck]:
    """Yield the checks of testbed, of Python, and of the packages that testbed requires.

    Packages that only the extra `DEVELOPMENT_EXTRA` requires are left out. Packages of other extras
    are optional.
    """
    yield InstallationCheck(
        "testbed", f"{installed_version()}, in {Path(__file__).parent.parent}"
    )
    yield InstallationCheck("Python", f"{platform.python_version()}, {sys.executable}")
    for each in map(Requirement, requires(DISTRIBUTION) or ()):
        needed = each.marker is None or each.marker.evaluate({"extra": ""})
        if needed or not (
            each.marker and each.marker.evaluate({"extra": DEVELOPMENT_EXTRA})
        ):
            installed = _installed_version(each.name)
            fine = (
                each.specifier.contains(installed, prereleases=True)
                if installed
                else False
            )
            remedy = f"pip install '{each.name}{each.specifier}'"
            yield InstallationCheck(
                each.name, installed or "not installed", fine, needed, remedy
            )


def _installed_version(name: str) -> str:
    """Version of an installed package; "" if the package is not installed."""
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
            parser=user_or_shipped_file,
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
        Path | None,
        typer.Option(help="File to write; default NAME.toml in this folder."),
    ] = None,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict", help="Refuse impossible bodies instead of repairing them."
        ),
    ] = False,
    reading: Annotated[
        ReadingOptions, OptionFields("gravity", "lock", "lock_mimic", "leave_out")
    ],
    force: Force = False,
) -> None:
    """Write an experiment file for a robot, commented and ready to run.

    Limits and counts are the model file's; missing values are assumed, and marked. Bodies that
    are physically impossible are repaired ([robot.repair]). One second is simulated as a test.
    With --recording, write a mapping that converts log files into a recording; with ROBOT, keys
    that column names do not give are solved from the data, and the recording is written. Joints
    that the log lacks, such as a gripper's, are locked at rest.

    Example: testbed new models/puma562.xml
    """
    if robot is None and not recording:
        raise typer.BadParameter(
            "name a robot's model file, or --recording and a logger's file"
        )
    from testbed.core.base.whole_files import write_atomically
    from testbed.view import output

    check_outputs(out, force=force, read=(robot, *(recording or ())))
    reading = replace(reading, model=robot)
    if reading.gravity is not None and not recording:
        raise typer.BadParameter(
            "--gravity is of a log: --recording goes with it; an experiment file has gravity = ..."
        )
    if recording:
        stem = recording[0].name.partition(".")[0]
        _write_mapping_and_recording(
            recording, out or Path(f"{stem}.toml"), reading, force=force
        )
        return
    assert robot is not None
    from testbed.lab.experiment.new_experiment import new_experiment

    with output.Progress("reading"):
        text = new_experiment(
            robot,
            out.parent if out else Path(),
            strict=strict,
            lock=reading.file.lock,
            report_line=typer.echo,
        )
    path = out or Path(f"{tomllib.loads(text)['name']}.toml")
    check_outputs(path, force=force, read=(robot,))
    write_atomically(path, text)
    typer.echo(f"{path}: testbed run {path}")


def _write_mapping_and_recording(
    files: list[Path], mapping: Path, reading: ReadingOptions, *, force: bool
) -> None:
    """Write a mapping for log files and, if a model is given, the checked recording.

    The recording is not written if keys of the mapping remain empty. Diagnostics and the next
    command, `testbed identify`, are printed.

    Args:
        files: Log files.
        mapping: Mapping file to write. The recording has the same name with the suffix .parquet, or
            the name NAME_recording.parquet if the former is a log file.
        reading: Options of the robot's model file; without a model, only the mapping is written.
        force: True if existing files may be replaced.

    Raises:
        RecordingError: The data contradict the mapping or the robot.
    """
    from testbed.importing.convert import joined_recording
    from testbed.importing.import_report import ImportReport
    from testbed.view import output

    robot, recording_path = reading.model, mapping.with_suffix(".parquet")
    if any(recording_path.resolve() == each.resolve() for each in files):
        recording_path = recording_path.with_stem(f"{recording_path.stem}_recording")
    outputs = (mapping,) if robot is None else (mapping, recording_path)
    check_outputs(*outputs, force=force, read=(robot, *files))
    solution = write_mapping(files, mapping, reading)
    if solution is None or robot is None:
        return
    recordings, cuts, report = checked_import(
        mapping, reading, prepared=solution.prepared
    )
    joined_recording(recordings, cuts).save(recording_path)
    command_words = ["identify", recording_path, "--model", robot]
    # the plate's frame and clock have uncertainties, which identify estimates
    if recordings[0].wrench is not None:
        command_words += ["--set", 'identification.nuisances=["pose","skew"]']
    command_words += [
        word for each in reading.leave_out or () for word in ("--leave-out", each)
    ]
    import_diagnostics = ImportReport.from_dict(
        recordings[0].metadata.report
    ).diagnostics
    diagnostics = [*cuts, *import_diagnostics, *report.diagnostics]
    output.print_result(
        lines=[f"{recording_path}: testbed {shlex.join(map(str, command_words))}"],
        diagnostics=[each for each in diagnostics if each not in solution.diagnostics],
    )


@command()
def doctor(
    compile_: Annotated[
        bool,
        typer.Option("--compile", help="Compile the kernel ahead of its first use."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Print installed and missing packages, and commands to install these.

    Example: testbed doctor --compile
    """
    if compile_:
        from testbed.core.kernel.warm_up import warm_up
        from testbed.view import output

        with output.Progress("compiling"):
            warm_up()
    checks = list(installation_checks())
    if as_json:
        from testbed.view import output

        output.print_json({"checks": [vars(each) for each in checks]})
    else:
        typer.echo("\n".join(each.line for each in checks))
    raise typer.Exit(0 if all(each.fine or not each.needed for each in checks) else 1)
