"""One page of each kind, made once in a process, and what a person sees of a page."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

import testbed as tb
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.campaign_section import write_campaign_page
from testbed.campaigns.conduct import places_of
from testbed.campaigns.results import Results, read_results, write_rows
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.importing.check.mapping_solution import KNOWN, MappingSolution
from testbed.importing.check.plate import WrenchFit
from testbed.importing.import_report import Draft
from testbed.lab.experiment.excite import design_problem
from testbed.lab.experiment.motions import CheckedMotion, checked_motion
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
    found = replace(run.estimates["external"], nuisances=numbers)
    return replace(run, estimates={**run.estimates, "external": found})


def hostile() -> tb.Run:
    """A run in which everything is called by HOSTILE."""
    tree = robot("puma")
    joints = tuple(replace(each, name=f"{each.name}{HOSTILE}") for each in tree.joints)
    tree = replace(tree, name=HOSTILE, joints=joints)
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
    return checked_motion(ROOT / "experiments/motions/table6.toml")


def excitation() -> Excitation:
    """That motion, as if it had been designed and promised something."""
    found, rng = checked(), np.random.default_rng(0)
    names = tb.minimal_set(found.rules.tree, "reaction").names
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
    for run in places_of(asked):
        levels = asked.cells[run.cell].levels
        factors = dict(zip((f"factor/{name}" for name in asked.factors), levels, strict=True))
        rows.append(made_up(asked, run) | factors | {"cell": run.cell, "replicate": run.replicate})
    rows[0] |= {"status": "failed", "error": HOSTILE}
    write_rows(place / "results.parquet", asked, rows)
    return read_results(place / "results.parquet")


def mapping() -> MappingSolution:
    """A mapping that was solved, made up."""
    time = np.linspace(0.0, 5.0, 200)
    wrench = np.sin(np.outer(time, np.arange(1, 7)))
    read = WrenchFit(time, wrench, 0.9 * wrench, np.full(6, 0.01))
    notes = {("wrench", "rate"): KNOWN[0], ("wrench", "file"): KNOWN[0] + HOSTILE}
    draft = Draft({"wrench": {"rate": 100.0, "file": HOSTILE}}, notes)
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


@dataclass
class Seen(HTMLParser):
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

    heads: list[Row] = field(default_factory=list)
    links: list[Row] = field(default_factory=list)
    titles: list[Row] = field(default_factory=list)
    tables: list[list[Row]] = field(default_factory=list)
    open: dict[tuple[str, str], int] = field(default_factory=dict)
    drawings: list[dict[str, str]] = field(default_factory=list)
    homes: list[dict[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self._folds, self._into = 0, [""]
        self._div: dict[str, str] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        own = {name: value or "" for name, value in attrs}
        lists: dict[str, Any] = {"h1": self.titles, "h2": self.heads, "a": self.links}
        self._folds += tag == "details"
        if tag in lists:
            self._into = [own.get("id") or own.get("href", "").removeprefix("#"), ""]
            lists[tag].append(self._into)
        elif tag == "div":
            self._div = own
        elif tag == "table":
            self.tables.append([])
            self.homes.append(self._div)
        elif tag == "svg":
            self.drawings.append(own)
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self._into = self.tables[-1][-1]
            self._into.append("")
        if tag in ("svg", "tr") and not self._folds:
            section = self.heads[-1][0] if self.heads else ""
            self.open[section, tag] = self.open.get((section, tag), 0) + 1

    def handle_endtag(self, tag: str) -> None:
        self._folds -= tag == "details"
        if tag in ("td", "th", "h1", "h2", "a"):
            self._into = [""]

    def handle_data(self, data: str) -> None:
        self._into[-1] += data


@cache
def seen(name: str) -> Seen:
    """What is seen of a page."""
    found = Seen()
    found.feed(re.sub(r"<style>.*?</style>", "", page(name).read_text(), flags=re.DOTALL))
    return found
