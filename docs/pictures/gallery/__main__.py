"""Counts of robots, what came of the experiments: `python -m docs.pictures.gallery`.

With names only these are made anew. All take some minutes; the robots of example-robot-data
need the extra `dev`.
"""

from __future__ import annotations

import json
import sys
import sysconfig
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import testbed as tb
from docs.gallery import (
    DOCUMENT,
    FAULTS,
    FIGURES,
    MODULE,
    ROBOTS,
    ROOT,
    Robot,
    as_markdown,
    experiments,
)
from docs.marks import write
from docs.pictures.drawing import error_dots, placed, save
from docs.pictures.explained import errors_of_run
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.conduct import conduct
from testbed.campaigns.results import RESULTS_FILE, read_campaign_results
from testbed.campaigns.summary import summarise
from testbed.cli.reading import ReadingOptions
from testbed.lab.experiment.summary import metric_text, percent_text
from testbed.view.drawing import svg
from testbed.view.drives import curve_lines
from testbed.view.figures import Panel

PACKAGE = Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix/share/example-robot-data"
METHODS = {"wrench": "force plate", "torque": "joint torques"}
ESTIMATED = {"torque": "with the fault", "wrench": "with it estimated"}


def main(names: list[str]) -> None:
    """Make pictures and figures, then the page.

    Args:
        names: Of robots and experiments; all if there are none.
    """
    figures = json.loads(FIGURES.read_text()) if FIGURES.exists() else {}
    for robot in ROBOTS:
        if not names or robot.name in names:
            figures[robot.name] = counted(robot)
    for path in experiments():
        if not names or path.stem in names:
            print(path.stem, flush=True)
            figures[path.stem] = varied(path) if path == FAULTS else carried_out(path)
        FIGURES.write_text(json.dumps(figures, indent=1, sort_keys=True) + "\n")
    write(DOCUMENT, MODULE, as_markdown)


def counted(robot: Robot) -> dict[str, int]:
    """Count a robot's joints and base parameters."""
    folder = PACKAGE if robot.file.startswith("robots/") else ROOT
    model, held = folder / robot.file, [*robot.lock]
    tree = ReadingOptions(
        model, weld_root=robot.weld, lock=held, lock_mimic=robot.mimic
    ).file.tree()
    counts = {of: tb.minimal_set(tree, of).count for of in ("torque", "wrench")}
    return {"joints": tree.n, **counts}


def carried_out(path: Path) -> dict[str, str]:
    """Carry out an experiment and draw what came of it."""
    experiment = tb.Experiment.from_toml(path)
    run = tb.carry_out(experiment)
    if run.drives is not None:
        shows = draw_friction(path.stem, run)
    else:
        errors = errors_of_run(run)
        width, height, parts = error_dots(errors, {m: METHODS[m] for m in run.estimates})
        shows = "Relative errors of the parameters, by the plate and by joint torques"
        save(f"gallery/{path.stem}", width, height, parts, shows)
    found = [
        f"{name.replace('_', ' ')} {metric_text(run, name)} ({bound.wanted})"
        for name, bound in experiment.expect.items()
    ]
    said = f"Obtained: {'; '.join(found)}."
    return {"claim": experiment.claim, "command": "run", "obtained": said, "shows": shows}


def draw_friction(name: str, run: Any) -> str:
    """Each joint's friction over its speed, as the plate shows it."""
    parts, height = [], 170
    for k, curve in enumerate(run.drives.curves):
        speed, torque, sigma = curve_lines(curve)
        panel = Panel(
            f"friction of {curve.joint} [{curve.unit}]",
            {"wrench": (speed, torque)},
            "speed [rad/s]",
            bands={"wrench": 2 * sigma},
        )
        parts.append(placed(svg(panel), 0, k * height, 400, height))
    shows = "Friction of every joint over its speed, by the plate, without a friction model"
    save(f"gallery/{name}", 400, height * len(parts), parts, shows)
    return shows


def varied(path: Path) -> dict[str, str]:
    """Carry out a campaign over faults: errors with each, and where it is estimated."""
    campaign, errors = Campaign.load(path), defaultdict[str, dict[str, float]](dict)
    with TemporaryDirectory() as folder:
        conduct(campaign, Path(folder))
        found = summarise(read_campaign_results(Path(folder) / RESULTS_FILE).rows)
    for each in found:
        fault, _, estimated = str(*each.levels.values()).partition("; ")
        errors[fault]["wrench" if estimated else "torque"] = 100 * each.error
    width, height, parts = error_dots(errors, ESTIMATED, left=230)
    shows = "Rms error of the plate's estimate with one fault at a time, and with it estimated"
    save(f"gallery/{path.stem}", width, height, parts, shows)
    most = max(row["wrench"] for row in errors.values() if "wrench" in row)
    said = f"Obtained: {len(errors) - 1} faults; estimated, at most {percent_text(most / 100)}."
    claim = campaign.tables.claim
    return {"claim": claim, "command": "campaign", "obtained": said, "shows": shows}


if __name__ == "__main__":
    main(sys.argv[1:])
