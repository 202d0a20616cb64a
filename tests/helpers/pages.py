"""One page of each kind, made once in a process, and what a person sees of a page."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import testbed as tb
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.campaign_section import write_campaign_page
from testbed.campaigns.conduct import campaign_runs
from testbed.campaigns.results import Results, read_campaign_results, write_rows
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.importing.check.draft_mapping import NOTE_PREFIXES
from testbed.importing.check.mapping_solution import MappingSolution
from testbed.importing.check.plate import WrenchFit
from testbed.importing.import_report import MappingDraft
from testbed.lab.experiment.excite import design_problem
from testbed.lab.experiment.motions import CheckedMotion, prove_motion_file
from testbed.motion.design import Design
from testbed.motion.excite import Excitation
from testbed.motion.information import Prediction
from testbed.view.mapping import write_mapping_page
from testbed.view.motion import write_motion_page
from testbed.view.run_page import write_report
from tests.helpers.campaigns import NOISES, campaign_file, made_up
from tests.helpers.ideal import ideal
from tests.helpers.paths import ROOT
from tests.helpers.runs import experiment, noisy, robot, run_of, without
from tests.scenarios.scenarios import result

HOSTILE = "<script>alert(1)</script>$\\foo_{$|`\"'&"
"""A name that must stay one wherever it is shown."""

GRID = (
    NOISES
    + '[[factor]]\nname = "encoder"\nset = ["measurement.encoder_noise=$"]\nvalues = [1e-5, 1e-4]\n'
)


def plated() -> tb.Run:
    """The run with drives, as if calibration had found 2 % of Fz in Mx, and 1 % of Fy."""
    run: tb.Run = result("drives")
    numbers = (
        NuisanceEstimate("matrix", "gain/Fy", "", 1.01, 1e-3),
        NuisanceEstimate("matrix", "crosstalk/Mx/Fz", "m", 0.02, 1e-4),
    )
    found = replace(run.estimates["wrench"], nuisances=numbers)
    return replace(run, estimates={**run.estimates, "wrench": found})


def hostile() -> tb.Run:
    """A run in which everything is called by HOSTILE."""
    tree = robot("puma")
    joints = tuple(replace(each, name=f"{each.name}{HOSTILE}") for each in tree.joints)
    tree = replace(tree, name=HOSTILE, joints=joints, file=None)  # no file has such joints
    asked = experiment().model_copy(update={"name": HOSTILE, "claim": HOSTILE})
    return replace(
        run_of(tree, asked=asked), name=HOSTILE, diagnostics=(Diagnostic("note", HOSTILE),)
    )


def half() -> tb.Run:
    """Without a plate."""
    return run_of(robot("gantry"), without(noisy(ideal(robot("gantry"))), "wrench"))


def silent() -> tb.Run:
    """Without any signal to identify from."""
    return run_of(robot("puma"), replace(ideal(robot("puma")), wrench=None, torque=None))


RUNS: dict[str, Callable[[], tb.Run]] = {
    "ur5": lambda: result("ur5"),
    "gantry": lambda: result("gantry"),
    "plate": plated,
    "bodies": lambda: result("bodies"),
    "hostile": hostile,
    "half": half,
    "silent": silent,
}
"""Whose reports there are."""

OTHERS = ("motion", "campaign", "mapping")


@cache
def run_named(name: str) -> tb.Run:
    """One of RUNS."""
    return RUNS[name]()


@cache
def checked() -> CheckedMotion:
    """The motion of table6."""
    return prove_motion_file(ROOT / "experiments/motions/table6.toml")


def excitation() -> Excitation:
    """That motion, as if it had been designed and promised something."""
    found, rng = checked(), np.random.default_rng(0)
    names = tb.minimal_set(found.rules.tree, "wrench").names
    size = 10 ** rng.uniform(-5, 1, (2, len(names)))
    promise = Prediction(names, size[0], 0.1 * size[1], 30.0)
    design = Design(found.motion, -9.0, found.proof, 1, True)
    problem = replace(design_problem(found.experiment), rules=found.rules)
    random = replace(promise, relative=size[1])
    return Excitation(problem, design, promise, random, found.experiment.motion.candidates)


@cache
def campaign() -> Results:
    """Results of a campaign of made-up outcomes, a failure among them."""
    place = Path(mkdtemp())
    asked = Campaign.load(campaign_file(place, 12, GRID))
    rows = []
    for run in campaign_runs(asked):
        levels = asked.cells[run.cell].levels
        factors = dict(zip((f"factor/{name}" for name in asked.factors), levels, strict=True))
        rows.append(made_up(asked, run) | factors | {"cell": run.cell, "replicate": run.replicate})
    rows[0] |= {"status": "failed", "error": HOSTILE}
    write_rows(place / "results.parquet", asked, rows)
    return read_campaign_results(place / "results.parquet")


def mapping() -> MappingSolution:
    """A mapping that was solved, made up."""
    time = np.linspace(0.0, 5.0, 200)
    wrench = np.sin(np.outer(time, np.arange(1, 7)))
    read = WrenchFit(time, wrench, 0.9 * wrench, np.full(6, 0.01))
    notes = {("wrench", "rate"): NOTE_PREFIXES[0], ("wrench", "file"): NOTE_PREFIXES[0] + HOSTILE}
    draft = MappingDraft({"wrench": {"rate": 100.0, "file": HOSTILE}}, notes)
    return MappingSolution(draft, (Diagnostic("note", HOSTILE),), read, replace(read, fit=wrench))


@cache
def page(name: str) -> Path:
    """The file of a page; where it has numbers for programs they lie beside it."""
    path = Path(mkdtemp()) / f"{name}.html"
    if name in RUNS:
        write_report(run_named(name), path)
    elif name == "motion":
        write_motion_page(path, excitation())
    elif name == "campaign":
        write_campaign_page(path, campaign())
    else:
        write_mapping_page(path, mapping())
    return path


Row = list[str]
SVG = "{http://www.w3.org/2000/svg}svg"


@dataclass(frozen=True)
class Seen:
    """What a person sees of a page, or hears.

    Attributes:
        heads: Headings of sections: place and words.
        links: Of the list of contents, likewise.
        titles: Headings of the page.
        tables: Rows of cells; rows and tables that are folded away too.
        open: Of each section, what is seen before anything is unfolded: drawings and rows.
        drawings: Attributes of drawings.
        homes: Attributes of the elements that tables stand in.
    """

    heads: list[Row]
    links: list[Row]
    titles: list[str]
    tables: list[list[Row]]
    open: Counter[tuple[str, str]]
    drawings: list[dict[str, str]]
    homes: list[dict[str, str]]


def words(element: ET.Element) -> str:
    return "".join(element.itertext())


@cache
def seen(name: str) -> Seen:
    """What is seen of a page, which is well-formed."""
    text = re.sub("<w?br>", "", page(name).read_text()).replace("&middot;", "\u00b7")
    body = ET.fromstring(text[text.index("<body") : text.index("</html>")])
    folded = {each for fold in body.iter("details") for each in fold.iter()}
    section, found = "", Counter[tuple[str, str]]()
    for each in body.iter():
        section = each.get("id", "") if each.tag == "h2" else section
        if each.tag in (SVG, "tr") and each not in folded:
            found[section, "tr" if each.tag == "tr" else "svg"] += 1
    return Seen(
        [[each.get("id", ""), words(each)] for each in body.iter("h2")],
        [[each.get("href", "").removeprefix("#"), words(each)] for each in body.iter("a")],
        [words(each) for each in body.iter("h1")],
        [[[*map(words, row)] for row in table.iter("tr")] for table in body.iter("table")],
        found,
        [drawing.attrib for drawing in body.iter(SVG)],
        [home.attrib for home in body.iter() for _ in home.findall("table")],
    )
