"""Runs in Rerun's viewer, from Python."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from testbed.experiment.growth import growth
from testbed.experiment.results import read_run
from testbed.experiment.run import Run
from testbed.viewer.log import write_rrd
from testbed.viewer.scene import scene_of
from testbed.viewer.show import start_viewer

Shown = Run | str | Path


def view(runs: Shown | Sequence[Shown], path: str | Path | None = None) -> Path:
    """Show runs in Rerun's viewer: robot, reaction, predictions, friction, estimates.

    Args:
        runs: One or several, or folders of runs.
        path: The .rrd file to write, and nothing is opened; default a temporary one, which the
            viewer shows while Python goes on.

    Returns:
        The file.

    Raises:
        ExperimentError: A folder holds no run.
        ViewerError: There is no viewer, or no screen for it.
    """
    several = [runs] if isinstance(runs, (Run, str, Path)) else list(runs)
    shown = [each if isinstance(each, Run) else read_run(Path(each)) for each in several]
    place = Path(tempfile.mkdtemp()) / f"{shown[0].name}.rrd" if path is None else Path(path)
    write_rrd([scene_of(run, growth(run)) for run in shown], place)
    if path is None:
        start_viewer(place)
    return place
