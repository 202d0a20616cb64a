"""The command about what a force sensor in the robot carries: tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.calibrations import Controller
from testbed.cli.opening import opened
from testbed.cli.options import Fields, Json, RobotModel, command
from testbed.cli.reading import Reading

ToolSensor = Annotated[
    str,
    typer.Option(
        "--sensor", metavar="NAME|LINK", help="The force sensor, or the first link beyond it."
    ),
]


@command()
def tool(
    recording: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="Recording in motion; with --at-rest, table of poses."),
    ],
    reading: Annotated[
        Reading,
        Fields(
            "settings gravity weld_root lock lock_mimic threads",
            model=RobotModel,
            sensor=ToolSensor,
        ),
    ],
    controller: Annotated[Controller, Fields("vendor flange")],
    at_rest: Annotated[
        bool,
        typer.Option(
            "--at-rest", help="FILE is a table, a row a static pose: joint positions and Fx ... Mz."
        ),
    ] = False,
    degrees: Annotated[
        bool,
        typer.Option("--degrees", help="With --at-rest: angles without a unit are in degrees."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Find mass, centre and inertia of the tool that a force sensor carries.

    The sensor shows what it exerts on the tool, in its own axes. A motion identifies all ten
    inertial parameters; a dozen static poses the mass, the centre, the sensor's zero and the
    direction of gravity: robots hang on walls.

    Example: testbed tool run.parquet --model robot.urdf --sensor tool0

    Example: testbed tool run.parquet --model robot.urdf --sensor tool0 --as ur --flange tool0

    Example: testbed tool poses.csv --at-rest --degrees --model robot.urdf --sensor tool0
    """
    from testbed.applications.payload.static_fit import StaticPoses
    from testbed.applications.payload.tool import tool_at_rest, tool_of
    from testbed.core.base.codec import encode
    from testbed.core.base.diagnostics import ordered
    from testbed.core.base.errors import SettingsError, printable
    from testbed.core.estimation.identify import identify
    from testbed.importing.static_poses import read_static_poses
    from testbed.view import estimates as shown
    from testbed.view import output, terminal

    controller.check(as_json)
    sensor = reading.sensor
    assert sensor is not None
    if at_rest:
        tree = reading.tree.with_gravity(reading.gravity)
        poses = StaticPoses(*read_static_poses(recording, tree, degrees=degrees))
        link = controller.link(reading, tree)
        still = tool_at_rest(tree, poses, reading.tables.force_sensors[sensor])
        known = [*tree.diagnostics, *still.diagnostics]
        if as_json:
            output.print_json(encode(still))
        elif controller.vendor is not None:
            if still.payload is None or still.doubtful:
                first = printable(ordered(still.diagnostics)[0].text, 250)
                raise SettingsError(f"no controller should get this tool: {first}")
            controller.print(still.payload, tree, link, known)
        else:
            output.print_lines((), known)
            output.print_lines(shown.tool_lines(still), ())
        return
    reading, source = reading.of_recording(opened(recording))
    tree = reading.tree.with_gravity(reading.gravity)
    link = controller.link(reading, tree)
    with output.Progress("identifying") as progress:
        estimate = identify(tree, source, progress=progress, **reading.arguments)
    found = tool_of(tree, estimate)
    known = [*tree.diagnostics, *estimate.diagnostics, *found.diagnostics]
    if as_json:
        output.print_json(encode(found))
    elif controller.vendor is not None:
        controller.print(found, tree, link, known)
    else:
        title = f"tool beyond the force sensor at {sensor}, about its origin and along its axes"
        terminal.print_payload(found, known, title)
