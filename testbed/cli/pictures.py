"""Commands about what people would rather look at: view, report."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.identifications import ConsistentBodies
from testbed.cli.options import Fields, Force, check_outputs, command, ending
from testbed.cli.reading import Reading
from testbed.core.base.diagnostics import Diagnostic, diagnose, ordered
from testbed.core.base.file_kinds import expecting

if TYPE_CHECKING:
    from testbed.core.recordings.recording import Recording
    from testbed.core.recordings.source import Source
    from testbed.lab.experiment.run import Run


RECORDED = Fields(
    "model",
    "settings",
    "zeros",
    "gravity",
    "weld_root",
    "lock",
    "lock_mimic",
    "plate",
    "terms",
    "unchecked",
)
"""Options of a recording that is identified to be shown."""


@command()
def view(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN...",
            help="Run folders, recordings (with --model), or a motion (.toml).",
        ),
    ],
    *,
    reading: Annotated[Reading, RECORDED],
    save: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".rrd"),
            help="Only write this .rrd file; default RUN.rrd, and open it.",
        ),
    ] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Show it in a browser on this machine.")
    ] = False,
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Of the page, with --serve.")
    ] = 9090,
    force: Force = False,
) -> None:
    """Show runs in the Rerun viewer: robot, reaction, predictions.

    Of a motion that `testbed excite` wrote: the robot on its path, and what is left of every limit.
    A recording is shown with what its own estimates predict.

    Example: testbed view runs/table6-286a25ef

    Example: testbed view recording.parquet --model robot.urdf
    """
    from testbed.core.base.errors import ViewerError
    from testbed.view import output
    from testbed.view.viewer.live import has_screen
    from testbed.view.viewer.log import write_rrd
    from testbed.view.viewer.scene import scene_of

    log = save or _beside(runs[0], ".rrd")
    check_outputs(
        log, force=force or save is None, read=(*runs, reading.model, reading.plate)
    )
    if save is None and not serve and not has_screen():
        raise ViewerError(
            f"there is no screen to open the viewer on: --save {log.name} writes a file for "
            "another machine, --serve shows it in a browser"
        )
    motion = reading.model is None and [path.suffix.lower() for path in runs] == [
        ".toml"
    ]
    if motion:  # a mapping, which is a TOML file, too, needs --model
        with output.Progress("looking"):
            said = _write_motion(runs[0], reading.settings or (), log)
        _show(log, said, serve, save is None, port)
        return
    _check_said(runs, reading)
    scenes = []
    with output.Progress("looking") as progress:
        for k, path in enumerate(runs):
            progress(k, len(runs))
            run = _run_at(path, reading)
            scenes.append(scene_of(run))
        write_rrd(scenes, log)
    _show(
        log,
        [each for scene in scenes for each in scene.diagnostics],
        serve,
        save is None,
        port,
    )


def _show(
    path: Path, said: list[Diagnostic], serve: bool, opened: bool, port: int
) -> None:
    """Say what was written, and show it as is wished."""
    from testbed.view import output
    from testbed.view.viewer.live import open_viewer
    from testbed.view.viewer.live import serve as served

    out = output.console()
    output.print_diagnostics(out, said)
    out.print(f"{path}, {path.stat().st_size / 1e6:.1f} MB", soft_wrap=True)
    if serve:
        served(path, port)
    elif opened:
        open_viewer(path)


def _write_motion(file: Path, settings: Sequence[str], path: Path) -> list[Diagnostic]:
    """Write what there is to see of a file's motion; what to know of it."""
    from testbed.bodies.shapes.appearance import load_appearance
    from testbed.lab.experiment.motions import checked_motion, obstacles_of
    from testbed.view.viewer.log import write_motion_rrd

    found = checked_motion(file, settings)
    tree = found.rules.tree
    look = load_appearance(tree, found.experiment.file)
    boxes = obstacles_of(found.experiment)
    write_motion_rrd(path, found.motion, found.rules, found.proof, look, boxes)
    proof, said = (
        found.proof,
        [*tree.diagnostics, *look.diagnostics, *found.rules.diagnostics],
    )
    if proof.holds:
        return said
    return [diagnose("motion.not-proven", reason=proof.worst.words), *said]


