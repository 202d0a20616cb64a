"""Robots on their plates, what came of the experiments: `python -m docs.pictures.gallery`.

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

import numpy as np

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
from docs.pictures.explained import errors_of
from testbed.bodies.shapes.appearance import load_appearance
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.conduct import conduct
from testbed.campaigns.results import RESULTS, read_results
from testbed.campaigns.summary import summarise
from testbed.cli.reading import Reading
from testbed.lab.experiment.summary import obtained, percent
from testbed.view.drives import curve_lines
from testbed.view.figures import Panel
from testbed.view.portrait import portrait

PACKAGE = Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix/share/example-robot-data"
METHODS = {"external": "force plate", "internal": "joint torques"}
ESTIMATED = {"internal": "with the fault", "external": "with it estimated"}
LONGER = 360
"""The longer side of a robot's picture [pixels]."""


def main(names: list[str]) -> None:
    """Make pictures and figures, then the page.

    Args:
        names: Of robots and experiments; all if there are none.
    """
    figures = json.loads(FIGURES.read_text()) if FIGURES.exists() else {}
    for robot in ROBOTS:
        if not names or robot.name in names:
            figures[robot.name] = drawn(robot)
    for path in experiments():
        if not names or path.stem in names:
            print(path.stem, flush=True)
            figures[path.stem] = varied(path) if path == FAULTS else carried_out(path)
        FIGURES.write_text(json.dumps(figures, indent=1, sort_keys=True) + "\n")
    write(DOCUMENT, MODULE, as_markdown)


def drawn(robot: Robot) -> dict[str, int]:
    """Draw a robot on its plate with the reaction at rest, and count its base parameters."""
    reading = Reading(weld_root=robot.weld, lock=robot.lock, lock_mimic=robot.mimic)
    folder = PACKAGE if robot.file.startswith("robots/") else ROOT
    model = reading.model_file(folder / robot.file)
    tree = model.tree()
    posture = np.array([middle(joint.position_range) for joint in tree.joints])
    posture[: len(robot.posture)] = robot.posture
    still = np.zeros((1, tree.n))
    at_rest = tb.Motion(np.zeros(1), posture[None], still, still)
    wrench = tb.base_wrench(tree, at_rest)[0] + tb.pedestal_wrench(tree)
    svg = portrait(load_appearance(tree, model), posture[None], wrench, robot.title)
    _, _, width, height = map(float, svg.split('viewBox="')[1].split('"')[0].split())
    scale = LONGER / max(width, height)
    width, height = round(width * scale), round(height * scale)
    save(f"gallery/{robot.name}", width, height, [placed(svg, 0, 0, width, height)], robot.title)
    counts = {of: tb.minimal_set(tree, of).count for of in ("dynamic", "reaction")}
    return {"joints": tree.n, **counts}


def middle(ends: Any) -> float:
    """The middle of a range; zero where it has none."""
    return float(np.mean(ends)) if np.isfinite(ends).all() else 0.0


def carried_out(path: Path) -> dict[str, str]:
    """Carry out an experiment and draw what came of it."""
    experiment = tb.Experiment.load(path)
    run = tb.carry_out(experiment)
    if run.drives is not None:
        shows = draw_friction(path.stem, run)
    else:
        width, height, parts = error_dots(errors_of(run), {m: METHODS[m] for m in run.estimates})
        shows = "Relative errors of the parameters, by the plate and by joint torques"
        save(f"gallery/{path.stem}", width, height, parts, shows)
    found = [
        f"{name.replace('_', ' ')} {obtained(run, name)} ({bound.wanted})"
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
            {"external": (speed, torque)},
            "speed [rad/s]",
            bands={"external": 2 * sigma},
        )
        parts.append(placed(panel.svg, 0, k * height, 400, height))
    shows = "Friction of every joint over its speed, by the plate, without a friction model"
    save(f"gallery/{name}", 400, height * len(parts), parts, shows)
    return shows


def varied(path: Path) -> dict[str, str]:
    """Carry out a campaign over faults: errors with each, and where it is estimated."""
    campaign, errors = Campaign.load(path), defaultdict[str, dict[str, float]](dict)
    with TemporaryDirectory() as folder:
        conduct(campaign, Path(folder))
        found = summarise(read_results(Path(folder) / RESULTS).rows)
    for each in found:
        fault, _, estimated = str(*each.levels.values()).partition("; ")
        errors[fault]["external" if estimated else "internal"] = 100 * each.error
    width, height, parts = error_dots(errors, ESTIMATED, left=230)
    shows = "Rms error of the plate's estimate with one fault at a time, and with it estimated"
    save(f"gallery/{path.stem}", width, height, parts, shows)
    most = max(row["external"] for row in errors.values() if "external" in row)
    said = f"Obtained: {len(errors) - 1} faults; estimated, at most {percent(most / 100)}."
    claim = campaign.tables.claim
    return {"claim": claim, "command": "campaign", "obtained": said, "shows": shows}


if __name__ == "__main__":
    main(sys.argv[1:])
