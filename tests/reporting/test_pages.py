"""Pages of all kinds: complete, readable by everybody, safe to send, and of one mind with JSON."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.verdict import verdict_of
from testbed.core.base.summary_table import number_with_sigma
from testbed.core.estimation.estimate import METHOD_LABELS
from testbed.core.estimation.influence import names_by_influence
from testbed.core.parameters.rules import SIGNALS
from testbed.core.recordings.metadata import Metadata
from testbed.lab.experiment.evaluate import perturbed_robot
from testbed.lab.experiment.summary import claim_verdict, summary
from testbed.view.figures import Panel
from testbed.view.run_page import write_report
from testbed.view.signals import sections
from tests.helpers.measured import measured
from tests.helpers.pages import OTHERS, RUNS, page, plated, run_named, seen
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot

pytestmark = pytest.mark.slow

SECTIONS = {
    "ur5": "warnings errors parameters prediction spectra friction map settings",
    "gantry": "warnings errors parameters prediction spectra friction map settings",
    "plate": "warnings errors parameters prediction spectra friction drives "
    "instrument map settings",
    "bodies": "warnings errors parameters claims prediction spectra friction bodies "
    "map settings",
    "hostile": "warnings errors parameters prediction spectra friction map settings",
    "half": "warnings errors parameters prediction spectra map settings",
    "silent": "warnings prediction map settings",
    "motion": "sigma motion limits",
    "campaign": "cells failures",
    "mapping": "values before after",
}  # fmt: skip
"""What there is to read of each page."""


def numbers_of(name: str) -> dict[str, Any]:
    """The JSON beside a report."""
    text = page(name).with_suffix(".json").read_text()
    found: dict[str, Any] = json.loads(text, parse_constant=pytest.fail)
    return found


def plain(text: str) -> str:
    """As a page writes it, without its tags."""
    for written, sign in (("+-", "±"), ("^2", "²"), (" %", "\u00a0%")):
        text = text.replace(written, sign)
    return text


def rows_of(figure: dict[str, Any]) -> list[list[str]]:
    """Of the table of a figure in such JSON."""
    return [figure["table"]["heads"], *figure["table"]["rows"]]


def text_of(path: Path) -> str:
    """What stands on a page outside of drawings."""
    html = re.sub(r"(?s)<(svg|style)\b.*?</\1>", " ", path.read_text())
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", html))


@pytest.mark.parametrize("name", SECTIONS)
def test_a_page_is_complete_and_can_be_read_by_everybody(name: str) -> None:
    """By those who read on a phone, who hear it, who are sent it without a network."""
    found, text = seen(name), page(name).read_text()
    assert set(SECTIONS) == {*RUNS, *OTHERS}
    assert len(found.titles) == 1
    assert " ".join(place for place, _ in found.heads) == SECTIONS[name]
    assert found.links == found.heads  # the list of contents
    for table in found.tables:
        assert len(table) > 1 or name == "silent"
        assert {len(row) for row in table} == {len(table[0])}, table[0]
        assert all(table[0][1:])
        assert all(row[0] for row in table[1:])
    for home in found.homes:  # what is wider than the page scrolls, by keys too, and has a name
        assert (home["tabindex"], home["role"], bool(home["aria-label"])) == ("0", "region", True)
    for drawing in found.drawings:
        assert (drawing["role"], bool(drawing["aria-label"].strip())) == ("img", True)
        assert not {"width", "height"} & set(drawing)  # as wide as there is room
    drawn = {section: n for (section, tag), n in found.open.items() if tag == "svg"}
    rows = {section: n for (section, tag), n in found.open.items() if tag == "tr"}
    assert max(drawn.values(), default=0) <= 6 or name in OTHERS
    assert max(rows.values(), default=0) <= 25
    assert not re.search(r"<script|<link|@import|url\((?!#)|src=", text)
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"|http-equiv=', "", text)
    assert text.count("content=\"default-src 'none'; ") == 1
    for target in re.findall(r'href="([^"]*)"', text):
        assert target.startswith(("#", "data:image/png"))
    said = re.sub(r"(?s)base64,[^\"]*|<style.*?</style>", "", text)
    assert not re.search(r"(?<![\w-])(nan|-?inf|NaN|None)(?![\w-])", said)
    assert "\u2026" not in said
    if name in ("hostile", "campaign", "mapping"):  # what a file says runs on no reader's machine
        shown = text_of(page(name)).replace("&lt;", "<").replace("&gt;", ">")
        assert "<script>alert(1)</script>" in shown


@pytest.mark.parametrize("name", RUNS)
def test_page_and_numbers_are_those_of_the_run(name: str) -> None:
    """Whoever reads the page, or computes with the JSON beside it, has the run's own numbers."""
    run, numbers, found = run_named(name), numbers_of(name), seen(name)
    words = [[[plain(cell).strip() for cell in row] for row in table] for table in found.tables]
    for figure in [*numbers["figures"], *([numbers["errors"]] if numbers["errors"] else [])]:
        table = [[plain(cell) for cell in row] for row in rows_of(figure)]
        assert table in words, figure["id"]
        assert bool(figure["panels"]) == (bool(run.estimates) and figure["id"] != "bodies")
    for table in numbers["parameters"]:
        names = [row[0] for row in table["rows"]]
        assert names == names_by_influence(run.estimates.values(), run.truths)
        rows = (row for each in words if each[0] == table["heads"] for row in each[1:])
        assert [plain(name) for name in names] == [row[0] for row in rows]
    for method, estimate in run.estimates.items():
        for k, parameter in enumerate(estimate.names):
            if parameter in estimate.unidentifiable:
                continue
            value, sigma = float(estimate.values[k]), float(estimate.sigma[k])
            known = {"value": value, "sigma": sigma, "unit": estimate.units[k]}
            assert numbers["estimates"][method][parameter] == known
            stated = plain(number_with_sigma(value, sigma))
            assert any(row[0] == parameter and stated in row for table in words for row in table)
    said = plain(text_of(page(name))).replace("\u00a0", " ")
    for line in [*summary(run), claim_verdict(run)] if name != "hostile" else []:
        assert plain(line).replace("\u00a0", " ").replace("<", "&lt;").replace("'", "&#39;") in said


