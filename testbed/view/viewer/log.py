"""Runs and motions as Rerun's viewer takes them: everything in columns, nothing by sample."""

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
from testbed.core.base.errors import plural
from testbed.core.base.whole_files import write_whole
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.information import Information
from testbed.core.recordings.recording import Recording
from testbed.lab.experiment.predict import run_of
from testbed.lab.experiment.results import read_run
from testbed.lab.experiment.run import Run
from testbed.motion.fourier import Fourier
from testbed.motion.proof import Proof, Rules, Slack, slack
from testbed.view.motion import margin_table
from testbed.view.viewer.blueprint import RATES, blueprint, motion_blueprint
from testbed.view.viewer.colours import COLOURS
from testbed.view.viewer.curves import log_residuals, log_series, log_signals
from testbed.view.viewer.live import start_viewer
from testbed.view.viewer.robot_drawing import (
    log_appearance,
    log_bodies,
    log_paths,
    log_reaction,
    log_robot,
    send_poses,
)
from testbed.view.viewer.scene import POSES, Scene, plain, root, safe, scene_of, span_of


def write_motion_rrd(
    path: Path,
    motion: Fourier,
    rules: Rules,
    proof: Proof,
    look: Appearance,
    obstacles: tuple[Shape, ...] = (),
) -> None:
    """Write one period of a motion: robot, paths of its tips, boxes around it, slack of limits.

    Args:
        path: The .rrd file; appears whole or not at all.
        motion: The motion.
        rules: What it must respect.
        proof: What it is proven to leave.
        look: What the robot looks like.
        obstacles: Boxes of its cell.
    """
    tree = rules.tree
    times = np.linspace(0, motion.period, max(2, round(POSES * motion.period)) + 1)
    left = slack(motion, rules, times)
    kinds = [f"{kind.label} [{kind.unit}]" for kind in left]
    postures = motion.at(times).q
    size = span_of(look, postures)
    with _written(
        path, motion_blueprint(path.stem, tree, size, kinds, motion.period)
    ) as stream:
        log_appearance(stream, look, "/world")
        log_paths(
            stream, look, send_poses(stream, look, times, postures, "/world"), "/world"
        )
        _log_obstacles(stream, obstacles)
        _log_curves(stream, rules, motion, times, left)
        notes = rr.TextDocument(
            _notes(path.stem, rules, proof), media_type=rr.MediaType.MARKDOWN
        )
        stream.log("/notes", notes, static=True)


def _log_obstacles(stream: rr.RecordingStream, obstacles: tuple[Shape, ...]) -> None:
    if not obstacles:
        return
    boxes = rr.Boxes3D(
        centers=[box.position for box in obstacles],
        half_sizes=[box.size for box in obstacles],
        colors=np.full(len(obstacles), COLOURS["force"], np.uint32),
    )
    stream.log("/world/obstacles", boxes, static=True)


def _log_curves(
    stream: rr.RecordingStream,
    rules: Rules,
    motion: Fourier,
    times: Array,
    left: list[Slack],
) -> None:
    for k, kind in enumerate(left):
        log_series(
            stream, f"/left/{k}", times, {kind.label: kind.left}, [COLOURS["external"]]
        )
    for order, rate in enumerate(RATES):
        for name, values in zip(
            rules.tree.names, motion.derivative(times, order).T, strict=True
        ):
            path = f"/{rate}/{safe(name)}"
            log_series(stream, path, times, {rate: values}, [COLOURS["external"]])


def _notes(name: str, rules: Rules, proof: Proof) -> str:
    said = (
        "Proven at every moment."
        if proof.holds
        else f"**Not proven:** {plain(proof.worst.words)}"
    )
    lines = [f"# {plain(name)}", f"{plural(len(proof.margins), 'limit')}. {said}"]
    lines.append(margin_table(proof.margins).markdown)
    if rules.diagnostics:
        known = sentences(rules.diagnostics)
        lines += ["## Notes", "\n".join(f"- {plain(line)}" for line in known)]
    return "\n\n".join(lines)


def write_rrd(scenes: Sequence[Scene], path: Path) -> None:
    """Write runs as one Rerun recording, with a blueprint for a first look.

    Args:
        scenes: One run, or several to be shown side by side.
        path: The .rrd file; appears whole or not at all.
    """
    with _written(path, blueprint(scenes)) as stream:
        for k, scene in enumerate(scenes):
            log_scene(stream, scene, root(k, len(scenes)))


@contextmanager
def _written(path: Path, arranged: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A stream in memory that is written to a file; Rerun's own writer hangs on a full disk.

    Args:
        path: The .rrd file; appears whole or not at all.
        arranged: Blueprint for a first look.
    """
    stream = rr.RecordingStream(
        "testbed", recording_id=path.stem, send_properties=False
    )
    memory = stream.memory_recording()
    stream.send_blueprint(arranged, make_active=False)
    yield stream
    write_whole(path, memory.drain_as_bytes())


def log_scene(stream: rr.RecordingStream, scene: Scene, at: str = "") -> None:
    """Log everything there is to see of a run.

    Args:
        stream: Where to.
        scene: The run.
        at: Its root among the entities.
    """
    log_robot(stream, scene, f"{at}/world")
    log_bodies(stream, scene, f"{at}/world")
    log_reaction(stream, scene, f"{at}/world/bedplate")
    log_signals(stream, scene, at)
    log_residuals(stream, scene, at)
    notes = rr.TextDocument(scene.notes, media_type=rr.MediaType.MARKDOWN)
    stream.log(f"{at}/notes", notes, static=True)


Shown = Run | str | Path


def view(
    data: Recording | Shown | Sequence[Shown],
    *estimates: Estimate | Information,
    path: str | Path | None = None,
) -> Path:
    """Show a robot, what was measured and what estimates predict in Rerun's viewer.

    Args:
        data: A recording; or runs, or folders of runs.
        estimates: Of the recording's robot.
        path: The .rrd file to write, and nothing is opened; default a temporary one, which the
            viewer shows while Python goes on.

    Returns:
        The file.

    Raises:
        ExperimentError: A folder holds no run.
        ViewerError: There is no viewer, or no screen for it.
    """
    runs = run_of(data, *estimates) if isinstance(data, Recording) else data
    several = [runs] if isinstance(runs, (Run, str, Path)) else list(runs)
    shown = [
        each if isinstance(each, Run) else read_run(Path(each)) for each in several
    ]
    place = (
        Path(tempfile.mkdtemp()) / f"{shown[0].name}.rrd"
        if path is None
        else Path(path)
    )
    write_rrd([scene_of(run) for run in shown], place)
    if path is None:
        start_viewer(place)
    return place
