"""Commands about what people would rather look at: view, report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from testbed.cli.options import Accept, Weld, Zeros, app

if TYPE_CHECKING:
    from testbed.identification.estimate import Estimate
    from testbed.identification.predict import Growth
    from testbed.viewer.story import Story

METHODS: tuple[Literal["external"], Literal["internal"]] = ("external", "internal")
STAGES = 12
"""Estimates from more and more of a recording."""


@app.command()
def view(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Run folders, or recordings (with --model)."),
    ],
    model: Annotated[
        Path | None, typer.Option(help="MJCF or URDF file of the robot, for recordings.")
    ] = None,
    save: Annotated[
        Path | None, typer.Option(help="Only write this .rrd file; default RUN.rrd, and open it.")
    ] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Show it in a browser on this machine.")
    ] = False,
    port: Annotated[int, typer.Option(help="Of the page, with --serve.")] = 9090,
    zeros: Zeros = False,
    weld_root: Weld = False,
    accept_inertia: Accept = False,
) -> None:
    """Show runs in the Rerun viewer: robot, reaction, predictions, friction, estimates.

    Example: testbed view runs/table6-286a25ef
    """
    from testbed.errors import ViewerError
    from testbed.report import terminal
    from testbed.viewer.log import write_rrd
    from testbed.viewer.show import open_viewer
    from testbed.viewer.show import serve as served

    stories = []
    with terminal.Progress("looking") as progress:
        for k, run in enumerate(runs):
            progress(k, len(runs))
            if not run.exists():
                raise ViewerError(f"there is no run folder or recording '{run}'")
            if run.is_dir():
                stories.append(of_run(run))
            elif model is None:
                raise ViewerError(f"'{run}' is no run folder; a recording needs --model")
            else:
                stories.append(_of_recording(run, model, zeros, weld_root, accept_inertia))
    path = save or _beside(runs[0], ".rrd")
    write_rrd(stories, path)
    terminal.console().print(f"{path}, {path.stat().st_size / 1e6:.1f} MB", soft_wrap=True)
    if serve:
        served(path, port)
    elif save is None:
        open_viewer(path)


@app.command()
def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")],
    out: Annotated[Path | None, typer.Option(help="HTML file; default RUN.html.")] = None,
) -> None:
    """Write a run's report: one HTML file that needs nothing else, and its numbers as JSON.

    Example: testbed report runs/table6-286a25ef
    """
    from testbed.experiment.run_folder import read_run
    from testbed.experiment.story import subject_of
    from testbed.report import terminal
    from testbed.report.html import write_report

    path = out or _beside(run, ".html")
    if path.suffix == ".json":
        raise typer.BadParameter(
            f"--out {path}: the numbers go into that file; name the page .html"
        )
    with terminal.Progress("simulating an unseen motion") as progress:
        subject = subject_of(read_run(run), progress)
    beside = write_report(subject, path)
    terminal.console().print(
        f"{path} ({path.stat().st_size / 1e6:.1f} MB), {beside}", soft_wrap=True
    )


def _beside(run: Path, ending: str) -> Path:
    """A file of the run's name beside it."""
    whole = run.resolve()
    name = whole.name.removesuffix(".parquet") + ending
    return (run.parent if run.name else whole.parent) / name


def of_run(folder: Path) -> Story:
    """A run folder's story, with its truth."""
    import numpy as np

    from testbed.experiment.carry_out import settings_of
    from testbed.experiment.run_folder import read_run
    from testbed.identification.predict import growth
    from testbed.robot.visuals.load_shapes import load_shapes
    from testbed.viewer.story import tell

    outcome = read_run(folder)
    experiment = outcome.experiment
    duration = outcome.recording.time[-1] - outcome.recording.time[0]
    times = np.geomspace(duration / 30, duration, STAGES)
    times[-1] = duration + 1.0  # all of it
    zeros, treatment = experiment.identification.zeros, settings_of(experiment)
    estimates = {"external": outcome.external, "internal": outcome.internal}
    grown: dict[str, Growth] = {
        method: growth(
            outcome.tree, outcome.recording, method, times, zeros=zeros, settings=treatment
        )
        for method in METHODS
    }
    shapes = load_shapes(experiment.model, outcome.tree, weld_root=experiment.weld_root)
    return tell(
        experiment.name,
        outcome.tree,
        outcome.recording,
        shapes,
        estimates,
        outcome.truths,
        grown,
        treatment,
    )


def _of_recording(
    path: Path, model: Path, zeros: bool, weld_root: bool, accept_inertia: bool
) -> Story:
    """A recording's story: estimates where the data suffice, no truth."""
    import numpy as np

    from testbed.errors import RecordingError, UnseenParameters
    from testbed.identification.identify import identify
    from testbed.recordings.recording import Recording, check_robot
    from testbed.robot.load import load_tree
    from testbed.robot.visuals.load_shapes import load_shapes
    from testbed.viewer.story import tell

    tree = load_tree(model, weld_root=weld_root, accept_inertia=accept_inertia)
    recording = Recording.load(path)
    check_robot(recording, tree)
    gravity = recording.facts.get("gravity")
    tree = tree if gravity is None else replace(tree, gravity=np.array(gravity))
    estimates: dict[str, Estimate] = {}
    for method in METHODS:
        try:
            estimates[method] = identify(tree, recording, method, zeros=zeros)
        except (RecordingError, UnseenParameters) as error:
            typer.echo(f"note: no {method} estimate: {error}", err=True)
    shapes = load_shapes(model, tree, weld_root=weld_root)
    return tell(path.stem, tree, recording, shapes, estimates)
