"""Commands about plate, drives and payload themselves: calibrate, drives, payload."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.identifications import Write, Writing
from testbed.cli.opening import opened
from testbed.cli.reading import (
    Force,
    Gravity,
    Json,
    Lock,
    LockMimic,
    Plate,
    Reading,
    RecordingSet,
    RobotModel,
    Sensor,
    Threads,
    Weld,
    Zeros,
    app,
    check_outputs,
    ending,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from testbed.applications.payload.payload import PayloadEstimate
    from testbed.core.base.diagnostics import Diagnostic
    from testbed.core.estimation.estimate import Method
    from testbed.core.robot.model_file import ModelFile
    from testbed.core.robot.repair import FileLink
    from testbed.core.robot.tree import Tree

Vendor = Annotated[
    str | None,
    typer.Option("--as", metavar="VENDOR", help="Print it for a controller: ur, franka or kuka."),
]
Flange = Annotated[
    str | None,
    typer.Option(metavar="LINK", help="With --as: link with the flange's frame, e.g. tool0."),
]


def flange_link(
    vendor: str | None, flange: str | None, file: ModelFile, tree: Tree
) -> FileLink | None:
    """The flange that is named for a controller, in a tree's bodies; None for none.

    Raises:
        SettingsError: A flange is named for no controller.
        UnknownName: There is no such controller or link.
    """
    from testbed.applications.payload.vendors import VENDORS
    from testbed.core.base.errors import SettingsError, UnknownName

    if vendor is not None and vendor not in VENDORS:
        raise UnknownName("controller", vendor, list(VENDORS))
    if flange is None:
        return None
    if vendor is None:
        raise SettingsError("--flange names the frame for --as: both are needed")
    links, joints = {x.name: x for x in file.links()}, dict(enumerate(file.tree().names))
    if flange not in links:
        raise UnknownName("link", flange, list(links))
    joint = joints.get(links[flange].body)
    return replace(links[flange], body=-1 if joint not in tree.names else tree.index(joint))


def print_for(
    vendor: str,
    found: PayloadEstimate,
    tree: Tree,
    link: FileLink | None,
    said: Iterable[Diagnostic],
) -> None:
    """A payload as a controller takes it, and warnings.

    Args:
        vendor: Whose.
        found: The payload.
        tree: The robot.
        link: The flange.
        said: What to know of it.
    """
    from testbed.applications.payload.vendors import VENDORS, at_flange
    from testbed.core.base.errors import printable

    typer.echo(VENDORS[vendor](at_flange(found, tree, link)))
    for each in said:
        kind = "note" if each.level == "info" else "warning"
        typer.echo(printable(f"{kind}: {each}"), err=True)


@app.command()
def calibrate(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Parquet file.")],
    model: RobotModel,
    known: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=VALUE[+-SIGMA]",
            help="A known value, e.g. mass=20, gain/Fz=1, centre/x=0.1; repeatable.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Calibration file to write, for --plate.")] = Path(
        "plate.toml"
    ),
    loaded: Annotated[
        Path | None,
        typer.Option(help="Of joint torques, with a payload: --known payload/mass=1.5."),
    ] = None,
    joint: Annotated[
        str | None,
        typer.Option(help="Joint that moves the link with the payload; default the last."),
    ] = None,
    settings: RecordingSet = None,
    zeros: Zeros = False,
    gravity: Gravity = None,
    weld_root: Weld = False,
    lock: Lock = None,
    lock_mimic: LockMimic = False,
    force: Force = False,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Calibrate the plate by the robot's own motion: sensitivities, zero, delay.

    Other numbers: --set 'identification.nuisances=["pose","skew"]'. Whether what is known
    suffices is found out before any data are read.

    With --loaded, the joint torques instead: RECORDING is without a known payload, the other one
    with it, and the two give the scale of every joint's torque.

    Example: testbed calibrate run.parquet --model robot.urdf --known mass=20 --known gain/Mx=1
    """
    from testbed.applications.calibration import calibrate as calibrated
    from testbed.applications.payload.torque_scales import torque_scales
    from testbed.core.base.codec import encode
    from testbed.core.base.errors import SettingsError
    from testbed.core.estimation.known import parse_known
    from testbed.lab.experiment.plate_file import write_plate
    from testbed.view import estimates as shown
    from testbed.view import output, terminal

    reading = Reading(settings, zeros, weld_root, lock, lock_mimic)
    if loaded is None:  # else scales are printed, and nothing is written
        check_outputs(out, force=force, read=(recording, model))
    if joint is not None and loaded is None:
        raise SettingsError("--joint names the link of --loaded: both are needed")
    said: list[Diagnostic] = []
    facts, source = parse_known(known), opened(recording)
    if loaded is None:
        reading, source, said = reading.holding(source, model, ())
    tree = reading.tree(model)
    table = reading.tables().identification
    how: dict[str, Any] = {"gravity": gravity, "settings": table, "threads": threads}
    if loaded is not None:
        with output.Progress("calibrating torques") as progress:
            scales = torque_scales(tree, source, loaded, facts, joint, progress=progress, **how)
        if as_json:
            output.print_json(encode(scales))
        else:
            output.print_tables(output.console(), [shown.scales_table(scales)])
        return
    with output.Progress("calibrating") as progress:
        plate = calibrated(tree, source, facts, progress=progress, **how)
    write_plate(plate, out)
    if as_json:
        output.print_json(encode(plate, exclude={"estimate": {"normal_equations"}}))
    else:
        terminal.print_plate(plate, [*tree.diagnostics, *said], out)


