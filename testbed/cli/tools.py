"""The command about what a force sensor in the robot carries: tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.calibrations import Flange, Vendor, flange_link, print_for
from testbed.cli.opening import opened
from testbed.cli.reading import (
    Gravity,
    Json,
    Lock,
    LockMimic,
    Reading,
    RecordingSet,
    RobotModel,
    Threads,
    Weld,
    app,
)


@app.command()
def tool(
    recording: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="Recording in motion; with --at-rest, table of poses."),
    ],
    model: RobotModel,
    sensor: Annotated[
        str,
        typer.Option(
            "--sensor", metavar="NAME|LINK", help="The force sensor, or the first link beyond it."
        ),
    ],
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
    settings: RecordingSet = None,
    gravity: Gravity = None,
    weld_root: Weld = False,
    lock: Lock = None,
    lock_mimic: LockMimic = False,
    vendor: Vendor = None,
    flange: Flange = None,
    threads: Threads = None,
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

    if vendor is not None and as_json:
        raise SettingsError("--as and --json are two forms of one answer: give one of them")
    reading = Reading(settings, False, weld_root, lock, lock_mimic, sensor=sensor)
    if at_rest:
        tree = reading.tree(model).with_gravity(gravity)
        poses = StaticPoses(*read_static_poses(recording, tree, degrees=degrees))
        link = flange_link(vendor, flange, reading.model_file(model), tree)
        still = tool_at_rest(tree, poses, reading.tables().force_sensors[sensor])
        known = [*tree.diagnostics, *still.diagnostics]
        if as_json:
            output.print_json(encode(still))
        elif vendor is not None:
            if still.payload is None or still.doubtful:
                first = printable(ordered(still.diagnostics)[0].text, 250)
                raise SettingsError(f"no controller should get this tool: {first}")
            print_for(vendor, still.payload, tree, link, known)
        else:
            output.print_lines((), known)
            output.print_lines(shown.tool_lines(still), ())
        return
    reading, tree, source = reading.robot_of(opened(recording), model)
    tree = tree.with_gravity(gravity)
    link = flange_link(vendor, flange, reading.model_file(model), tree)
    with output.Progress("identifying") as progress:
        estimate = identify(
            tree,
            source,
            gravity=gravity,
            settings=reading.tables().identification,
            threads=threads,
            progress=progress,
        )
    found = tool_of(tree, estimate)
    known = [*tree.diagnostics, *estimate.diagnostics, *found.diagnostics]
    if as_json:
        output.print_json(encode(found))
    elif vendor is not None:
        print_for(vendor, found, tree, link, known)
    else:
        title = f"tool beyond the force sensor at {sensor}, about its origin and along its axes"
        terminal.print_payload(found, known, title)
