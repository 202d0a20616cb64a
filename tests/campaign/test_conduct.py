"""Nothing is lost, nothing is there twice, and no way of going about it shows in the table."""

from __future__ import annotations

import csv
import errno
import math
import statistics
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.stats import binomtest

from testbed.campaigns import results
from testbed.campaigns.bundle import Bundle, Outcome, Status, carry_out_bundle
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.cluster import DaskEngine, SchedulerLost, local_workers
from testbed.campaigns.conduct import InThisProcess, Standing, Supply, conduct, places_of
from testbed.campaigns.results import CampaignFolder, own_folder
from testbed.campaigns.summary import (
    binomial_bounds,
    changes,
    pooled,
    read_campaign,
    summarise,
    write_summary,
)
from testbed.core.base.errors import ExperimentError, TestbedError
from testbed.lab.experiment import evaluate, simulate
from testbed.lab.simulation.rollout import simulate_motion
from tests.helpers.campaigns import NOISES, Odd, campaign_file, made_up, real
from tests.helpers.refusals import refuses

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("default")  # Dask's own, while it shuts down


def table(folder: Path) -> bytes:
    return (folder / "results.parquet").read_bytes()


def rows(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = pq.read_table(folder / "results.parquet").to_pylist()
    return found


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    return Campaign.load(campaign_file(tmp_path, 20, NOISES))


@pytest.fixture
def whole(tmp_path: Path, campaign: Campaign) -> bytes:
    """The table of a campaign that nothing disturbed."""
    conduct(campaign, tmp_path / "whole", Odd())
    return table(tmp_path / "whole")


class Killed(BaseException):
    """The end of the process, as far as Python can play it."""


@pytest.mark.slow
def test_whatever_interrupts_it_it_goes_on_to_the_same_table(
    tmp_path: Path, campaign: Campaign, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As kill -9 leaves it: no tidying up; table and new rows may then hold the same runs."""
    monkeypatch.setattr(results, "LEAST_NEW", 6)
    once, compact, left = pq.ParquetWriter.write_table, CampaignFolder.compact, [0]

    def countdown(error: BaseException) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise error

    def work(bundle: Bundle) -> tuple[list[Outcome], float]:
        countdown(Killed())
        return made_up(bundle)

    def on_a_full_disk(self: pq.ParquetWriter, rows: object) -> None:
        countdown(OSError(errno.ENOSPC, "No space left on device"))
        once(self, rows)

    def compacted_in_part(self: CampaignFolder) -> None:
        kept = {path: path.read_bytes() for path in (self.path / "new").glob("*")}
        compact(self)
        for path, content in kept.items():
            path.write_bytes(content)
        countdown(Killed())

    for cause, after in [
        *product(["engine"], (1, 5, 9)),
        *product(["disk"], (3, 8)),
        *product(["compaction"], (0, 1)),
    ]:
        left[0], place = after, tmp_path / f"{cause}{after}"
        with monkeypatch.context() as patch:
            if cause == "disk":
                patch.setattr(pq.ParquetWriter, "write_table", on_a_full_disk)
            elif cause == "compaction":
                patch.setattr(CampaignFolder, "compact", compacted_in_part)
            with pytest.raises(ExperimentError if cause == "disk" else Killed):
                conduct(campaign, place, Odd(work if cause == "engine" else made_up, 2, after))
        conduct(campaign, place, Odd())
        assert table(place) == whole
        assert not list((place / "new").iterdir())


@pytest.mark.slow
def test_bundles_their_order_and_parts_do_not_show(
    tmp_path: Path, campaign: Campaign, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is there is not done again; progress counts; files of few rows do not pile up."""
    monkeypatch.setattr(results, "LEAST_NEW", 4)
    seen: list[Standing] = []

    def look(standing: Standing) -> None:
        seen.append(standing)
        assert len(list((tmp_path / "parts/new").glob("*.parquet"))) <= max(4, standing.done / 2)

    parts = [Odd(size=1), Odd(size=3, seed=1), Odd(seed=2), Odd()]
    for engine, limit in zip(parts, (5, 17, None, None), strict=True):
        conduct(campaign, tmp_path / "parts", engine, limit, progress=look)
    assert [len(engine.asked) for engine in parts] == [5, 12, 23, 0]
    assert table(tmp_path / "parts") == whole
    assert [each.done for each in seen[:5]] == [1, 2, 3, 4, 5]
    assert seen[-1].done == 40
    found = rows(tmp_path / "whole")
    assert [row["run"] for row in found] == list(places_of(campaign))
    assert [(row["replicate"], row["cell"]) for row in found[:3]] == [(0, 0), (0, 1), (1, 0)]
    assert [row["factor/noise"] for row in found[:2]] == [0.5, 2.0]


def test_failed_runs_are_rows_killed_ones_are_tried_again_others_are_kept_apart(
    tmp_path: Path, campaign: Campaign
) -> None:
    names = list(places_of(campaign))
    bad: dict[str, Status] = {names[3]: "failed", names[8]: "killed"}

    def work(bundle: Bundle) -> tuple[list[Outcome], float]:
        found, seconds = made_up(bundle)
        return [
            Outcome(o.run, bad[o.run], "because") if o.run in bad else o for o in found
        ], seconds

    standings: list[Standing] = []
    folder = conduct(campaign, tmp_path / "r", Odd(work), progress=standings.append)
    assert (standings[-1].done, standings[-1].total, standings[-1].failed) == (40, 40, 2)
    assert [error for _, error in folder.failures()] == ["because", "because"]
    assert folder.failures()[0][0].startswith("testbed run ")
    folder = conduct(campaign, tmp_path / "r", again := Odd())
    assert again.asked == [names[8]]
    assert len(folder.failures()) == 1
    before = table(tmp_path / "r")
    one = Campaign.load(campaign_file(tmp_path, 20, NOISES.replace("[0.5, 2.0]", "[2.0]")))
    for asked, count in ((one, 20), (campaign, 40)):  # rows not asked for any more, and again
        conduct(asked, tmp_path / "r", again := Odd())
        assert again.asked == []
        assert len(rows(tmp_path / "r")) == count
    assert table(tmp_path / "r") == before


@pytest.mark.slow
def test_a_rule_for_stopping_looks_at_whole_rounds_alone(tmp_path: Path) -> None:
    """Which runs there are does not depend on bundles; more are made where more are needed."""
    name = "external_rms_relative_error"
    stop = f'[stop]\nfigure = "{name}"\nstandard_error = 0.01\nround = 4\n'
    campaign = Campaign.load(campaign_file(tmp_path, 60, NOISES + stop))
    for seed, size in enumerate((None, 5)):
        conduct(campaign, tmp_path / f"r{seed}", Odd(size=size, seed=seed))
    assert table(tmp_path / "r0") == table(tmp_path / "r1")
    for cell in (0, 1):
        values = [r[f"metric/{name}"] for r in rows(tmp_path / "r0") if r["cell"] == cell]
        ends = range(4, len(values) + 1, 4)
        assert len(values) % 4 == 0
        sizes = [statistics.stdev(values[:k]) / math.sqrt(k) for k in ends]
        assert all(size > 0.01 for size in sizes[:-1])
        assert sizes[-1] <= 0.01 or len(values) == 60


def test_a_folder_is_written_by_one_command_and_by_no_other_kind(
    tmp_path: Path, campaign: Campaign
) -> None:
    with own_folder(tmp_path / "r", campaign.tables), refuses(ExperimentError, str(tmp_path / "r")):
        conduct(campaign, tmp_path / "r", Odd())
    letters = tmp_path / "letters"
    letters.mkdir()
    (letters / "results.parquet").write_text("dear mum")
    with refuses(TestbedError, str(letters)):
        read_campaign(letters)
    (letters / "results.parquet").rename(letters / "to-mum.txt")
    for place in (letters, letters / "to-mum.txt"):
        with refuses(ExperimentError, "to-mum.txt"):
            conduct(campaign, place, Odd())


@pytest.mark.slow
def test_real_runs_give_the_same_bits_in_any_bundles_and_recordings_are_kept(
    tmp_path: Path,
) -> None:
    """On local workers of Dask, too; a run that cannot be leaves the others alone."""
    words = {
        "little noise": "measurement.force_noise=0.5",
        "much noise": "measurement.force_noise=3.0",
        "friction": "robot.joint.waist.coulomb=0.7",
        "wrong": "robot.lock.nobody=0.0",
        "effect": "simulation.effect=[{kind='stribeck_friction',coefficient=0.1}]",
    }
    levels = (f'[[factor.level]]\nname = "{k}"\nset = ["{word}"]\n' for k, word in words.items())
    factors = f'[[factor]]\nname = "load"\n{"".join(levels)}'
    campaign = Campaign.load(campaign_file(tmp_path, 2, factors, more='recordings = "keep"'))
    conduct(campaign, tmp_path / "alone", InThisProcess())
    conduct(campaign, tmp_path / "single", Odd(real, size=1))
    with local_workers(2) as engine:
        conduct(campaign, tmp_path / "local", engine)
    assert table(tmp_path / "alone") == table(tmp_path / "single") == table(tmp_path / "local")
    found = rows(tmp_path / "alone")
    failed = {row["factor/load"] for row in found if row["status"] != "done"}
    assert failed == {"wrong"}
    assert len({row["external/values"][0] for row in found if row["external/values"]}) == 8
    for run in [row["run"] for row in found if row["status"] == "done"]:
        kept = [(tmp_path / n / f"recordings/{run}.parquet") for n in ("alone", "single", "local")]
        assert len({path.read_bytes() for path in kept}) == 1


# a bundle on a worker


@pytest.mark.slow
def test_a_run_that_fails_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors that are none of testbed's with their kind; without memory, it may be tried again."""
    campaign = Campaign.load(campaign_file(tmp_path, 1, NOISES))
    order = [(run, place.cell, place.replicate) for run, place in places_of(campaign).items()]
    bundle = Supply(campaign, order, [1e-3]).take(0)
    assert bundle is not None
    with refuses(ExperimentError, "testbed"):
        carry_out_bundle(replace(bundle, code="another"))
    (run, words), *rest = bundle.runs
    wrong = (("0" * len(run), words), (run, (*words, "seed=many")), *rest)
    (first, second, *_), _ = carry_out_bundle(replace(bundle, runs=wrong))
    assert (first.run, first.status, first.metrics) == ("0" * len(run), "failed", None)
    assert (second.status, "seed" in second.error) == ("failed", True)
    for error, status in ((ZeroDivisionError("so"), "failed"), (MemoryError("so"), "killed")):
        said = f"{type(error).__name__}: so"
        for module, name in ((evaluate, "evaluate"), (simulate, "simulate_motion")):
            with monkeypatch.context() as patch:
                patch.setattr(module, name, Mock(side_effect=error))
                outcomes, _ = carry_out_bundle(bundle)
            assert {(each.status, each.error) for each in outcomes} == {(status, said)}
    simulated = Mock(side_effect=simulate_motion)
    monkeypatch.setattr(simulate, "simulate_motion", simulated)
    carry_out_bundle(bundle)
    assert simulated.call_count == 1  # both runs move alike, and differ in noise


def test_a_deadly_bundle_is_taken_apart_and_errors_of_work_and_cluster_are_told_apart() -> None:
    """Else one run that kills its worker takes others along, or is tried for ever."""
    engine = DaskEngine(None, lambda each: ([], 0.0))
    runs = tuple((f"run {k}", (f"seed={k}",)) for k in range(3))
    many = Bundle("base.toml", {"a": 1}, ("external",), False, "code", runs)

    def answer(came: Any, bundle: Bundle, apart: list[Bundle], status: str = "finished") -> Any:
        future = Mock(status=status)
        future.result.side_effect = [came]
        return engine._answer(future, bundle, apart)

    apart: list[Bundle] = []
    killed, came = (
        distributed.scheduler.KilledWorker("task", None, 3),
        ([Outcome("run 0", "done")], 2.5),
    )
    assert answer(came, many, apart) is came
    assert answer(killed, many, apart) is None
    assert apart == [replace(many, runs=(run,)) for run in runs]
    (outcome,), _ = answer(killed, apart[0], [])
    assert (outcome.run, outcome.status) == ("run 0", "killed")
    for wrong, status, kind in (
        (KeyError("x"), "finished", ExperimentError),
        (distributed.client.FutureCancelledError("k", "r"), "finished", SchedulerLost),
        (distributed.comm.CommClosedError("gone"), "finished", SchedulerLost),
        (None, "lost", SchedulerLost),
    ):
        with pytest.raises(kind):
            answer(wrong, many, [], status)


# summary


def test_a_summary_is_of_the_tables_numbers_and_a_comparison_of_what_changed(
    tmp_path: Path,
) -> None:
    """Bias, spread, exact bounds of coverage; tables for other programs hold the same."""
    for inside, runs in ((0, 5), (5, 5), (190, 200)):
        wanted = binomtest(inside, runs).proportion_ci(0.95, "exact")
        assert binomial_bounds(inside, runs) == pytest.approx((wanted.low, wanted.high), abs=1e-9)
    campaign = Campaign.load(campaign_file(tmp_path, 25, NOISES))
    conduct(campaign, tmp_path / "r", Odd())
    summary, found = summarise(read_campaign(tmp_path / "r")), rows(tmp_path / "r")
    assert len(summary.parameters) == 2 * 2
    for each in (*summary.parameters, *pooled(summary.parameters)):
        here = [row for row in found if each.cell in (-1, row["cell"])]
        k = here[0]["external/names"].index(each.parameter)
        value, truth, sigma = (
            np.array([r[f"external/{c}"][k] for r in here]) for c in ("values", "truth", "sigma")
        )
        assert each.runs == len(value) == (50 if each.cell < 0 else 25)
        assert each.bias == pytest.approx(np.mean(value - truth), rel=1e-9)
        assert each.rms == pytest.approx(np.sqrt(np.mean((value - truth) ** 2)))
        if each.cell >= 0:
            assert each.spread == pytest.approx(np.std(value - truth, ddof=1))
        assert each.inside == np.sum(np.abs(value - truth) < 1.96 * sigma)
    evil = '=HYPERLINK("http://x.example")'
    named = replace(summary, factors=(evil,), cells=dict.fromkeys(summary.cells, ("@SUM(1)",)))
    for path in write_summary(named, tmp_path):
        if path.suffix == ".csv":  # no spreadsheet computes what a name says
            cells = [cell for row in csv.reader(path.read_text().splitlines()) for cell in row]
            assert "'@SUM(1)" in cells
            assert not any(cell.startswith(("=", "@")) for cell in cells)
    files = write_summary(summary, tmp_path)
    shares = [row["coverage"] for row in pq.read_table(files[0]).to_pylist()]
    assert shares == [p.coverage for p in summary.parameters]
    name = "external_rms_relative_error"

    def worse(bundle: Bundle) -> tuple[list[Outcome], float]:
        outcomes, seconds = made_up(bundle)
        three = [replace(o, metrics={name: 3 * (o.metrics or {})[name]}) for o in outcomes]
        return three, seconds

    conduct(campaign, tmp_path / "worse", Odd(worse))
    (*told,) = changes(summary, summarise(read_campaign(tmp_path / "worse")))
    assert [each.ratio for each in told if each.metric == name] == pytest.approx([3.0, 3.0])
    assert all(each.sigmas > 3 for each in told if each.metric == name)
