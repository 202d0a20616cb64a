"""How pages are laid out: what is looked for stands first, and no page grows with its robot."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.campaign.campaign import Campaign
from testbed.campaign.campaign_summary import read_campaign, summarise
from testbed.campaign.conduct import conduct
from testbed.excitation.collision_model import collision_model
from testbed.excitation.limits import limits_of
from testbed.excitation.proof import Margin, Proof, Rules
from testbed.excitation.random_motion import random_motion
from testbed.reporting.campaign_page import write_campaign_page
from testbed.reporting.html import write_report
from testbed.reporting.motion_page import write_motion_page
from testbed.reporting.sections import clear_shares
from testbed.robot.visuals.appearance import load_appearance
from tests.helpers.browser import browser
from tests.helpers.campaigns import NOISES, Odd, campaign_file
from tests.helpers.ideal import ideal
from tests.helpers.robots import random_robot
from tests.helpers.runs import experiment, noisy, run_of
from tests.reporting.test_page_in_a_browser import OVERLAPS

pytestmark = pytest.mark.slow

TALLEST = {1440: 6000, 390: 11350}
"""Of a report [pixels], by the window's width: half of what seven joints took once."""

WIDER = """
return [...document.querySelectorAll('main *')]
  .filter(e => !e.closest('svg') && !e.closest('.unseen')
    && e.getBoundingClientRect().right > innerWidth + 1)
  .map(e => e.tagName + ' ' + e.textContent.slice(0, 40))"""
"""Elements that end outside of the window."""


