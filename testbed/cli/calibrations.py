"""Commands about plate and drives themselves: calibrate, drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.options import (
    Accept,
    Gravity,
    Json,
    Lock,
    LockMimic,
    Plate,
    RecordingSet,
    Threads,
    Weld,
    Zeros,
    app,
)
from testbed.cli.reading import Reading


@app.command()
def calibrate(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Parquet file.")],
    model: Annotated[Path, typer.Option(help="MJCF or URDF file of the robot.")],
    known: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=VALUE[+-SIGMA]",
            help="What is known, as mass=20 or gain/Fz=1; again for more.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="File of the plate, for --plate.")] = Path("plate.toml"),
    settings: RecordingSet = None,
    zeros: Zeros = False,
    gravity: Gravity = None,
    weld_root: Weld = False,
    accept_inertia: Accept = False,
    lock: Lock = None,
    lock_mimic: LockMimic = False,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Calibrate the plate by the robot's own motion: sensitivities, zero, delay.

    Other numbers: --set 'identification.nuisances=["pose","skew"]'. Whether what is known
    suffices is found out before any data are read.

    Example: testbed calibrate run.parquet --model robot.urdf --known mass=20 --known gain/Fz=1
    """
    from testbed.experiment.plate_file import write_plate
    from testbed.identification.calibration import calibrate as calibrated
    from testbed.identification.known import parse_known
    from testbed.report import terminal
    from testbed.report.plate_tables import plate_as_json

    reading = Reading(settings, zeros, weld_root, accept_inertia, lock, lock_mimic)
    tree, facts = reading.tree(model), parse_known(known)
    with terminal.Progress("calibrating") as progress:
        plate = calibrated(
            tree,
            recording,
            facts,
            gravity=gravity,
            settings=reading.tables().identification,
            threads=threads,
            progress=progress,
        )
    write_plate(plate, out)
    if as_json:
        terminal.print_json(plate_as_json(plate))
    else:
        terminal.print_plate(plate, tree.warnings, out)


@app.command()
def drives(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Parquet file.")],
    model: Annotated[Path, typer.Option(help="MJCF or URDF file of the robot.")],
    settings: RecordingSet = None,
    zeros: Zeros = False,
    gravity: Gravity = None,
    weld_root: Weld = False,
    accept_inertia: Accept = False,
    lock: Lock = None,
    lock_mimic: LockMimic = False,
    plate: Plate = None,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Hold joint torques against the plate: torque constants, friction, rotors, joint by joint.

    The bodies are known from the plate; what a drive reports is a constant times the torque that
    they need and its own terms: --set 'identification.terms=["coulomb","viscous","rotor"]'.

    Example: testbed drives run.parquet --model robot.urdf
    """
    from testbed.identification.identify import identify
    from testbed.identification.torque_constants import drive_estimates
    from testbed.report import terminal
    from testbed.report.drive_table import drives_as_json

    reading = Reading(settings, zeros, weld_root, accept_inertia, lock, lock_mimic, plate)
    tree, table = reading.tree(model), reading.tables().identification
    source = reading.source(recording, tree)
    with terminal.Progress("identifying, external") as progress:
        bodies = identify(
            tree, source, gravity=gravity, settings=table, threads=threads, progress=progress
        )
    with terminal.Progress("regressing torques") as progress:
        found = drive_estimates(
            tree,
            source,
            bodies,
            gravity=gravity,
            settings=table,
            threads=threads,
            progress=progress,
        )
    if as_json:
        terminal.print_json(drives_as_json(found))
    else:
        terminal.print_drives(found, [*tree.warnings, *bodies.warnings])