@app.command()
def drives(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Parquet file.")],
    model: RobotModel,
    settings: RecordingSet = None,
    zeros: Zeros = False,
    gravity: Gravity = None,
    weld_root: Weld = False,
    lock: Lock = None,
    lock_mimic: LockMimic = False,
    plate: Plate = None,
    sensor: Sensor = None,
    choose_terms: Annotated[
        bool,
        typer.Option("--choose-terms", help="Choose the terms of each joint by cross-validation."),
    ] = False,
    write: Write = None,
    unseen: Annotated[
        Path | None,
        typer.Option(help="With --write: another motion, whose torques drive the file in MuJoCo."),
    ] = None,
    commands: Annotated[
        bool,
        typer.Option("--commands", help="Torques are commands: find the delay of the drives, too."),
    ] = False,
    friction: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".csv", ".json"),
            help="File for friction: .csv (curve and law) or .json (BAM).",
        ),
    ] = None,
    force: Force = False,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Hold joint torques against the plate: torque constants, friction, rotors, joint by joint.

    The bodies are known from the plate; what a drive reports is a constant times the torque that
    they need and its own terms: --set 'identification.terms=["coulomb","viscous","rotor"]'.
    Friction over velocity is in the JSON, and drawn by report --set identification.drives=given.
    Laws of the load are load, viscous_load and others.

    --write copies the model file with consistent bodies by the plate, friction, rotors, and (MJCF)
    motors whose gear makes true torque of what the drive reports, with the delay of --commands.
    --unseen drives it open-loop by the torques of another motion, and the model file, too.

    Example: testbed drives run.parquet --model robot.urdf --choose-terms

    Example: testbed drives run.parquet --model arm.xml --write driven.xml --unseen other.parquet
    """
    from testbed.applications.drives.friction_files import write_friction
    from testbed.applications.drives.identify_drives import identify_drives
    from testbed.core.base.codec import encode
    from testbed.core.base.errors import SettingsError
    from testbed.core.base.files import together
    from testbed.core.estimation.identify import identify
    from testbed.importing.check.time_offset import delivered
    from testbed.view import output, terminal
    from testbed.view.drives import delay_line

    check_outputs(friction, force=force, read=(recording, model))
    reading = Reading(settings, zeros, weld_root, lock, lock_mimic, plate, sensor=sensor)
    writing = Writing(write=write, force=force)
    writing.check(reading, model, [recording])
    if unseen is not None and write is None:
        raise SettingsError("--unseen drives the file that --write writes")
    reading, source, held = reading.holding(opened(recording), model, ())
    reading = reading.with_sensors(source, alone=True)
    felt, table = reading.tree(model), reading.tables().identification
    if felt.sensor is not None and (write is not None or commands):
        raise SettingsError("--write and --commands need bodies by the plate, not by a sensor")
    tree = replace(reading, sensor=None).tree(model)
    source = reading.source(source, tree)
    how: dict[str, Any] = {"gravity": gravity, "settings": table, "threads": threads}
    with output.Progress("identifying by the wrench") as progress:
        bodies = identify(felt, source, doubt=reading.doubt(tree), progress=progress, **how)
    source, offset = delivered(tree, source, bodies) if commands else (source, None)
    late, lines = (0.0, []) if offset is None else (-offset.delay, [delay_line(offset)])
    choose = choose_terms or table.drives == "chosen"
    with output.Progress("regressing torques") as progress:
        found = identify_drives(tree, source, bodies, choose=choose, progress=progress, **how)
    said = [*tree.diagnostics, *held, *bodies.diagnostics, *found.diagnostics]
    with together():
        if friction is not None:
            write_friction(found, friction)
        if write is not None:
            links = writing.bodies(reading, model, source, [bodies])
            said += writing.written(links, reading, model, [recording], found, late)
            lines.append(f"model file: {write}")
    if write is not None and unseen is not None:
        lines += _replayed(reading, unseen, model, write)
    if as_json:
        output.print_json({**encode(found), "delay": late})
    else:
        terminal.print_drives(found, said)
        output.print_lines(lines, ())


def _replayed(reading: Reading, unseen: Path, model: Path, written: Path) -> list[str]:
    """How far a model file, and what was written, are from an unseen motion by its torques."""
    from testbed.core.recordings.recording import Recording
    from testbed.lab.simulation.replay import replay
    from testbed.view.drives import replay_lines

    motion = Recording.load(unseen)
    ends = [replay(reading.model_file(path), motion) for path in (model, written)]
    return replay_lines(reading.tree(model).names, *ends)


@app.command()
def payload(
    without: Annotated[
        Path, typer.Argument(metavar="WITHOUT", help="Recording without the payload.")
    ],
    loaded: Annotated[Path, typer.Argument(metavar="WITH", help="Recording with the payload.")],
    model: RobotModel,
    joint: Annotated[
        str | None,
        typer.Option(help="Joint that moves the link with the payload; default the last."),
    ] = None,
    settings: RecordingSet = None,
    gravity: Gravity = None,
    weld_root: Weld = False,
    lock: Lock = None,
    lock_mimic: LockMimic = False,
    plate: Plate = None,
    vendor: Vendor = None,
    flange: Flange = None,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Find a payload's mass, centre and inertia by two recordings, without it and with it.

    Its parameters, as far as the plate identifies them, or the joint torques of recordings without
    a plate.

    Example: testbed payload empty.parquet loaded.parquet --model robot.urdf

    Example: testbed payload empty.parquet loaded.parquet --model ur5e.urdf --as ur --flange tool0
    """
    from testbed.applications.payload.payload import payload as payload_of
    from testbed.core.base.codec import encode
    from testbed.core.base.errors import SettingsError
    from testbed.core.estimation.identify import identify
    from testbed.view import output, terminal

    reading = Reading(settings, False, weld_root, lock, lock_mimic, plate)
    if vendor is not None and as_json:
        raise SettingsError("--as and --json are two forms of one answer: give one of them")
    tree, table = reading.tree(model), reading.tables().identification
    link = flange_link(vendor, flange, reading.model_file(model), tree)
    sources = [reading.source(opened(path), tree) for path in (without, loaded)]
    plates = all("wrench" in source.signals for source in sources)
    method: Method = "external" if plates else "internal"
    how: dict[str, Any] = {"gravity": gravity, "settings": table, "threads": threads}
    doubt, estimates = reading.doubt(tree), []
    for source, name in zip(sources, ("without", "with"), strict=True):
        with output.Progress(f"identifying, {name}") as progress:
            made = identify(tree, source, method, doubt=doubt, progress=progress, **how)
            estimates.append(made)
    found = payload_of(tree, estimates[0], estimates[1], joint)
    known = [each for estimate in estimates for each in estimate.diagnostics]
    known = [each for each in known if each.code != "plate.no-tare"]  # the difference has none
    said = [*tree.diagnostics, *known, *found.diagnostics]
    if as_json:
        output.print_json(encode(found))
    elif vendor is not None:
        print_for(vendor, found, tree, link, said)
    else:
        terminal.print_payload(found, said)
