"""The command about what a force sensor in the robot carries: tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.calibrations import PayloadOutput
from testbed.cli.opening import opened
from testbed.cli.options import Fields, RobotModel, command
from testbed.cli.reading import Reading


@command()
def tool(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Recording in motion; with --at-rest, table of poses."
        ),
    ],
    reading: Annotated[
        Reading,
        Fields(
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
            help="FILE is a table, a row a static pose: joint positions and Fx ... Mz.",
        ),
    ] = False,
    degrees: Annotated[
        bool,
        typer.Option(
            "--degrees", help="With --at-rest: angles without a unit are in degrees."
        ),
    ] = False,
    printed: Annotated[PayloadOutput, Fields("vendor", "flange", "as_json")],
) -> None:
    """Find mass, centre and inertia of the tool that a force sensor carries.

    The sensor shows what it exerts on the tool, in its own axes. A motion identifies all ten
    inertial parameters; a dozen static poses the mass, the centre, the sensor's zero and the
    direction of gravity: robots hang on walls.

    Example: testbed tool run.parquet --model robot.urdf --sensor tool0

    Example: testbed tool run.parquet --model robot.urdf --sensor tool0 --as ur --flange tool0

    Example: testbed tool poses.csv --at-rest --degrees --model robot.urdf --sensor tool0
    """
    from testbed.applications.payload.tool import tool_of

    if at_rest:
        _print_at_rest(recording, reading, printed, degrees=degrees)
        return
    reading, source = reading.of_recording(opened(recording))
    tree = reading.tree.with_gravity(reading.gravity)
    link = printed.link(reading, tree)
    estimate = reading.identify(source)
    found = tool_of(tree, estimate)
    known = [*tree.diagnostics, *estimate.diagnostics, *found.diagnostics]
    title = f"tool beyond the force sensor at {reading.sensor}, about its origin and along its axes"
    printed.print(found, tree, link, known, title)


def _print_at_rest(
    table: Path, reading: Reading, printed: PayloadOutput, *, degrees: bool
) -> None:
    """Print the tool by a table of static poses."""
    from testbed.applications.payload.static_fit import StaticPoses
    from testbed.applications.payload.tool import tool_at_rest
    from testbed.core.base.codec import encode
    from testbed.core.base.diagnostics import ordered
    from testbed.core.base.errors import SettingsError, printable
    from testbed.importing.static_poses import read_static_poses
    from testbed.view import estimates as shown
    from testbed.view import output

    tree = reading.tree.with_gravity(reading.gravity)
    poses = StaticPoses(*read_static_poses(table, tree, degrees=degrees))
    link = printed.link(reading, tree)
    found = tool_at_rest(
        tree, poses, reading.tables.force_sensors[reading.sensor or ""]
    )
    known = [*tree.diagnostics, *found.diagnostics]
    if printed.as_json:
        output.print_json(encode(found))
    elif printed.vendor is None:
        output.print_result(diagnostics=known)
        output.print_result(lines=shown.tool_lines(found))
    elif found.payload is None or found.doubtful:
        first = printable(ordered(found.diagnostics)[0].text, 250)
        raise SettingsError(f"no controller should get this tool: {first}")
    else:
        printed.print(found.payload, tree, link, known)