def test_residuals_in_tables_and_plots_are_those_of_the_predictions() -> None:
    run = run_named("ur5")
    smooth = tb.predict(run).smoothed(10.0)
    figure = sections(tb.predict(run))[0]
    panels, rows = iter(figure.panels), iter(figure.table.rows)
    for channel in smooth.channels:
        panel, row = next(panels), dict(zip(figure.table.heads, next(rows), strict=True))
        assert isinstance(panel, Panel)
        assert panel.title == f"{channel.name} [{channel.unit}]"
        spread = channel.measured.std()
        assert float(row["spread (rms)"]) == pytest.approx(spread, rel=0.01)
        for method in SIGNALS:
            size = np.sqrt(np.mean(channel.residuals[method] ** 2))
            assert float(row[f"residual rms, {METHOD_LABELS[method]}"]) == pytest.approx(
                size, rel=0.01
            )
            share = float(row[f"of spread, {METHOD_LABELS[method]}"].rstrip("% "))
            assert share == pytest.approx(100 * size / spread, rel=0.06)
        below = panel.lower_plots[f"residual [{channel.unit}]"]
        for method in channel.predicted.keys() & below.keys():
            time, drawn = below[method]
            at = np.searchsorted(smooth.motion.t, time)
            np.testing.assert_array_equal(drawn, channel.residuals[method][at])
    assert [*panels, *rows] == []


def test_predictions_are_held_against_what_the_plate_ought_to_have_shown() -> None:
    run = plated()
    matrix = np.eye(6)
    matrix[1, 1], matrix[3, 2] = 1.01, 0.02
    right = run.recording.measured("wrench") @ np.linalg.inv(matrix).T
    np.testing.assert_allclose(tb.predict(run).recording.measured("wrench"), right, rtol=1e-9)


def test_drives_and_bodies_of_the_page_are_the_runs() -> None:
    run, bodies = plated(), run_named("bodies").consistent
    assert run.drives is not None
    assert bodies is not None
    figures = (f for name in ("plate", "bodies") for f in numbers_of(name)["figures"])
    tables = {figure["id"]: figure["table"]["rows"] for figure in figures}
    for row, drive in zip(tables["drives"], run.drives.estimates, strict=True):
        assert row[:2] == [drive.joint, number_with_sigma(drive.constant, drive.sigma, short=True)]
    assert [row[0] for row in tables["bodies"]] == [*bodies.links]
    for row, prior, own in zip(tables["bodies"], bodies.prior, bodies.standard, strict=True):
        masses = [float(row[k].split()[0]) for k in (1, 2)]
        assert masses == pytest.approx([prior[0], own[0]], rel=1e-3)
        centre = np.array(row[3].split(), dtype=float)
        np.testing.assert_allclose(centre * own[0], own[1:4], atol=1e-3)


def test_the_same_bits_every_time_and_both_files_or_none(tmp_path: Path) -> None:
    run = run_named("bodies")
    beside = tb.report(run, tmp_path / "r.html").with_suffix(".json")
    for made in (tmp_path / "r.html", beside):
        assert made.read_bytes() == page("bodies").with_suffix(made.suffix).read_bytes()
    (tmp_path / "q.json").mkdir()
    with pytest.raises(OSError, match="q.json"):
        write_report(run, tmp_path / "q.html")
    assert not (tmp_path / "q.html").exists()
    with refuses(tb.TestbedError, str(tmp_path)):
        tb.report(tmp_path, tmp_path / "none.html")
    assert not (tmp_path / "none.html").exists()


def test_a_page_of_torques_says_nothing_of_a_plate_and_has_one_prior(tmp_path: Path) -> None:
    """An imported recording: its verdict first, one width of the prior, no count that differs."""
    tree = robot("puma")
    wrong = perturbed_robot(tree, 0.3, np.random.default_rng(3))
    slow = replace(measured(tree, 5, speed=0.1), wrench=None, metadata=Metadata(mapping={}))
    bodies = tb.prior_of(wrong), ConsistencyOptions()
    run = tb.assemble_run(wrong, slow, name="slow", prior_error=0.2, bodies=bodies)
    assert run.consistent is not None
    assert run.posterior["torque"].prior_error == run.consistent.prior_error == 0.2
    said = verdict_of(run.estimates.values(), run.posterior.values())
    write_report(run, tmp_path / "page.html")
    text = text_of(tmp_path / "page.html")
    assert not re.search(r"(?i)\bplate|\bbedplate|wrench", text)
    assert plain(said[0].text)[1:] in summary(run)[0].replace(" %", "\u00a0%")
    determined = len(run.posterior["torque"].determined)
    counts = re.findall(r"(\d+) of (\d+) parameters", text)
    assert set(counts) == {(str(determined), str(run.posterior["torque"].count))}
