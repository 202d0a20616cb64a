"""Commands that identify plate, drives and payload: calibrate, drives, payload."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.identifications import BodyOptions
from testbed.cli.opening import open_recording
from testbed.cli.options import (
    Force,
    Json,
    OptionFields,
    RobotModel,
    check_outputs,
    command,
    ending,
)
from testbed.cli.reading import ReadingOptions
from testbed.core.base.errors import SettingsError, UnknownName, printable_line
from testbed.core.parameters.rules import Signal

if TYPE_CHECKING:
    from testbed.applications.payload.payload import PayloadEstimate
    from testbed.core.base.diagnostics import Diagnostic
    from testbed.core.robot.repair import ModelLink
    from testbed.core.robot.tree import Tree


@dataclass(frozen=True)
class PayloadOutputOptions:
    """Options for the output format of a payload.

    Attributes:
        vendor: Robot controller whose format is printed; None for a table.
        flange: Link whose frame is the flange frame.
        as_json: True to print JSON.
    """

    vendor: Annotated[
        str | None,
        typer.Option(
            "--as",
            metavar="VENDOR",
            help="Print the payload for a controller: ur, franka or kuka.",
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

    def flange_link(self, reading: ReadingOptions, tree: Tree) -> ModelLink | None:
        """Link selected by --flange.

        Its `body` is the index in `tree` of the joint that moves it.

        Args:
            reading: Options of the model file.
            tree: The robot, possibly with locked joints.

        Returns:
            The link, with `body` = -1 if the tree lacks the joint that moves it; None without
            --flange.

        Raises:
            SettingsError: --flange is given without --as.
            UnknownName: The controller is not in `VENDOR_WRITERS`, or the model file has no such
                link.
        """
        from testbed.applications.payload.vendors import VENDOR_WRITERS

        if self.vendor is not None and self.vendor not in VENDOR_WRITERS:
            raise UnknownName("controller", self.vendor, list(VENDOR_WRITERS))
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
        payload: PayloadEstimate,
        tree: Tree,
        link: ModelLink | None,
        diagnostics: Iterable[Diagnostic],
        title: str = "",
    ) -> None:
        """Print a payload as a table, as JSON, or in a controller's format.

        In a controller's format, diagnostics are printed on standard error. In JSON, only the
        diagnostics of the estimate are printed.

        Args:
            payload: Estimate of the payload.
            tree: The robot.
            link: Link whose frame the controller's format uses; None for the frame of the estimate.
            diagnostics: Diagnostics to print.
            title: Title of the table; default the name of the carrying link.
        """
        from testbed.applications.payload.vendors import VENDOR_WRITERS, flange_payload
        from testbed.core.base.codec import to_json_values
        from testbed.view import estimates as estimate_view
        from testbed.view import output

        if self.as_json:
            output.print_json(to_json_values(payload))
        elif self.vendor is None:
            lines = estimate_view.payload_lines(payload)
            output.print_result(
                [estimate_view.payload_table(payload, title)], lines, diagnostics
            )
        else:
            typer.echo(VENDOR_WRITERS[self.vendor](flange_payload(payload, tree, link)))
            for each in diagnostics:
                kind = "note" if each.level == "info" else "warning"
                typer.echo(printable_line(f"{kind}: {each}"), err=True)


@command()
def calibrate(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="Parquet file.")
    ],
    reading: Annotated[
        ReadingOptions,
        OptionFields(
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
            help="Recording with a known payload, for joint torques: --known payload/mass=1.5."
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
    """Calibrate the force plate from a motion of the robot: sensitivities, zero, delay.

    Other coefficients: --set 'identification.nuisances=["pose","skew"]'. Known values that do not
    suffice are an error before any data are read.

    With --loaded, calibrate joint torques: RECORDING is without, --loaded with a known payload;
    the difference gives the scale of every joint's torque.

    Example: testbed calibrate run.parquet --model robot.urdf --known mass=20 --known gain/Mx=1
    """
    from testbed.applications.calibration import calibrate as calibrate_plate
    from testbed.applications.payload.torque_scales import torque_scales
    from testbed.core.base.codec import to_json_values
    from testbed.core.estimation.known import parse_known
    from testbed.lab.experiment.plate_file import write_calibration
    from testbed.view import estimates as estimate_view
    from testbed.view import output, terminal

    if loaded is None:  # with --loaded scales are printed and no file is written
        check_outputs(out, force=force, read=(recording, reading.model))
    if joint is not None and loaded is None:
        raise SettingsError("--joint names the link of --loaded: both are needed")
    known_values, source = parse_known(known), open_recording(recording)
    if loaded is not None:
        with output.Progress("calibrating torques") as progress:
            scales = torque_scales(
                reading.tree,
                source,
                loaded,
                known_values,
                joint,
                progress=progress,
                **reading.estimator_arguments,
            )
        if as_json:
            output.print_json(to_json_values(scales))
        else:
            output.print_result([estimate_view.torque_scales_table(scales)])
        return
    reading, source, lock_diagnostics = reading.with_resting_joints_locked(source)
    with output.Progress("calibrating") as progress:
        plate = calibrate_plate(
            reading.tree,
            source,
            known_values,
            progress=progress,
            **reading.estimator_arguments,
        )
    write_calibration(plate, out)
    if as_json:
        output.print_json(
            to_json_values(
                plate, exclude={"estimate": {"normal_equations", "measured_equations"}}
            )
        )
    else:
        terminal.print_plate(plate, [*reading.tree.diagnostics, *lock_diagnostics], out)


@command()
def drives(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="Parquet file.")
    ],
    *,
    reading: Annotated[
        ReadingOptions,
        OptionFields(
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
    writing: Annotated[BodyOptions, OptionFields("write", "force")],
    unseen: Annotated[
        Path | None,
        typer.Option(
            help="With --write: recording whose torques drive the written file in MuJoCo."
        ),
    ] = None,
    commands: Annotated[
        bool,
        typer.Option(
            "--commands",
            help="Torques are commands: estimate the delay of the drives as well.",
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
    """Identify each joint's torque constant, friction and rotor, with bodies from the plate.

    The reported torque of a joint is its constant times the sum of the torque of the bodies and
    the joint's terms: --set 'identification.terms=["coulomb","viscous","rotor"]'.
    Friction over velocity is in the JSON, and drawn by report --set identification.drives=given.
    Load-dependent friction terms are load, viscous_load and others.

    --write copies the model file with consistent bodies by the plate, friction, rotors, and (MJCF)
    motors whose gear converts reported to true torque, with the delay of --commands.
    --unseen simulates it, and the model file, open-loop with the torques of another motion.

    Example: testbed drives run.parquet --model robot.urdf --choose-terms

    Example: testbed drives run.parquet --model arm.xml --write driven.xml --unseen other.parquet
    """
    from testbed.applications.drives.friction_files import write_friction
    from testbed.applications.drives.identify_drives import identify_drives
    from testbed.bodies.consistency.consistent import consistent
    from testbed.core.base.codec import to_json_values
    from testbed.core.base.files import replace_together
    from testbed.core.recordings.source import SourceRange, longest_segment
    from testbed.core.recordings.views import with_gear_shafts
    from testbed.importing.check.time_offset import with_drive_delay
    from testbed.view import output
    from testbed.view.drives import drive_delay_line, drive_lines, drive_table

    check_outputs(friction, force=writing.force, read=(recording, reading.model))
    writing.check(reading, [recording])
    if unseen is not None and writing.write is None:
        raise SettingsError("--unseen drives the file that --write writes")
    reading, source, lock_diagnostics = reading.with_resting_joints_locked(
        open_recording(recording)
    )
    sensor_reading = reading.with_sensors(source, alone=True)
    if sensor_reading.tree.sensor is not None and (
        writing.write is not None or commands
    ):
        raise SettingsError(
            "--write and --commands need bodies by the plate, not by a sensor"
        )
    reading = replace(sensor_reading, sensor=None)
    tree, source = reading.tree, reading.prepare_source(source)
    bodies = sensor_reading.identify(source, "identifying by the wrench")
    offset = None
    if commands:
        source, offset = with_drive_delay(
            tree, SourceRange(source, *longest_segment(source)), bodies
        )
    delay, lines = (
        (0.0, []) if offset is None else (-offset.delay, [drive_delay_line(offset)])
    )
    choose = choose_terms or reading.tables.identification.drives == "chosen"
    with output.Progress("regressing torques") as progress:
        findings = identify_drives(
            tree,
            source,
            bodies,
            choose=choose,
            progress=progress,
            **reading.estimator_arguments,
        )
    diagnostics = [
        *tree.diagnostics,
        *lock_diagnostics,
        *bodies.diagnostics,
        *findings.diagnostics,
    ]
    with replace_together():
        if friction is not None:
            write_friction(findings, friction)
        if writing.write is not None:
            links = consistent(
                with_gear_shafts(tree, source),
                [bodies],
                *reading.prior_and_options(source),
            )
            diagnostics += writing.write_bodies(
                links, reading, [recording], findings, delay
            )
            lines.append(f"model file: {writing.write}")
    if writing.write is not None and unseen is not None:
        lines += _replay_lines(reading, unseen, writing.write)
    if as_json:
        output.print_json({**to_json_values(findings), "delay": delay})
    else:
        output.print_result(
            [drive_table(findings.estimates)], drive_lines(findings), diagnostics
        )
        output.print_result(lines=lines)


def _replay_lines(reading: ReadingOptions, unseen: Path, written: Path) -> list[str]:
    """Lines that compare the original and the written model with recorded positions.

    Each model is simulated open-loop under the recorded torques.

    Args:
        reading: Options of the original model file.
        unseen: Recording (Parquet) with torques, along a motion that was not used for the estimate.
        written: Written model file, which is read with the same options.

    Returns:
        Lines with the rms errors of both models' positions relative to the recorded positions.
    """
    from testbed.core.recordings.recording import Recording
    from testbed.lab.simulation.replay import replay_errors
    from testbed.view.drives import replay_error_lines

    motion = Recording.load(unseen)
    files = reading.file, replace(reading.file, path=written)
    position_errors = [replay_errors(file, motion) for file in files]
    return replay_error_lines(reading.tree.names, *position_errors)


@command()
def payload(
    without: Annotated[
        Path, typer.Argument(metavar="WITHOUT", help="Recording without the payload.")
    ],
    loaded: Annotated[
        Path, typer.Argument(metavar="WITH", help="Recording with the payload.")
    ],
    reading: Annotated[
        ReadingOptions,
        OptionFields(
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
    payload_output: Annotated[
        PayloadOutputOptions, OptionFields("vendor", "flange", "as_json")
    ],
) -> None:
    """Identify a payload's mass, centre and inertia from recordings without it and with it.

    The plate's wrench is used, or the joint torques where the plate was not recorded; parameters
    that the signal does not identify are left out.

    Example: testbed payload empty.parquet loaded.parquet --model robot.urdf

    Example: testbed payload empty.parquet loaded.parquet --model ur5e.urdf --as ur --flange tool0
    """
    from testbed.applications.payload.payload import payload as payload_of

    tree, link = reading.tree, payload_output.flange_link(reading, reading.tree)
    sources = [
        reading.prepare_source(open_recording(path)) for path in (without, loaded)
    ]
    plates = all("wrench" in source.signals for source in sources)
    method: Signal = "wrench" if plates else "torque"
    estimates = [
        reading.identify(source, f"identifying, {name}", method)
        for source, name in zip(sources, ("without", "with"), strict=True)
    ]
    estimate = payload_of(tree, estimates[0], estimates[1], joint)
    diagnostics = [
        each for each_estimate in estimates for each in each_estimate.diagnostics
    ]
    # a missing tare cancels in the difference
    diagnostics = [each for each in diagnostics if each.code != "plate.no-tare"]
    payload_output.print(
        estimate, tree, link, [*tree.diagnostics, *diagnostics, *estimate.diagnostics]
    )
