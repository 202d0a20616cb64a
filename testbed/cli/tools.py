"""Command for the tool beyond a force sensor in the robot: tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.calibrations import PayloadOutputOptions
from testbed.cli.opening import open_recording
from testbed.cli.options import OptionFields, RobotModel, command
from testbed.cli.reading import ReadingOptions


@command()
def tool(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Recording in motion; with --at-rest, table of poses."
        ),
    ],
    reading: Annotated[
        ReadingOptions,
        OptionFields(
            "settings",
            "gravity",
            "weld_root",
            "lock",
            "lock_mimic",
            "threads",
            model=RobotModel,
            sensor=Annotated[
                str,
                typer.Option(
                    "--sensor",
                    metavar="NAME|LINK",
                    help="The force sensor, or the first link beyond it.",
                ),
            ],
        ),
    ],
    *,
    at_rest: Annotated[
        bool,
        typer.Option(
            "--at-rest",
            help="FILE is a table of static poses: joint positions and Fx ... Mz in each row.",
        ),
    ] = False,
    degrees: Annotated[
        bool,
        typer.Option(
            "--degrees", help="With --at-rest: angles without a unit are in degrees."
        ),
    ] = False,
    payload_output: Annotated[
        PayloadOutputOptions, OptionFields("vendor", "flange", "as_json")
    ],
) -> None:
    """Identify mass, centre and inertia of the tool that a force sensor carries.

    The sensor measures the wrench that it exerts on the tool, in its own axes. A motion identifies
    all ten inertial parameters; a dozen static poses identify the mass, the centre, the sensor's
    zero and the direction of gravity, for robots on walls.

    Example: testbed tool run.parquet --model robot.urdf --sensor tool0

    Example: testbed tool run.parquet --model robot.urdf --sensor tool0 --as ur --flange tool0

    Example: testbed tool poses.csv --at-rest --degrees --model robot.urdf --sensor tool0
    """
    from testbed.applications.payload.tool import tool_from_motion

    if at_rest:
        _print_static_tool(recording, reading, payload_output, degrees=degrees)
        return
    reading, source = reading.for_recording(open_recording(recording))
    tree = reading.tree.with_gravity(reading.gravity)
    link = payload_output.flange_link(reading, tree)
    estimate = reading.identify(source)
    identified_tool = tool_from_motion(tree, estimate)
    diagnostics = [
        *tree.diagnostics,
        *estimate.diagnostics,
        *identified_tool.diagnostics,
    ]
    title = f"tool beyond the force sensor at {reading.sensor}, about its origin and along its axes"
    payload_output.print(identified_tool, tree, link, diagnostics, title)


def _print_static_tool(
    table: Path,
    reading: ReadingOptions,
    payload_output: PayloadOutputOptions,
    *,
    degrees: bool,
) -> None:
    """Identify the tool beyond a force sensor from static poses, and print the estimate.

    Args:
        table: File with one row per pose: joint positions and the wrench of the sensor.
        reading: Options of the model file, with the sensor.
        payload_output: Output options.
        degrees: True if angles without a unit are in degrees, False if they are in radians.

    Raises:
        SettingsError: --as is given, but the estimate has no payload or has errors.
    """
    from testbed.applications.payload.static_fit import StaticPoses
    from testbed.applications.payload.tool import tool_from_static_poses
    from testbed.core.base.codec import to_json_values
    from testbed.core.base.diagnostics import ordered_diagnostics
    from testbed.core.base.errors import SettingsError, printable_line
    from testbed.importing.static_poses import read_static_poses
    from testbed.view import estimates as estimate_view
    from testbed.view import output

    tree = reading.tree.with_gravity(reading.gravity)
    poses = StaticPoses(*read_static_poses(table, tree, degrees=degrees))
    link = payload_output.flange_link(reading, tree)
    identified_tool = tool_from_static_poses(
        tree, poses, reading.tables.force_sensors[reading.sensor or ""]
    )
    diagnostics = [*tree.diagnostics, *identified_tool.diagnostics]
    if payload_output.as_json:
        output.print_json(to_json_values(identified_tool))
    elif payload_output.vendor is None:
        output.print_result(diagnostics=diagnostics)
        output.print_result(lines=estimate_view.tool_lines(identified_tool))
    elif identified_tool.payload is None or identified_tool.has_errors:
        main_reason = printable_line(
            ordered_diagnostics(identified_tool.diagnostics)[0].text, 250
        )
        raise SettingsError(f"no controller should get this tool: {main_reason}")
    else:
        payload_output.print(identified_tool.payload, tree, link, diagnostics)
