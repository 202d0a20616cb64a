"""What a report says: in the page and in the numbers beside it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from testbed.experiment.experiment_tables import Bound
from testbed.experiment.predictions import predict
from testbed.experiment.run import Run
from testbed.experiment.summary import summary, verdict
from testbed.experiment.unseen import validated
from testbed.identification.estimate import METHODS, SIGNAL_OF
from testbed.identification.influence import by_influence
from testbed.recordings.recording import Recording
from testbed.reporting.contents import LONGEST, contents
from testbed.reporting.facts import asked
from testbed.reporting.html import breakable, typeset, write_report
from testbed.reporting.sections import sections
from tests.helpers.ideal import ideal
from tests.helpers.runs import ROBOTS, experiment, judged_run, noisy, robot, run_of, without

pytestmark = pytest.mark.slow


def numbers_of(page: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads(page.with_suffix(".json").read_text())
    return found


def plain_text(html: str) -> str:
    without_drawings = re.sub(r"(?s)<(svg|style)\b.*?</\1>", " ", html)
    return unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", without_drawings)))


def test_the_report_needs_nothing_else(page: Path) -> None:
    text = page.read_text()
    assert not re.search(r"<script|<link|@import|url\((?!#)|src=", text)
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", text)
    for target in re.findall(r'href="([^"]*)"', text):
        assert target.startswith(("#", "data:image/png"))
    assert page.stat().st_size < 4e6


def test_a_summary_stands_first(page: Path, puma_run: Run) -> None:
    text = plain_text(page.read_text())
    first = plain_text(" ".join(typeset(line) for line in summary(puma_run)))
    assert first in text
    assert text.index(first) < text.index("What was asked")
    assert plain_text(typeset(verdict(puma_run))) in text


def test_the_report_says_what_was_found(page: Path, puma_run: Run) -> None:
    text = page.read_text()
    numbers = json.loads(page.with_suffix(".json").read_text())
    rows = {row["name"]: row for row in numbers["parameters"]}
    for method in METHODS:
        estimate = puma_run.estimates[method]
        for k, name in enumerate(estimate.names):
            assert f">{name}<" in text.replace("<wbr>", "")
            (cell,) = (c for c in rows[name]["cells"] if c["method"] == method)
            assert cell["value"] == estimate.values[k]
            assert cell["sigma"] == estimate.sigma[k]
            z = (estimate.values[k] - puma_run.truths[name]) / estimate.sigma[k]
            assert cell["z"] == pytest.approx(z)
            assert 0 <= cell["left"] <= cell["left"] + cell["width"] <= 100.05
            assert (cell["left"] >= 50) == (z > 0)
    assert list(rows) == by_influence(puma_run.estimates.values(), puma_run.truths)


def test_tables_say_what_the_figures_show(page: Path, puma_run: Run, other: Recording) -> None:
    numbers = json.loads(page.with_suffix(".json").read_text())
    tables = {figure["id"]: figure for figure in numbers["figures"]}
    assert list(tables) == ["prediction", "spectra", "friction"]
    found = predict(puma_run, other).smoothed(10.0)
    rows = {row[0]: row for row in tables["prediction"]["rows"]}
    heads = tables["prediction"]["heads"]
    for signal in found.signals:
        for c, channel in enumerate(signal.channels):
            row = dict(zip(heads, rows[channel], strict=True))
            spread = signal.measured[:, c].std()
            assert float(row["spread (rms)"]) == pytest.approx(spread, rel=0.01)
            for method in METHODS:
                size = np.sqrt(np.mean(signal.residual(method)[:, c] ** 2))
                assert float(row[f"residual rms, {method}"]) == pytest.approx(size, rel=0.01)
                share = float(row[f"of spread, {method}"].rstrip("% "))
                assert share == pytest.approx(100 * size / spread, rel=0.06)
                if signal.kind == "wrench" and method == "external":
                    assert share < 5.0  # on a motion that was not identified
    terms = {(row[0], row[1]): row for row in tables["friction"]["rows"]}
    for joint in puma_run.tree.joints:
        assert float(terms[joint.name, "coulomb"][4]) == pytest.approx(joint.coulomb, rel=1e-3)
        assert float(terms[joint.name, "viscous"][4]) == pytest.approx(joint.viscous, rel=1e-3)


def test_signals_stand_above_what_is_left_over(puma_run: Run, other: Recording) -> None:
    found = predict(puma_run, other)
    figure = sections(found, True)[0]
    smooth = found.smoothed(10.0)
    panels = iter(figure["panels"])
    for signal in smooth.signals:
        for c, (channel, unit) in enumerate(zip(signal.channels, signal.units, strict=True)):
            panel = next(panels)
            assert panel.title == f"{channel} [{unit}]"
            ((title, below),) = panel.below.items()
            assert title == f"residual [{unit}]"
            for method, (time, rest) in below.items():
                at = np.searchsorted(smooth.motion.t, time)
                np.testing.assert_allclose(rest, signal.residual(method)[at, c])
    assert next(panels, None) is None


def test_units_are_written_as_people_write_them(page: Path) -> None:
    text = plain_text(page.read_text())
    assert "kg m²" in text
    assert " ± " in text
    assert "^2" not in text
    assert "+-" not in text


@pytest.mark.slow
def test_the_report_is_the_same_bits_every_time(
    puma_run: Run, other: Recording, page: Path, tmp_path: Path
) -> None:
    write_report(puma_run, tmp_path / "report.html", other)
    assert (tmp_path / "report.html").read_bytes() == page.read_bytes()
    assert numbers_of(tmp_path / "report.html") == numbers_of(page)


@pytest.mark.slow
def test_warnings_are_all_said(puma_run: Run, tmp_path: Path) -> None:
    run = replace(puma_run, warnings=("the plate hums", "mb*2z is 3 kg m^2 +- 1"))
    write_report(run, tmp_path / "r.html")
    text = plain_text((tmp_path / "r.html").read_text())
    assert "the plate hums" in text
    assert "mb*2z is 3 kg m² ± 1" in text
    write_report(replace(puma_run, warnings=()), tmp_path / "q.html")
    assert "Nothing: all parameters are excited" in plain_text((tmp_path / "q.html").read_text())


def test_joints_that_are_held_are_said(puma_run: Run) -> None:
    assert puma_run.model is not None
    held = replace(puma_run.model, lock={"finger": 0.02, "thumb": None})
    facts = dict(asked(replace(puma_run, model=held)))
    assert facts["held"] == "finger at 0.02, thumb where it rests [rad or m]"
    assert "held" not in dict(asked(puma_run))


@pytest.mark.parametrize(("noise", "sign"), [(0.5, "±"), (1e-6, "(")])
def test_values_that_would_be_too_long_have_their_sigma_in_brackets(
    noise: float, sign: str, tmp_path: Path
) -> None:
    """All of a page alike, and it says which; in the numbers nothing changes."""
    tree = robot("puma")
    run = run_of(tree, noisy(ideal(tree), size=noise), asked=experiment())
    write_report(run, tmp_path / "r.html")
    rows = json.loads((tmp_path / "r.json").read_text())["parameters"]
    texts = [c["text"].replace("+-", "±") for row in rows for c in row["cells"] if c["sigma"]]
    assert all(sign in text for text in texts)
    assert max(map(len, texts)) <= LONGEST
    said = plain_text((tmp_path / "r.html").read_text())
    assert ("After the sign ± stands" in said) == (sign == "±")
    assert ("Digits in brackets are" in said) == (sign == "(")
    for row in rows:
        for cell, estimate in zip(row["cells"], run.estimates.values(), strict=True):
            if row["name"] in estimate.names:
                assert cell["sigma"] == estimate.sigma[estimate.names.index(row["name"])]


def test_names_go_on_in_the_next_line_between_words() -> None:
    assert breakable("coulomb/left_hip") == "coulomb/<wbr>left_<wbr>hip"
    assert breakable("<b>_") == "&lt;b&gt;_<wbr>"


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_every_robot_has_its_report(name: str, tmp_path: Path) -> None:
    """Units by the joints' kinds, figures for every channel, valid numbers."""
    run = judged_run(name)
    found = contents(run)
    write_report(run, tmp_path / "r.html")
    json.loads((tmp_path / "r.json").read_text(), parse_constant=pytest.fail)
    panels = [panel["title"] for figure in found["figures"] for panel in figure["panels"]]
    for joint in run.tree.joints:
        assert f"{joint.name} [{'N m' if joint.revolute else 'N'}]" in panels
    assert found["portrait"]["svg"].startswith("<svg")
    assert [row["name"] for row in found["parameters"]]
    assert found["maps"][0]["rows"][0][0] == run.tree.names[0]