@command()
def report(
    run: Annotated[
        Path,
        typer.Argument(metavar="RUN", help="Run folder, or recording (with --model)."),
    ],
    *,
    reading: Annotated[Reading, RECORDED],
    out: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".html", ".htm"), help="HTML file; default RUN.html."
        ),
    ] = None,
    consistent: ConsistentBodies = False,
    validate: Annotated[
        Path | None,
        typer.Option(help="Another recording, for cross-validation."),
    ] = None,
    force: Force = False,
) -> None:
    """Write a run's report: one HTML file that needs nothing else, and its numbers as JSON.

    Of a recording, too: what was identified from it, held against another one by --validate.

    Example: testbed report runs/table6-286a25ef

    Example: testbed report a.parquet --model robot.urdf --validate b.parquet
    """
    from testbed.view import output
    from testbed.view.run_page import write_report

    path = out or _beside(run, ".html")
    # the run's own page, and the numbers beside it
    again = out is None and path.is_file()
    read = run, reading.model, reading.plate, validate
    check_outputs(path, path.with_suffix(".json"), force=force or again, read=read)
    _check_said([run], reading, consistent=consistent, other=validate)
    with output.Progress("identifying") as progress:
        done = _run_at(run, reading, consistent=consistent)
        if validate is not None:
            done = _judged_on(done, validate, reading)
        elif done.unseen is None:
            from testbed.lab.experiment.carry_out import (
                on_unseen_motion,
                with_payload_metrics,
            )

            progress.say(0, 0, "simulating a held-out motion")
            done = on_unseen_motion(with_payload_metrics(done, progress), progress)
        progress.say(0, 0, "drawing")
        beside = write_report(done, path)
    output.console().print(
        f"{path} ({path.stat().st_size / 1e6:.1f} MB), {beside}", soft_wrap=True
    )


def _beside(run: Path, ending: str) -> Path:
    """A file of the run's name beside it."""
    whole = Path(os.path.realpath(run))  # links in a circle are no error yet
    name = whole.name.removesuffix(".parquet").removesuffix(".toml") + ending
    return (run.parent if run.name else whole.parent) / name


def _check_said(
    paths: list[Path],
    reading: Reading,
    *,
    consistent: bool = False,
    other: Path | None = None,
) -> None:
    """Whether what was said of recordings has one to be about."""
    from testbed.core.base.errors import ExperimentError

    said = (
        replace(reading, unchecked=False) != Reading()
        or consistent
        or other is not None
    )
    if all(path.is_dir() for path in paths) and said:
        raise ExperimentError(
            f"'{paths[0]}' is a run folder: it has its own model and settings; --model, --set and "
            "the like are for recordings"
        )


def _run_at(path: Path, reading: Reading, *, consistent: bool = False) -> Run:
    """A run folder's run, or a recording's with what can be identified from it."""
    from testbed.core.base.errors import ExperimentError
    from testbed.core.robot.placeholders import placeholders
    from testbed.lab.experiment.results import read_run
    from testbed.lab.experiment.run import assemble_run

    if not path.exists():
        raise ExperimentError(
            f"there is no run folder or recording '{path}'{_alike(path)}"
        )
    if path.is_dir():
        if (path / "results.parquet").is_file():
            raise ExperimentError(
                f"'{path}' is a campaign: testbed campaign --summary {path}"
            )
        return read_run(path)
    with expecting(path, "recording", "mapping"):
        if reading.model is None:
            raise ExperimentError(
                f"'{path}' is no run folder; a recording needs --model"
            )
        reading, recording, accepted = _loaded(path, reading)
    reading, source, accepted = reading.holding(recording, accepted)
    run = assemble_run(
        reading.tree,
        _in_memory(source),
        name=path.stem,
        settings=reading.tables.identification,
        doubt=reading.doubt,
        prior_error=reading.prior_error,
        bodies=reading.bodies(source) if consistent else None,
    )
    doubts = placeholders(reading.tree).diagnostics
    return replace(run, diagnostics=ordered([*accepted, *run.diagnostics, *doubts]))


def _alike(path: Path) -> str:
    """Run folders beside a path whose names go on from its own: a run's folder ends in a hash."""
    if not path.name or not path.parent.is_dir():
        return ""
    found = [
        str(each)
        for each in path.parent.iterdir()
        if each.name.startswith(path.name)
        and (each.is_dir() or each.suffix == ".parquet")
    ]
    return f"; there is {', '.join(sorted(found)[:3])}" if found else ""


def _loaded(
    path: Path, reading: Reading
) -> tuple[Reading, Recording, Sequence[Diagnostic]]:
    """A recording in memory, the plate's faults taken back, and what to doubt of it."""
    from testbed.core.recordings.source import gathered

    reading, segments, accepted = reading.segments(path)
    parts = [_in_memory(segment) for segment in segments]
    return reading, parts[0] if len(parts) == 1 else gathered(parts), accepted


def _in_memory(source: Source) -> Recording:
    """A source as a recording, which may have a truth."""
    from testbed.core.recordings.recording import Recording

    return source if isinstance(source, Recording) else source.part(0, source.samples)


def _judged_on(run: Run, path: Path, reading: Reading) -> Run:
    """A run with its estimates held against another recording."""
    from testbed.lab.experiment.carry_out import validated

    assert run.model is not None
    _, other, doubted = _loaded(path, replace(reading, resolved=run.model))
    said = (*other.metadata.diagnostics, *doubted)
    return validated(run, other).with_diagnostics(
        replace(d, recording=path.name) for d in said
    )
