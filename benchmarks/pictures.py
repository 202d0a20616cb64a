"""What it takes to show a run: a minute at 1 kHz for the viewer, and its report."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.lines import print_lines
from benchmarks.timing import least
from testbed.lab.experiment.carry_out import carry_out
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.results import read_run, write_run
from testbed.view.run_page import write_report
from testbed.view.viewer.log import write_runs_rrd
from testbed.view.viewer.scene import build_scene


def pictures(rounds: int = 3) -> dict[str, Any]:
    """Seconds of one core, and sizes, for table6."""
    experiment = Experiment.from_toml("experiments/table6.toml")
    with tempfile.TemporaryDirectory() as folder:
        place, rrd, page = (Path(folder) / name for name in ("run", "run.rrd", "run.html"))
        write_run(carry_out(experiment), place)
        run = read_run(place)
        scene = build_scene(run)
        seconds = least(
            {
                "rrd": lambda: write_runs_rrd([scene], rrd),
                "scene and rrd": lambda: write_runs_rrd([build_scene(run)], rrd),
                "report": lambda: write_report(run, page),
            },
            rounds,
            wall=True,
        )
        sizes = {"rrd [MB]": rrd.stat().st_size / 1e6, "page [MB]": page.stat().st_size / 1e6}
    return {
        "bench": "table6 to look at, seconds",
        **{name: round(value, 2) for name, value in (seconds | sizes).items()},
    }


def main() -> None:
    """Seconds and sizes of what a run is looked at with."""
    print_lines([pictures()])
