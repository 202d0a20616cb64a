"""Commands about what people would rather look at: view, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import Accept, Weld, Zeros, app, note

if TYPE_CHECKING:
    from testbed.identification.predict import Growth
    from testbed.viewer.story import Story

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
    from testbed.experiment.unseen import subject_of
    from testbed.report import terminal
    from testbed.report.html import write_report

    path = out or _beside(run, ".html")
    if path.is_dir():
        raise typer.BadParameter(f"--out {path} is a folder; name the page, as report.html")
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

    from testbed.experiment.run_folder import read_run
    from testbed.identification.estimate import METHODS, Method
    from testbed.identification.predict import growth
    from testbed.robot.visuals.load_shapes import load_shapes
    from testbed.viewer.story import tell

    run = read_run(folder)
    duration = run.recording.time[-1] - run.recording.time[0]
    times = np.geomspace(duration / 30, duration, STAGES)
    times[-1] = duration + 1.0  # all of it
    grown: dict[Method, Growth] = {
        method: growth(
            run.tree, run.recording, method, times, zeros=run.zeros, settings=run.settings
        )
        for method in METHODS
        if method in run.estimates
    }
    looks = load_shapes(run.model or folder, run.tree, weld_root=run.weld_root)
    note(looks.warnings)
    return tell(
        run.name,
        run.tree,
        run.recording,
        looks.shapes,
        run.estimates,
        run.truths,
        grown,
        run.settings,
    )


def _of_recording(
    path: Path, model: Path, zeros: bool, weld_root: bool, accept_inertia: bool
) -> Story:
    """A recording's story: estimates where the data suffice, no truth."""
    from testbed.experiment.run import assemble_run
    from testbed.recordings.recording import Recording
    from testbed.robot.load import load_tree
    from testbed.robot.visuals.load_shapes import load_shapes
    from testbed.viewer.story import tell

    tree = load_tree(model, weld_root=weld_root, accept_inertia=accept_inertia)
    run = assemble_run(tree, Recording.load(path), name=path.stem, zeros=zeros)
    looks = load_shapes(model, tree, weld_root=weld_root)
    note(f"no {method} estimate: {reason}" for method, reason in run.failures.items())
    note(looks.warnings)
    return tell(run.name, run.tree, run.recording, looks.shapes, run.estimates)
