"""Rerun recordings of runs and motions, logged by columns instead of samples."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from testbed.bodies.shapes.appearance import Appearance
from testbed.bodies.shapes.shapes import Shape
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import count_with_noun
from testbed.core.base.whole_files import write_atomically
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.information import Information
from testbed.core.recordings.recording import Recording
from testbed.lab.experiment.predict import run_from_estimates
from testbed.lab.experiment.results import read_run
from testbed.lab.experiment.run import Run
from testbed.motion.fourier import Fourier
from testbed.motion.proof import MotionConstraints, Proof, Slack, slack_by_kind
from testbed.view.motion import margin_table
from testbed.view.viewer.blueprint import (
    MOTION_QUANTITIES,
    motion_blueprint,
    runs_blueprint,
)
from testbed.view.viewer.colours import COLOURS
from testbed.view.viewer.curves import log_residuals, log_series, log_signals
from testbed.view.viewer.live import start_viewer
from testbed.view.viewer.robot_drawing import (
    log_appearance,
    log_ellipsoids,
    log_robot,
    log_tip_paths,
    log_wrench,
    send_poses,
)
from testbed.view.viewer.scene import (
    POSE_RATE,
    Scene,
    build_scene,
    escaped_markdown,
    escaped_path_part,
    max_distance_from_origin,
    run_entity_path,
)


def write_motion_rrd(
    path: Path,
    motion: Fourier,
    rules: MotionConstraints,
    proof: Proof,
    appearance: Appearance,
    obstacles: tuple[Shape, ...] = (),
) -> None:
    """Write one period of a motion as a Rerun recording.

    Logged are the robot, the paths of its tips, obstacles, joint curves, margins to limits and
    notes.

    Args:
        path: The .rrd file; it is written completely or not at all.
        motion: The motion.
        rules: Limits of the motion.
        proof: Proven margins to the limits.
        appearance: Shapes of the robot.
        obstacles: Boxes in the robot's workspace.
    """
    tree = rules.tree
    times = np.linspace(0, motion.period, max(2, round(POSE_RATE * motion.period)) + 1)
    margins = slack_by_kind(motion, rules, times)
    kinds = [f"{kind.label} [{kind.unit}]" for kind in margins]
    postures = motion.at(times).q
    size = max_distance_from_origin(appearance, postures)
    with _recording_stream(
        path, motion_blueprint(path.stem, tree, size, kinds, motion.period)
    ) as stream:
        log_appearance(stream, appearance, "/world")
        log_tip_paths(
            stream,
            appearance,
            send_poses(stream, appearance, times, postures, "/world"),
            "/world",
        )
        _log_obstacles(stream, obstacles)
        _log_motion_curves(stream, rules, motion, times, margins)
        notes = rr.TextDocument(
            _motion_notes(path.stem, rules, proof), media_type=rr.MediaType.MARKDOWN
        )
        stream.log("/notes", notes, static=True)


def _log_obstacles(stream: rr.RecordingStream, obstacles: tuple[Shape, ...]) -> None:
    """Log the obstacles as boxes along the world axes, at "/world/obstacles"."""
    if not obstacles:
        return
    boxes = rr.Boxes3D(
        centers=[box.position for box in obstacles],
        half_sizes=[box.size for box in obstacles],
        colors=np.full(len(obstacles), COLOURS["force"], np.uint32),
    )
    stream.log("/world/obstacles", boxes, static=True)


def _log_motion_curves(
    stream: rr.RecordingStream,
    rules: MotionConstraints,
    motion: Fourier,
    times: Array,
    margins: list[Slack],
) -> None:
    """Log margins to limits, and joint positions, velocities and accelerations over time.

    Args:
        stream: Stream of the recording.
        rules: Limits of the motion.
        motion: The motion.
        times: Instants, (M,) [s].
        margins: Smallest margin over time, one per kind of limit.
    """
    for k, kind in enumerate(margins):
        log_series(
            stream, f"/left/{k}", times, {kind.label: kind.left}, [COLOURS["wrench"]]
        )
    for order, quantity in enumerate(MOTION_QUANTITIES):
        for name, values in zip(
            rules.tree.names, motion.derivative(times, order).T, strict=True
        ):
            path = f"/{quantity}/{escaped_path_part(name)}"
            log_series(stream, path, times, {quantity: values}, [COLOURS["wrench"]])


def _motion_notes(name: str, rules: MotionConstraints, proof: Proof) -> str:
    """Markdown notes of a motion: result of the proof, table of margins, diagnostics."""
    verdict = (
        "Proven at every moment."
        if proof.is_valid
        else f"**Not proven:** {escaped_markdown(proof.smallest_margin.words)}"
    )
    lines = [
        f"# {escaped_markdown(name)}",
        f"{count_with_noun(len(proof.margins), 'limit')}. {verdict}",
    ]
    lines.append(margin_table(proof.margins).markdown)
    if rules.diagnostics:
        diagnostic_lines = sentences(rules.diagnostics)
        lines += [
            "## Notes",
            "\n".join(f"- {escaped_markdown(line)}" for line in diagnostic_lines),
        ]
    return "\n\n".join(lines)


def write_runs_rrd(scenes: Sequence[Scene], path: Path) -> None:
    """Write runs as one Rerun recording with an initial layout of the viewer.

    Args:
        scenes: Runs, displayed side by side.
        path: The .rrd file; it is written completely or not at all.
    """
    with _recording_stream(path, runs_blueprint(scenes)) as stream:
        for k, scene in enumerate(scenes):
            log_scene(stream, scene, run_entity_path(k, len(scenes)))


@contextmanager
def _recording_stream(
    path: Path, layout: rrb.Blueprint
) -> Iterator[rr.RecordingStream]:
    """Context manager for a stream in memory, which is written to a file on exit.

    If an error occurs in the block, no file is written. Rerun's own file writer is not used, since
    it blocks when the disk is full.

    Args:
        path: The .rrd file; it is written completely or not at all.
        layout: Initial layout of the viewer.
    """
    stream = rr.RecordingStream(
        "testbed", recording_id=path.stem, send_properties=False
    )
    memory = stream.memory_recording()
    stream.send_blueprint(layout, make_active=False)
    yield stream
    write_atomically(path, memory.drain_as_bytes())


def log_scene(stream: rr.RecordingStream, scene: Scene, parent: str = "") -> None:
    """Log robot, bodies, wrench, signals, residuals and notes of a run.

    Args:
        stream: Stream of the recording.
        scene: The run.
        parent: Entity path of the run.
    """
    log_robot(stream, scene, f"{parent}/world")
    log_ellipsoids(stream, scene, f"{parent}/world")
    log_wrench(stream, scene, f"{parent}/world/bedplate")
    log_signals(stream, scene, parent)
    log_residuals(stream, scene, parent)
    notes = rr.TextDocument(scene.notes, media_type=rr.MediaType.MARKDOWN)
    stream.log(f"{parent}/notes", notes, static=True)


RunSource = Run | str | Path
"""Run, or folder of a run."""


def view(
    data: Recording | RunSource | Sequence[RunSource],
    *estimates: Estimate | Information,
    path: str | Path | None = None,
) -> Path:
    """Open the Rerun viewer with a robot, measured signals, and predictions from estimates.

    Args:
        data: A recording; or a run, its folder, or a sequence of these.
        *estimates: Estimates of the recording's robot; ignored for runs.
        path: The .rrd file, to write it without opening the viewer. By default a temporary file is
            displayed in a viewer that runs in parallel with Python.

    Returns:
        The .rrd file.

    Raises:
        ExperimentError: A folder contains no run.
        ViewerError: The viewer is not installed, or there is no screen.
    """
    runs = run_from_estimates(data, *estimates) if isinstance(data, Recording) else data
    sources = [runs] if isinstance(runs, (Run, str, Path)) else list(runs)
    loaded_runs = [
        each if isinstance(each, Run) else read_run(Path(each)) for each in sources
    ]
    file = (
        Path(tempfile.mkdtemp()) / f"{loaded_runs[0].name}.rrd"
        if path is None
        else Path(path)
    )
    write_runs_rrd([build_scene(run) for run in loaded_runs], file)
    if path is None:
        start_viewer(file)
    return file