@dataclass
class Seen(HTMLParser):
    """What of a page is to be seen before anything is unfolded.

    Attributes:
        plots: Drawings of each section.
        rows: Of each section, rows of its longest table.
        labels: Of all drawings, folded or not.
        heads: Section by section, its place and title.
        links: Of the list of contents, likewise.
    """

    plots: dict[str, int] = field(default_factory=dict)
    rows: dict[str, int] = field(default_factory=dict)
    labels: list[str] = field(default_factory=list)
    heads: list[tuple[str, str]] = field(default_factory=list)
    links: list[tuple[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self._folds = self._now = 0
        self._open: list[tuple[str, str]] | None = None

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        own = {name: value or "" for name, value in attrs}
        if tag == "h2":
            self.heads.append((own["id"], ""))
            self._open = self.heads
        if tag == "a" and own.get("href", "").startswith("#"):
            self.links.append((own["href"][1:], ""))
            self._open = self.links
        self._folds += tag == "details"
        section = self.heads[-1][0] if self.heads else ""
        if tag == "svg":
            self.labels.append(own.get("aria-label", ""))
        if not self._folds:
            self._now = 0 if tag == "table" else self._now + (tag == "tr")
            self.rows[section] = max(self.rows.get(section, 0), self._now)
            self.plots[section] = self.plots.get(section, 0) + (tag == "svg")

    def handle_endtag(self, tag: str) -> None:
        self._folds -= tag == "details"
        if tag in ("h2", "a"):
            self._open = None

    def handle_data(self, data: str) -> None:
        if self._open is not None:
            place, words = self._open[-1]
            self._open[-1] = place, words + data


def seen(page: Path) -> Seen:
    found = Seen()
    found.feed(re.sub(r"<style>.*?</style>", "", page.read_text(), flags=re.DOTALL))
    return found


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a robot of twenty joints."""
    tree = random_robot(np.random.default_rng(1), 20).tree()
    run = run_of(tree, noisy(ideal(tree, duration=5.0)), asked=experiment())
    path = tmp_path_factory.mktemp("large") / "report.html"
    write_report(run, path)
    return path


@pytest.fixture(scope="module")
def motion(puma: tb.Tree, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a motion that nobody searched for."""
    limits, rng = limits_of(puma), np.random.default_rng(0)
    names = tuple(f"K{k}" for k in range(48))
    told: Any = SimpleNamespace(
        names=names, sigma=np.ones(48), relative=10 ** rng.uniform(-4.9, -1.1, 48), rms=1.0
    )
    collision = collision_model(puma, load_appearance(puma).shapes)
    kept = np.full(len(collision.pairs), 0.02)
    proof = Proof(tuple(Margin(f"velocity of '{k}'", 0.1, 1.0) for k in range(59)), 10, 0)
    design = SimpleNamespace(motion=random_motion(puma, limits, 0.1, 4, rng), proof=proof)
    found: Any = SimpleNamespace(
        experiment=SimpleNamespace(motion=SimpleNamespace(duration=20.0)),
        tree=puma,
        rules=Rules(puma, limits, 0.9, (), collision, kept),
        design=design,
        predicted=told,
        random_predicted=told,
        gain=1.0,
        beside_random="",
        warnings=("the plate hums",),
    )
    path = tmp_path_factory.mktemp("motion") / "motion.html"
    write_motion_page(path, found)
    return path


def of_campaign(replicates: int, place: Path) -> Path:
    campaign = Campaign.load(campaign_file(place, replicates, NOISES))
    conduct(campaign, place / "r", Odd())
    write_campaign_page(place / "page.html", summarise(read_campaign(place / "r")))
    return place / "page.html"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return of_campaign(12, tmp_path_factory.mktemp("campaign"))


@pytest.fixture(params=["large", "motion", "campaign"])
def any_page(request: pytest.FixtureRequest) -> Path:
    found: Path = request.getfixturevalue(request.param)
    return found


def test_a_page_shows_no_more_for_more_joints(page: Path, large: Path) -> None:
    """Twenty joints, and some hundred parameters: the rest is folded away."""
    for each in (page, large):
        found = seen(each)
        assert max(found.plots.values()) <= 6
        assert max(found.rows.values()) <= 1 + 10
    assert len(seen(large).labels) > 2 * len(seen(page).labels)


def test_every_section_is_in_the_list_of_contents(any_page: Path) -> None:
    found = seen(any_page)
    assert found.heads == found.links
    assert len({place for place, _ in found.heads}) == len(found.heads) > 2


def test_every_drawing_says_what_it_shows_over_what_in_which_unit(
    page: Path, any_page: Path
) -> None:
    for each in (page, any_page):
        for label in seen(each).labels:
            assert label
            if " over " in label and each.parent.name.startswith(("report", "large", "motion")):
                assert re.search(r"over .*\[.+\]$", label), label


def test_no_distribution_is_drawn_of_few_runs(tmp_path: Path) -> None:
    """Twelve errors are no curve; those of forty are."""
    for replicates, drawn in ((6, False), (20, True)):
        place = tmp_path / str(replicates)
        place.mkdir()
        places = [where for where, _ in seen(of_campaign(replicates, place)).heads]
        assert ("scores" in places) is drawn
        assert "coverage" in places


@pytest.mark.parametrize("width", list(TALLEST))
def test_nothing_ends_outside_of_the_window(any_page: Path, width: int, tmp_path: Path) -> None:
    """Folds opened, too; and before they are, a report ends after a few windows."""
    with browser(tmp_path, width) as window:
        window.open(any_page)
        tall = window.run("return document.documentElement.scrollHeight")
        assert tall <= TALLEST[width]
        window.run("document.querySelectorAll('details').forEach(d => d.open = true)")
        assert window.run(WIDER) == []
        assert window.run(OVERLAPS) == []
        assert window.run("return document.documentElement.scrollWidth") <= width


def test_joints_whose_friction_noise_does_not_hide_are_shown_first() -> None:
    """Whatever share of its torque is unexplained: a light joint's is all noise."""
    rng, size = np.random.default_rng(2), np.array([0.0, 3.0, 0.3, 1.0])
    friction = size * np.sign(rng.normal(size=(5000, 1)))
    smooth: Any = SimpleNamespace(unexplained_torque=friction)
    clear = clear_shares(friction + rng.normal(size=(5000, 4)), smooth)
    assert np.argsort(clear).tolist() == np.argsort(size).tolist()
