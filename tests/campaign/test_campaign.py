"""Campaigns: which runs a file means, that none is lost or made twice, what their table says."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.stats import binomtest

from testbed.campaigns import conduct as conducting
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.conduct import CampaignRun, campaign_runs, conduct
from testbed.campaigns.results import read_campaign_results
from testbed.campaigns.summary import coverage_with_interval, summarise
from testbed.core.base.errors import ExperimentError, TestbedError
from tests.helpers.campaigns import NOISES, campaign_file, made_up
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses

LEVELS = """
[[factor]]
name = "who"
[[factor.level]]
name = "plain"
[[factor.level]]
name = "late"
set = ['measurement.fault=[{kind="plate_delay",delay=1e-3}]']
"""


@pytest.fixture
def campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Campaign:
    """One whose runs are made up."""
    monkeypatch.setattr(conducting, "carry_out_run", made_up)
    return Campaign.load(campaign_file(tmp_path, 20, NOISES))


def table(folder: Path) -> bytes:
    return (folder / "results.parquet").read_bytes()


def rows(folder: Path) -> list[dict[str, Any]]:
    return read_campaign_results(folder / "results.parquet").rows


def test_a_level_goes_where_it_is_asked_for_and_cells_share_seeds(tmp_path: Path) -> None:
    campaign = Campaign.load(campaign_file(tmp_path, 2, NOISES + LEVELS))
    assert campaign.factors == ("noise", "who")
    crossed = list(product((0.5, 2.0), ("plain", "late")))
    assert [cell.levels for cell in campaign.cells] == crossed
    run = campaign.experiment(3, 1)
    assert (run.measurement.force_noise, run.measurement.moment_noise) == (2.0, 0.4)
    assert [fault.kind for fault in run.measurement.fault] == ["plate_delay"]
    assert run.seed == campaign.experiment(0, 1).seed != campaign.experiment(3, 0).seed
    assert run.identification.engine == "numpy"  # the file's own word comes after the default
    assert not run.expect


def test_what_a_campaign_file_cannot_mean_is_refused_by_name(tmp_path: Path) -> None:
    """A typing error would cost thousands of runs of another campaign."""
    head = '[[factor]]\nname = "x"\n'
    twenty = ", ".join(f"{k}.0" for k in range(20))
    for factors, replicates, culprit in (
        (head + 'set = ["seed=$"]', 1, "values"),
        (head + 'set = ["seed=$*2"]\nvalues = ["a"]', 1, "'a'"),
        (head + 'set = ["measurement.nois=$"]\nvalues = [1.0]', 1, "nois"),
        (NOISES.replace("values", "value"), 1, "unknown key"),
        (NOISES + NOISES, 1, "noise"),
        (head + f'set = ["measurement.force_noise=$"]\nvalues = [{twenty}]', 1_000_000, "runs"),
    ):
        with refuses(ExperimentError, culprit):
            Campaign.load(campaign_file(tmp_path, replicates, factors))


def test_a_run_is_known_by_all_that_determines_it_and_by_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or results would be taken for others, or made twice."""
    shutil.copy(ROOT / "models/puma562.xml", model := tmp_path / "puma.xml")
    shutil.copy(ROOT / "experiments/motions/table6.toml", motion := tmp_path / "motion.toml")

    def known(*words: str, more: str = "") -> str:
        path = campaign_file(tmp_path, 1, more=more, words=words)
        return campaign_runs(Campaign.load(path))[0].digest

    here = known()
    assert known("name=other", "claim=none") == known("motion.candidates=1") == here
    assert known(f'model="{model}"') == here
    others = {known("identification.engine=compiled"), known(more="seed = 5")}
    for _ in range(2):
        others |= {known(f'motion.file="{motion}"'), known(f'model="{model}"')}
        model.write_text(model.read_text().replace('"6.3"', '"6.4"'))
        motion.write_text(motion.read_text().replace("1", "2"))
    assert len(others) == 6
    monkeypatch.setattr(conducting, "code_version", lambda: "another")
    assert known() != here


def test_what_ships_can_be_carried_out() -> None:
    for path in sorted((ROOT / "experiments/campaigns").glob("*.toml")):
        campaign = Campaign.load(path)
        runs = {place.digest for place in campaign_runs(campaign)}
        assert len(runs) == len(campaign.cells) * campaign.tables.replicates
        assert campaign.tables.claim
        assert path.stem == campaign.tables.name


class Killed(BaseException):
    """The end of the process, as far as Python can play it."""