@pytest.mark.slow
@pytest.mark.parametrize("lacks", ["wrench", "torque"])
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_one_signal_makes_a_report_too(name: str, lacks: str, tmp_path: Path) -> None:
    tree = robot(name)
    run = run_of(tree, without(noisy(ideal(tree)), lacks))
    found = contents(run)
    (method,) = run.estimates
    assert SIGNAL_OF[method] != lacks
    assert found["methods"] == [method]
    assert [figure["id"] for figure in found["figures"]] == ["prediction", "spectra"]
    write_report(run, tmp_path / "r.html")
    text = plain_text((tmp_path / "r.html").read_text())
    assert f"the recording has no {lacks}" in text
    assert "error / sigma" not in text


def test_a_run_without_estimates_makes_a_report_too(tmp_path: Path) -> None:
    tree = robot("puma")
    silent = replace(ideal(tree), wrench=None, torque=None)
    short = replace(noisy(ideal(tree)), velocity=None, acceleration=None).part(0, 8)
    for k, recording in enumerate((silent, short)):
        run = run_of(tree, recording)
        assert not run.estimates or k == 1
        write_report(run, tmp_path / f"{k}.html")
        text = plain_text((tmp_path / f"{k}.html").read_text())
        assert "tell" in text or "no estimate could be made" in text


