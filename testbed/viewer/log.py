"""A run as Rerun's viewer takes it: everything in columns, nothing sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import rerun as rr

from testbed.files import replacing
from testbed.viewer.blueprint import blueprint
from testbed.viewer.constant_bars import log_constants
from testbed.viewer.curves import log_friction, log_growth, log_signals
from testbed.viewer.heat_map import log_matrix
from testbed.viewer.overview import log_overview
from testbed.viewer.robot_drawing import log_bodies, log_reaction, log_robot
from testbed.viewer.scene import Scene, root


def write_rrd(scenes: Sequence[Scene], path: Path, tab: str = "overview") -> None:
    """Write runs as one Rerun recording, with a blueprint for a first look.

    Args:
        scenes: One run, or several to be shown side by side.
        path: The .rrd file; appears whole or not at all.
        tab: Which tab is in front.
    """
    with replacing(path) as fresh:
        stream = rr.RecordingStream("testbed", recording_id=path.stem, send_properties=False)
        stream.save(fresh, default_blueprint=blueprint(scenes, tab))
        for k, scene in enumerate(scenes):
            log_scene(stream, scene, root(k, len(scenes)))
        stream.flush()
        stream.disconnect()


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
    log_friction(stream, scene, f"{at}/friction")
    log_growth(stream, scene, f"{at}/estimate")
    log_overview(stream, scene, f"{at}/overview")
    if scene.run.drives is not None:
        log_constants(stream, scene.run.drives.estimates, f"{at}/constants")
    if scene.matrix is not None:
        log_matrix(stream, scene.matrix, f"{at}/plate")
    notes = rr.TextDocument(scene.notes, media_type=rr.MediaType.MARKDOWN)
    stream.log(f"{at}/notes", notes, static=True)