def test_whatever_interrupts_it_it_goes_on_to_the_same_table(
    tmp_path: Path, campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs that are there are not made again, failed ones are; all are rows in one order."""
    monkeypatch.setattr(conducting, "SAVE_EVERY", 0.0)
    asked: list[str] = []
    left = [5]

    def work(campaign: Campaign, place: CampaignRun) -> dict[str, Any]:
        left[0] -= 1
        if left[0] == 0:
            raise Killed
        asked.append(place.digest)
        failed = {"status": "failed", "error": "because"} if left[0] == 3 else {}
        return made_up(campaign, place) | failed

    conduct(campaign, tmp_path / "whole")
    monkeypatch.setattr(conducting, "carry_out_run", work)
    with pytest.raises(Killed):
        conduct(campaign, tmp_path / "parts")
    places = campaign_runs(campaign)
    assert [row["run"] for row in rows(tmp_path / "parts")] == [each.digest for each in places[:4]]
    (failed,) = (row for row in rows(tmp_path / "parts") if row["status"] != "done")
    assert failed["command"].startswith("testbed run ")
    seen: list[tuple[int, int]] = []
    conduct(campaign, tmp_path / "parts", limit=2, progress=lambda *done: seen.append(done))
    assert seen == [(4, 40), (5, 40)]
    conduct(campaign, tmp_path / "parts")
    assert len(asked) == 41
    assert asked.count(failed["run"]) == 2
    assert table(tmp_path / "parts") == table(tmp_path / "whole")
    found = rows(tmp_path / "whole")
    assert [(row["replicate"], row["cell"]) for row in found[:3]] == [(0, 0), (0, 1), (1, 0)]
    assert [row["factor/noise"] for row in found[:2]] == [0.5, 2.0]


def test_a_folder_of_something_else_is_left_as_it_is(tmp_path: Path, campaign: Campaign) -> None:
    conduct(campaign, tmp_path / "r", limit=3)
    before = table(tmp_path / "r")
    one = Campaign.load(campaign_file(tmp_path, 20, NOISES.replace("0.5, ", "")))
    with refuses(ExperimentError, "--out"):
        conduct(one, tmp_path / "r")
    assert table(tmp_path / "r") == before
    letters = tmp_path / "letters"
    letters.mkdir()
    for name, culprit in (("to-mum.txt", str(letters)), ("results.parquet", "results.parquet")):
        (letters / name).write_text("dear mum")
        with refuses(TestbedError, culprit):
            conduct(campaign, letters)
        assert (letters / name).read_text() == "dear mum"


@pytest.mark.slow
def test_real_runs_give_the_same_bits_on_any_processes(tmp_path: Path) -> None:
    """A run that cannot be leaves the others alone."""
    words = {
        "much noise": "measurement.force_noise=3.0",
        "wrong": "robot.lock.nobody=0.0",
        "effect": "simulation.effect=[{kind='stribeck_friction',coefficient=0.1}]",
    }
    levels = (f'[[factor.level]]\nname = "{k}"\nset = ["{word}"]\n' for k, word in words.items())
    factors = f'[[factor]]\nname = "load"\n{"".join(levels)}'
    campaign = Campaign.load(campaign_file(tmp_path, 2, factors))
    conduct(campaign, tmp_path / "alone")
    conduct(campaign, tmp_path / "two", workers=2)
    assert table(tmp_path / "alone") == table(tmp_path / "two")
    found = rows(tmp_path / "alone")
    assert {row["factor/load"] for row in found if row["status"] != "done"} == {"wrong"}
    assert len({row["estimates"][0]["value"] for row in found if row["estimates"]}) == 4


def end(campaign: Campaign, place: CampaignRun) -> dict[str, Any]:
    """End the process, as the kernel does where memory lacks."""
    os._exit(9)


@pytest.mark.slow
def test_a_process_that_dies_ends_the_command_with_a_word(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conducting, "carry_out_run", end)
    with refuses(ExperimentError, "--workers"):
        conduct(campaign, tmp_path / "r", workers=1)


def test_a_summary_has_median_error_and_coverage_of_each_cell(
    tmp_path: Path, campaign: Campaign
) -> None:
    conduct(campaign, tmp_path / "r")
    found = rows(tmp_path / "r")
    cells = summarise(found)
    assert [each.levels for each in cells] == [{"noise": 0.5}, {"noise": 2.0}]
    for each in cells:
        here = [row for row in found if row["cell"] == each.cell]
        errors = [row["metric/wrench_rms_relative_error"] for row in here]
        assert each.runs == len(here) == 20
        assert each.error == np.median(errors)
        every = [p for row in here for p in row["estimates"]]
        inside = [abs(p["value"] - p["truth"]) < 1.96 * p["sigma"] for p in every]
        assert each.coverage == pytest.approx(np.mean(inside))
        assert each.bounds[0] <= each.coverage <= each.bounds[1]


def test_bounds_of_coverage_are_exact_and_as_wide_as_runs_are_alike() -> None:
    for inside, runs in ((0, 5), (5, 5), (190, 200)):
        wanted = binomtest(inside, runs).proportion_ci(0.95, "exact")
        found = coverage_with_interval([[k < inside] for k in range(runs)])
        assert found == pytest.approx((inside / runs, wanted.low, wanted.high), abs=2e-4)
    alone = coverage_with_interval([[k < 18] for k in range(20)])
    assert coverage_with_interval([[k < 18] * 7 for k in range(20)]) == pytest.approx(alone)
    assert all(math.isnan(each) for each in coverage_with_interval([]))


def damaged(good: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """Tables with one column that is gone, twice there, or of another type."""
    for k, name in enumerate(good.column_names):
        if not name.startswith(("factor/", "metric/")):
            yield name, good.drop_columns([name])
            yield name, good.append_column(name, good[name])
            yield "", good.set_column(k, name, pa.array([True] * (len(good) - 1) + [None]))


def test_a_damaged_table_is_refused(tmp_path: Path, campaign: Campaign) -> None:
    conduct(campaign, tmp_path / "r", limit=4)
    good = pq.read_table(path := tmp_path / "r/results.parquet")
    for name, wrong in damaged(good):
        pq.write_table(wrong, path)
        if name or wrong["diagnostics"].type != pa.bool_():
            with refuses(TestbedError, "results.parquet", name):
                conduct(campaign, tmp_path / "r")
    for said in (b"", b"[]", b"{", b"{}"):
        pq.write_table(good.replace_schema_metadata({b"testbed": said}), path)
        with refuses(TestbedError, "results.parquet"):
            read_campaign_results(path)
    wide = good.set_column(0, "run", good["run"].cast(pa.large_string()))
    pq.write_table(wide.append_column("mine", wide["cell"]), path)
    assert read_campaign_results(path).rows == good.to_pylist()
