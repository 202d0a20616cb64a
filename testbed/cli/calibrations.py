"""Commands about plate, drives and payload themselves: calibrate, drives, payload."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.identifications import Writing
from testbed.cli.opening import opened
from testbed.cli.options import (
    Fields,
    Force,
    Json,
    RobotModel,
    check_outputs,
    command,
    ending,
)
from testbed.cli.reading import Reading
from testbed.core.base.errors import SettingsError, UnknownName, printable

if TYPE_CHECKING:
    from testbed.applications.payload.payload import PayloadEstimate
    from testbed.core.base.diagnostics import Diagnostic
    from testbed.core.estimation.estimate import Method
    from testbed.core.robot.repair import FileLink
    from testbed.core.robot.tree import Tree


@dataclass(frozen=True)
class PayloadOutput:
    """Options of the form in which a payload is printed."""

    vendor: Annotated[
        str | None,
        typer.Option(
            "--as",
            metavar="VENDOR",
            help="Print it for a controller: ur, franka or kuka.",
        ),
    ] = None
    flange: Annotated[
        str | None,
        typer.Option(
            metavar="LINK", help="With --as: link with the flange's frame, e.g. tool0."
        ),
    ] = None
    as_json: Json = False

    def __post_init__(self) -> None:
        if self.vendor is not None and self.as_json:
            raise SettingsError(
                "--as and --json are two forms of one answer: give one of them"
            )

    def link(self, reading: Reading, tree: Tree) -> FileLink | None:
        """The flange in a tree's bodies; None for none.

        Raises:
            SettingsError: A flange is named for no controller.
            UnknownName: There is no such controller or link.
        """
        from testbed.applications.payload.vendors import VENDORS

        if self.vendor is not None and self.vendor not in VENDORS:
            raise UnknownName("controller", self.vendor, list(VENDORS))
        if self.flange is None:
            return None
        if self.vendor is None:
            raise SettingsError("--flange names the frame for --as: both are needed")
        links = {each.name: each for each in reading.file.links()}
        if self.flange not in links:
            raise UnknownName("link", self.flange, list(links))
        link, joints = links[self.flange], dict(enumerate(reading.file.tree().names))
        joint = joints.get(link.body)
        return replace(link, body=-1 if joint not in tree.names else tree.index(joint))

    def print(
        self,
        found: PayloadEstimate,
        tree: Tree,
        link: FileLink | None,
        diagnostics: Iterable[Diagnostic],
        title: str = "",
    ) -> None:
        """Print a payload as a table, as JSON, or as a controller takes it.

        Args:
            found: The payload.
            tree: The robot.
            link: The flange.
            diagnostics: What to know of it.
            title: Of the table; default which link carries the payload.
        """
        from testbed.applications.payload.vendors import VENDORS, at_flange
        from testbed.core.base.codec import encode
        from testbed.view import estimates as shown
        from testbed.view import output

        if self.as_json:
            output.print_json(encode(found))
        elif self.vendor is None:
            lines = shown.payload_lines(found)
            output.print_result([shown.payload_table(found, title)], lines, diagnostics)
        else:
            typer.echo(VENDORS[self.vendor](at_flange(found, tree, link)))
            for each in diagnostics:
                kind = "note" if each.level == "info" else "warning"
                typer.echo(printable(f"{kind}: {each}"), err=True)


@command()
def calibrate(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="Parquet file.")
    ],
    reading: Annotated[
        Reading,
        Fields(
            "settings",
            "zeros",
            "gravity",
            "weld_root",
            "lock",
            "lock_mimic",
            "threads",
            model=RobotModel,
        ),
    ],
    known: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=VALUE[+-SIGMA]",
            help="A known value, e.g. mass=20, gain/Fz=1, centre/x=0.1; repeatable.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Calibration file to write, for --plate.")
    ] = Path("plate.toml"),
    loaded: Annotated[
        Path | None,
        typer.Option(
            help="Of joint torques, with a payload: --known payload/mass=1.5."
        ),
    ] = None,
    joint: Annotated[
        str | None,
        typer.Option(
            help="Joint that moves the link with the payload; default the last."
        ),
    ] = None,
    force: Force = False,
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
    from testbed.core.estimation.known import parse_known
    from testbed.lab.experiment.plate_file import write_plate
    from testbed.view import estimates as shown
    from testbed.view import output, terminal

    if loaded is None:  # else scales are printed, and nothing is written
        check_outputs(out, force=force, read=(recording, reading.model))
    if joint is not None and loaded is None:
        raise SettingsError("--joint names the link of --loaded: both are needed")
    facts, source = parse_known(known), opened(recording)
    if loaded is not None:
        with output.Progress("calibrating torques") as progress:
            scales = torque_scales(
                reading.tree,
                source,
                loaded,
                facts,
                joint,
                progress=progress,
                **reading.arguments,
            )
        if as_json:
            output.print_json(encode(scales))
        else:
            output.print_result([shown.scales_table(scales)])
        return
    reading, source, held = reading.holding(source)
    with output.Progress("calibrating") as progress:
        plate = calibrated(
            reading.tree, source, facts, progress=progress, **reading.arguments
        )
    write_plate(plate, out)
    if as_json:
        output.print_json(
            encode(
                plate, exclude={"estimate": {"normal_equations", "measured_equations"}}
            )
        )
    else:
        terminal.print_plate(plate, [*reading.tree.diagnostics, *held], out)


@command()
def drives(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="Parquet file.")
    ],
    *,
    reading: Annotated[
        Reading,
        Fields(
            "settings",
            "zeros",
            "gravity",
            "weld_root",
            "lock",
            "lock_mimic",
            "plate",
            "sensor",
            "threads",
            model=RobotModel,
        ),
    ],
    choose_terms: Annotated[
        bool,
        typer.Option(
            "--choose-terms", help="Choose the terms of each joint by cross-validation."
        ),
    ] = False,
    writing: Annotated[Writing, Fields("write", "force")],
    unseen: Annotated[
        Path | None,
        typer.Option(
            help="With --write: another motion, whose torques drive the file in MuJoCo."
        ),
    ] = None,
    commands: Annotated[
        bool,
        typer.Option(
            "--commands",
            help="Torques are commands: find the delay of the drives, too.",
        ),
    ] = False,
    friction: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".csv", ".json"),
            help="File for friction: .csv (curve and law) or .json (BAM).",
        ),
    ] = None,
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
    from testbed.bodies.consistency.consistent import consistent
    from testbed.core.base.codec import encode
    from testbed.core.base.files import together
    from testbed.core.recordings.source import Stretch, longest_segment
    from testbed.core.recordings.views import with_gear
    from testbed.importing.check.time_offset import delivered
    from testbed.view import output
    from testbed.view.drives import delay_line, drive_lines, drive_table

    check_outputs(friction, force=writing.force, read=(recording, reading.model))
    writing.check(reading, [recording])
    if unseen is not None and writing.write is None:
        raise SettingsError("--unseen drives the file that --write writes")
    reading, source, held = reading.holding(opened(recording))
    sensed = reading.with_sensors(source, alone=True)
    if sensed.tree.sensor is not None and (writing.write is not None or commands):
        raise SettingsError(
            "--write and --commands need bodies by the plate, not by a sensor"
        )
    reading = replace(sensed, sensor=None)
    tree, source = reading.tree, reading.source(source)
    bodies = sensed.identify(source, "identifying by the wrench")
    offset = None
    if commands:
        source, offset = delivered(
            tree, Stretch(source, *longest_segment(source)), bodies
        )
    delay, lines = (
        (0.0, []) if offset is None else (-offset.delay, [delay_line(offset)])
    )
    choose = choose_terms or reading.tables.identification.drives == "chosen"
    with output.Progress("regressing torques") as progress:
        found = identify_drives(
            tree, source, bodies, choose=choose, progress=progress, **reading.arguments
        )
    said = [*tree.diagnostics, *held, *bodies.diagnostics, *found.diagnostics]
    with together():
        if friction is not None:
            write_friction(found, friction)
        if writing.write is not None:
            links = consistent(
                with_gear(tree, source), [bodies], *reading.bodies(source)
            )
            said += writing.written(links, reading, [recording], found, delay)
            lines.append(f"model file: {writing.write}")
    if writing.write is not None and unseen is not None:
        lines += _replayed(reading, unseen, writing.write)
    if as_json:
        output.print_json({**encode(found), "delay": delay})
    else:
        output.print_result([drive_table(found.estimates)], drive_lines(found), said)
        output.print_result(lines=lines)


def _replayed(reading: Reading, unseen: Path, written: Path) -> list[str]:
    """How far a model file, and what was written, are from an unseen motion by its torques."""
    from testbed.core.recordings.recording import Recording
    from testbed.lab.simulation.replay import replay
    from testbed.view.drives import replay_lines

    motion = Recording.load(unseen)
    files = reading.file, replace(reading.file, path=written)
    ends = [replay(each, motion) for each in files]
    return replay_lines(reading.tree.names, *ends)


@command()
def payload(
    without: Annotated[
        Path, typer.Argument(metavar="WITHOUT", help="Recording without the payload.")
    ],
    loaded: Annotated[
        Path, typer.Argument(metavar="WITH", help="Recording with the payload.")
    ],
    reading: Annotated[
        Reading,
        Fields(
            "settings",
            "gravity",
            "weld_root",
            "lock",
            "lock_mimic",
            "plate",
            "threads",
            model=RobotModel,
        ),
    ],
    *,
    joint: Annotated[
        str | None,
        typer.Option(
            help="Joint that moves the link with the payload; default the last."
        ),
    ] = None,
    printed: Annotated[PayloadOutput, Fields("vendor", "flange", "as_json")],
) -> None:
    """Find a payload's mass, centre and inertia by two recordings, without it and with it.

    Its parameters, as far as the plate identifies them, or the joint torques of recordings without
    a plate.

    Example: testbed payload empty.parquet loaded.parquet --model robot.urdf

    Example: testbed payload empty.parquet loaded.parquet --model ur5e.urdf --as ur --flange tool0
    """
    from testbed.applications.payload.payload import payload as payload_of

    tree, link = reading.tree, printed.link(reading, reading.tree)
    sources = [reading.source(opened(path)) for path in (without, loaded)]
    plates = all("wrench" in source.signals for source in sources)
    method: Method = "external" if plates else "internal"
    estimates = [
        reading.identify(source, f"identifying, {name}", method)
        for source, name in zip(sources, ("without", "with"), strict=True)
    ]
    found = payload_of(tree, estimates[0], estimates[1], joint)
    known = [each for estimate in estimates for each in estimate.diagnostics]
    # the difference has none
    known = [each for each in known if each.code != "plate.no-tare"]
    printed.print(found, tree, link, [*tree.diagnostics, *known, *found.diagnostics])
