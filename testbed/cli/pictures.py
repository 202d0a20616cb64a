"""Commands for visualisation: view, in the Rerun viewer, and report, as HTML."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.identifications import ConsistentBodies
from testbed.cli.options import Force, OptionFields, check_outputs, command, ending
from testbed.cli.reading import ReadingOptions
from testbed.core.base.diagnostics import (
    Diagnostic,
    make_diagnostic,
    ordered_diagnostics,
)
from testbed.core.base.file_kinds import explain_wrong_kind

if TYPE_CHECKING:
    from testbed.core.recordings.recording import Recording
    from testbed.core.recordings.source import Source
    from testbed.lab.experiment.run import Run


RECORDING_OPTIONS = OptionFields(
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
"""Options for recordings, which are identified before display."""


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
    reading: Annotated[ReadingOptions, RECORDING_OPTIONS],
    save: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".rrd"),
            help="Only write this .rrd file; default RUN.rrd, and open the viewer.",
        ),
    ] = None,
    serve: Annotated[
        bool,
        typer.Option("--serve", help="Show the viewer in a browser on this machine."),
    ] = False,
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Port of the page, with --serve.")
    ] = 9090,
    force: Force = False,
) -> None:
    """Show runs in the Rerun viewer: robot, wrench, predictions.

    A motion of `testbed excite` is shown as the moving robot with the margin to every limit. A
    recording is shown with the predictions of its own estimates.

    Example: testbed view runs/table6-286a25ef

    Example: testbed view recording.parquet --model robot.urdf
    """
    from testbed.core.base.errors import ViewerError
    from testbed.view import output
    from testbed.view.viewer.live import has_screen
    from testbed.view.viewer.log import write_runs_rrd
    from testbed.view.viewer.scene import build_scene

    log = save or _sibling_path(runs[0], ".rrd")
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
    if motion:  # a mapping is a TOML file as well, but needs --model
        with output.Progress("looking"):
            diagnostics = _write_motion_view(runs[0], reading.settings or (), log)
        _show_file(log, diagnostics, serve, save is None, port)
        return
    _reject_recording_options(runs, reading)
    scenes = []
    with output.Progress("looking") as progress:
        for k, path in enumerate(runs):
            progress(k, len(runs))
            run = _load_run(path, reading)
            scenes.append(build_scene(run))
        write_runs_rrd(scenes, log)
    _show_file(
        log,
        [each for scene in scenes for each in scene.diagnostics],
        serve,
        save is None,
        port,
    )


def _show_file(
    path: Path, diagnostics: list[Diagnostic], serve: bool, open_window: bool, port: int
) -> None:
    """Print diagnostics and size of a written .rrd file, and open the viewer.

    Args:
        path: Written .rrd file.
        diagnostics: Diagnostics to print.
        serve: True to display the file in a browser; takes precedence over `open_window`.
        open_window: True to replace this process by the viewer.
        port: Port of the web page.
    """
    from testbed.view import output
    from testbed.view.viewer.live import become_viewer
    from testbed.view.viewer.live import serve_viewer as serve_page

    out = output.console()
    output.print_diagnostics(out, diagnostics)
    out.print(f"{path}, {path.stat().st_size / 1e6:.1f} MB", soft_wrap=True)
    if serve:
        serve_page(path, port)
    elif open_window:
        become_viewer(path)


def _write_motion_view(
    file: Path, settings: Sequence[str], path: Path
) -> list[Diagnostic]:
    """Write a motion as .rrd file: robot, obstacles, and margins to the limits.

    Args:
        file: Motion file.
        settings: Values of --set.
        path: .rrd file to write.

    Returns:
        Diagnostics of robot, meshes and limits. The first is "motion.not-proven" if a limit is
        exceeded or cannot be proven to hold.
    """
    from testbed.bodies.shapes.appearance import load_appearance
    from testbed.lab.experiment.motions import obstacle_shapes, prove_motion_file
    from testbed.view.viewer.log import write_motion_rrd

    proven_motion = prove_motion_file(file, settings)
    tree = proven_motion.rules.tree
    appearance = load_appearance(tree, proven_motion.experiment.file)
    boxes = obstacle_shapes(proven_motion.experiment)
    write_motion_rrd(
        path,
        proven_motion.motion,
        proven_motion.rules,
        proven_motion.proof,
        appearance,
        boxes,
    )
    proof, diagnostics = (
        proven_motion.proof,
        [*tree.diagnostics, *appearance.diagnostics, *proven_motion.rules.diagnostics],
    )
    if proof.is_valid:
        return diagnostics
    return [
        make_diagnostic("motion.not-proven", reason=proof.smallest_margin.words),
        *diagnostics,
    ]


@command()
def report(
    run: Annotated[
        Path,
        typer.Argument(metavar="RUN", help="Run folder, or recording (with --model)."),
    ],
    *,
    reading: Annotated[ReadingOptions, RECORDING_OPTIONS],
    out: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".html", ".htm"), help="HTML file; default RUN.html."
        ),
    ] = None,
    consistent: ConsistentBodies = False,
    validate: Annotated[
        Path | None,
        typer.Option(help="Another recording, for validation."),
    ] = None,
    force: Force = False,
) -> None:
    """Write the report of a run: a self-contained HTML file, and its numbers as JSON.

    A recording is identified first; --validate adds validation by another recording.

    Example: testbed report runs/table6-286a25ef

    Example: testbed report a.parquet --model robot.urdf --validate b.parquet
    """
    from testbed.view import output
    from testbed.view.run_page import write_report

    path = out or _sibling_path(run, ".html")
    # the default page of the run may be replaced, with its JSON file
    is_default_page = out is None and path.is_file()
    read = run, reading.model, reading.plate, validate
    check_outputs(
        path, path.with_suffix(".json"), force=force or is_default_page, read=read
    )
    _reject_recording_options([run], reading, consistent=consistent, other=validate)
    with output.Progress("identifying") as progress:
        loaded_run = _load_run(run, reading, consistent=consistent)
        if validate is not None:
            loaded_run = _run_with_validation(loaded_run, validate, reading)
        elif loaded_run.unseen is None:
            from testbed.lab.experiment.carry_out import (
                with_payload_metrics,
                with_simulated_validation,
            )

            progress.update_step(0, 0, "simulating a held-out motion")
            loaded_run = with_simulated_validation(
                with_payload_metrics(loaded_run, progress), progress
            )
        progress.update_step(0, 0, "drawing")
        json_path = write_report(loaded_run, path)
    output.console().print(
        f"{path} ({path.stat().st_size / 1e6:.1f} MB), {json_path}", soft_wrap=True
    )


def _sibling_path(run: Path, ending: str) -> Path:
    """Path beside a run, with the name of the run and another suffix.

    A suffix .parquet or .toml of the run is replaced. For the name, symbolic links and "." are
    resolved.
    """
    real_path = Path(os.path.realpath(run))  # does not fail for circular links
    name = real_path.name.removesuffix(".parquet").removesuffix(".toml") + ending
    return (run.parent if run.name else real_path.parent) / name


def _reject_recording_options(
    paths: list[Path],
    reading: ReadingOptions,
    *,
    consistent: bool = False,
    other: Path | None = None,
) -> None:
    """Raise ExperimentError for recording options if all paths are run folders.

    Args:
        paths: Run folders and recordings.
        reading: Options of model file and recordings; all except --unchecked apply to recordings
            only.
        consistent: True if consistent bodies are requested.
        other: Recording to be used for validation.
    """
    from testbed.core.base.errors import ExperimentError

    has_recording_options = (
        replace(reading, unchecked=False) != ReadingOptions()
        or consistent
        or other is not None
    )
    if all(path.is_dir() for path in paths) and has_recording_options:
        raise ExperimentError(
            f"'{paths[0]}' is a run folder: it has its own model and settings; --model, --set and "
            "the like are for recordings"
        )


def _load_run(path: Path, reading: ReadingOptions, *, consistent: bool = False) -> Run:
    """Load a run from a run folder, or identify a recording to build a run.

    Joints that are at rest in a recording are locked. The run of a recording has the diagnostics of
    the plausibility check, of the estimates and of the model file.

    Args:
        path: Run folder, recording or mapping file.
        reading: Options of model file and recordings.
        consistent: True to compute consistent bodies for a recording.

    Raises:
        ExperimentError: The path does not exist, is a campaign folder, or is a recording without
            --model.
    """
    from testbed.core.base.errors import ExperimentError
    from testbed.core.robot.placeholders import find_placeholders
    from testbed.lab.experiment.results import read_run
    from testbed.lab.experiment.run import assemble_run

    if not path.exists():
        raise ExperimentError(
            f"there is no run folder or recording '{path}'{_similar_run_hint(path)}"
        )
    if path.is_dir():
        if (path / "results.parquet").is_file():
            raise ExperimentError(
                f"'{path}' is a campaign: testbed campaign --summary {path}"
            )
        return read_run(path)
    with explain_wrong_kind(path, "recording", "mapping"):
        if reading.model is None:
            raise ExperimentError(
                f"'{path}' is no run folder; a recording needs --model"
            )
        reading, recording, check_diagnostics = _load_recording(path, reading)
    reading, source, check_diagnostics = reading.with_resting_joints_locked(
        recording, check_diagnostics
    )
    run = assemble_run(
        reading.tree,
        _as_recording(source),
        name=path.stem,
        settings=reading.tables.identification,
        doubt=reading.doubt,
        prior_error=reading.prior_error,
        bodies=reading.prior_and_options(source) if consistent else None,
    )
    placeholders = find_placeholders(reading.tree).diagnostics
    return replace(
        run,
        diagnostics=ordered_diagnostics(
            [*check_diagnostics, *run.diagnostics, *placeholders]
        ),
    )


def _similar_run_hint(path: Path) -> str:
    """Text that suggests runs whose names begin with the name of a missing path.

    It lists at most three folders or recordings, sorted by name; it is "" if there are none. The
    default name of a run folder ends in a hash.
    """
    if not path.name or not path.parent.is_dir():
        return ""
    similar_runs = [
        str(each)
        for each in path.parent.iterdir()
        if each.name.startswith(path.name)
        and (each.is_dir() or each.suffix == ".parquet")
    ]
    return f"; there is {', '.join(sorted(similar_runs)[:3])}" if similar_runs else ""


def _load_recording(
    path: Path, reading: ReadingOptions
) -> tuple[ReadingOptions, Recording, Sequence[Diagnostic]]:
    """Load a recording into memory, correct it for the plate's calibration, and check it.

    Segments between gaps are combined into one recording.

    Returns:
        Options for this recording, the recording, and diagnostics of the check.
    """
    from testbed.core.recordings.source import gather_parts

    reading, segments, diagnostics = reading.open_segments(path)
    parts = [_as_recording(segment) for segment in segments]
    return reading, parts[0] if len(parts) == 1 else gather_parts(parts), diagnostics


def _as_recording(source: Source) -> Recording:
    """Recording in memory that contains all samples of a source.

    A `Recording` is returned unchanged, including its simulated truth.
    """
    from testbed.core.recordings.recording import Recording

    return source if isinstance(source, Recording) else source.part(0, source.samples)


def _run_with_validation(run: Run, path: Path, reading: ReadingOptions) -> Run:
    """Run with the validation of its estimates on another recording.

    The diagnostics of the validation are added.

    Args:
        run: Run with a model file; its locked joints are also locked in the other recording.
        path: The other recording, or its mapping file.
        reading: Options of the other recording.
    """
    from testbed.lab.experiment.carry_out import with_validation

    assert run.model is not None
    _, other, check_diagnostics = _load_recording(
        path, replace(reading, locked_file=run.model)
    )
    diagnostics = (*other.metadata.diagnostics, *check_diagnostics)
    return with_validation(run, other).with_diagnostics(
        replace(d, recording=path.name) for d in diagnostics
    )