def test_a_claim_that_fails_says_which(tmp_path: Path) -> None:
    expect = {"friction_max_relative_error": Bound(at_most=1.0)}
    run = run_of(
        robot("ur5"), without(noisy(ideal(robot("ur5"))), "torque"), experiment(expect=expect)
    )
    write_report(run, tmp_path / "r.html")
    text = plain_text((tmp_path / "r.html").read_text())
    assert "The claim does not hold: friction max relative error is not there" in text


def test_the_page_is_not_where_its_numbers_go(puma_run: Run, tmp_path: Path) -> None:
    """Both files or none."""
    (tmp_path / "r.json").mkdir()
    with pytest.raises(OSError, match="is a folder"):
        write_report(puma_run, tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_dollars_in_names_are_dollars(tmp_path: Path) -> None:
    tree = robot("puma")
    odd = replace(tree, joints=(replace(tree.joints[0], name="a$\\foo_{$"), *tree.joints[1:]))
    write_report(run_of(odd), tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text()
    assert "a$\\foo_{$ [N m]" in unescape(text)
    drawn = " ".join(re.findall(r"(?s)<svg.*?</svg>", text))
    for word in re.findall(r"<text[^>]*>([^<]*)</text>", drawn):
        assert "mathdefault" not in word
        assert "$" not in word or "a$\\foo_{$" in unescape(word)


def test_hostile_names_stay_text(puma_run: Run, tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script>"
    tree = replace(puma_run.tree, name=hostile)
    write_report(
        replace(puma_run, name=hostile, tree=tree, warnings=(hostile,)), tmp_path / "r.html"
    )
    assert "<script" not in (tmp_path / "r.html").read_text()


def test_on_a_motion_not_seen_residuals_stand_beside_what_is_allowed(
    puma_run: Run, other: Recording, tmp_path: Path
) -> None:
    run = validated(puma_run, other)
    numbers = json.loads(write_report(run, tmp_path / "r.html", other).read_text())
    table = numbers["figures"][0]
    for method, found in run.validation.items():
        column = table["heads"].index(f"over what is allowed, {method}")
        told = {row[0]: row[column] for row in table["rows"] if row[column]}
        assert told == {c: f"{x:.3g}" for c, x in zip(found.channels, found.ratio, strict=True)}
    assert any("Rms residuals on that motion" in line for line in numbers["summary"])


def test_a_browser_does_not_break_what_is_to_be_typed() -> None:
    said = typeset("take 1e-06 by --lock-mimic or --set 'a.b=3'; 2 -- 3")
    assert re.findall(r'<span class="number">(.*?)</span>', said) == [
        "1e-06", "--lock-mimic", "--set",
    ]  # fmt: skip
