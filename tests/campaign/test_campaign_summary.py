"""The summary against numbers of one's own: bias, spread, coverage, figures, and two campaigns."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from scipy.stats import binomtest, norm

from testbed.campaign.bundle import Bundle, Outcome
from testbed.campaign.campaign import Campaign
from testbed.campaign.campaign_summary import (
    Summary,
    binomial_bounds,
    pooled,
    read_campaign,
    summarise,
)
from testbed.campaign.conduct import conduct
from testbed.campaign.summary_files import changes, write_summary
from testbed.experiment.experiment_tables import METRICS
from testbed.reporting.campaign_figures import marginal_figure, score_figure
from testbed.reporting.campaign_lines import SHOWN_METRICS
from testbed.reporting.campaign_page import campaign_contents, write_campaign_page
from tests.helpers.campaigns import NOISES, Odd, campaign_file, made_up
from tests.helpers.command import command_line
from tests.helpers.viewer import entities, words

GRID = NOISES + (
    '[[factor]]\nname = "encoder"\nset = ["measurement.encoder_noise=$"]\nvalues = [1e-5, 1e-4]\n'
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("campaign")
    campaign = Campaign.load(campaign_file(place, 25, GRID))
    conduct(campaign, place / "r", Odd())
    return place / "r"


@pytest.fixture(scope="module")
def summary(folder: Path) -> Summary:
    return summarise(read_campaign(folder))


@pytest.mark.parametrize(("inside", "runs"), [(0, 5), (5, 5), (190, 200), (1, 3), (47, 50)])
def test_bounds_of_a_share_are_exact_ones(inside: int, runs: int) -> None:
    wanted = binomtest(inside, runs).proportion_ci(0.95, "exact")
    assert binomial_bounds(inside, runs) == pytest.approx((wanted.low, wanted.high), abs=1e-9)


def test_errors_are_those_of_the_table(folder: Path, summary: Summary) -> None:
    rows = pq.read_table(folder / "results.parquet").to_pylist()
    for each in summary.parameters:
        here = [row for row in rows if row["cell"] == each.cell]
        k = here[0]["external/names"].index(each.parameter)
        value, truth, sigma = (
            np.array([row[f"external/{kind}"][k] for row in here])
            for kind in ("values", "truth", "sigma")
        )
        z = (value - truth) / sigma
        assert each.runs == 25
        assert each.bias == pytest.approx(np.mean(value) - np.mean(truth), rel=1e-9)
        assert each.spread == pytest.approx(np.std(value - truth) * math.sqrt(25 / 24))
        assert each.rms**2 == pytest.approx(np.var(value - truth) + each.bias**2)
        assert each.inside == np.sum(np.abs(z) < 1.96)
        assert each.sigma == pytest.approx(sigma[0])
    assert len(summary.parameters) == 4 * 2


def test_all_cells_together_are_one_large_cell(folder: Path, summary: Summary) -> None:
    rows = read_campaign(folder)
    index = rows.schema.get_field_index("cell")
    zeros = pa.array([0] * len(rows), pa.int32())
    one = rows.set_column(index, rows.schema.field("cell"), zeros)
    for ours, wanted in zip(pooled(summary.parameters), summarise(one).parameters, strict=True):
        assert (ours.parameter, ours.runs, ours.inside) == (
            wanted.parameter, wanted.runs, wanted.inside,
        )  # fmt: skip
        for kind in ("truth", "bias", "spread", "rms", "sigma", "relative_rms", "bias_error"):
            assert getattr(ours, kind) == pytest.approx(getattr(wanted, kind), rel=1e-9), kind


def test_what_is_made_up_normal_is_covered_as_normal_numbers_are(summary: Summary) -> None:
    inside = sum(each.inside for each in summary.parameters)
    low, high = binomial_bounds(inside, 200)
    assert low < 0.95 < high + 0.03


def test_tables_for_other_programs_hold_the_same(
    folder: Path, summary: Summary, tmp_path: Path
) -> None:
    files = write_summary(summary, tmp_path)
    assert [file.name for file in files] == [
        "parameters.parquet", "parameters.csv", "figures.parquet", "figures.csv",
    ]  # fmt: skip
    parquet = pq.read_table(files[0]).to_pylist()
    assert pyarrow.csv.read_csv(files[1]).num_rows == len(parquet) == len(summary.parameters)
    assert [row["coverage"] for row in parquet] == [p.coverage for p in summary.parameters]
    assert parquet[0]["factor/noise"] == 0.5


def test_a_campaign_differs_from_itself_by_nothing_and_from_another_by_what_changed(
    folder: Path, summary: Summary, tmp_path: Path
) -> None:
    same = list(changes(summary, summary))
    assert {(each.ratio, each.sigmas) for each in same} == {(1.0, 0.0)}

    def worse(bundle: Bundle) -> tuple[list[Outcome], float]:
        outcomes, seconds = made_up(bundle)
        name = "external_rms_relative_error"
        return [
            Outcome(o.run, "done", metrics={name: 3 * (o.metrics or {})[name]}) for o in outcomes
        ], seconds

    campaign = Campaign.load(campaign_file(tmp_path, 25, GRID))
    conduct(campaign, tmp_path / "r", Odd(worse))
    for each in changes(summary, summarise(read_campaign(tmp_path / "r"))):
        assert each.ratio == pytest.approx(3.0)
        assert each.sigmas > 3
    shown = command_line("campaign", str(tmp_path / "r"), "--against", str(folder), cwd=tmp_path)
    assert shown.returncode == 0
    assert shown.stdout.count("external_rms_relative_error") == 4


def test_the_page_shows_two_heat_maps_of_a_grid_and_every_parameter(
    summary: Summary, tmp_path: Path
) -> None:
    content = campaign_contents(summary)
    (heat,) = content["heats"]  # the made-up runs have no torques
    assert heat["names"] == ["1e-05", "0.0001"]
    assert [name for name, _ in heat["rows"]] == ["0.5", "2"]
    assert {figure["id"] for figure in content["figures"]} == {
        "marginals", "coverage", "scores", "sigma",
    }  # fmt: skip
    write_campaign_page(tmp_path / "page.html", summary)
    text = (tmp_path / "page.html").read_text()
    assert "<script" not in text
    assert "http" not in text.replace("http://www.w3.org", "")


def test_a_folder_without_a_table_is_said(tmp_path: Path) -> None:
    done = command_line("campaign", "--summary", str(tmp_path), cwd=tmp_path)
    assert done.returncode == 2
    assert "is no campaign's folder: it has no results.parquet" in done.stderr
    (tmp_path / "results.parquet").write_text("not a table")
    done = command_line("campaign", "--summary", str(tmp_path), cwd=tmp_path)
    assert done.returncode == 2
    assert "not a readable table of a campaign" in done.stderr


@pytest.mark.slow
def test_the_command_carries_out_a_campaign_and_says_what_failed(tmp_path: Path) -> None:
    factor = (
        '[[factor]]\nname = "lock"\n[[factor.level]]\nname = "none"\n[[factor.level]]\n'
        'name = "nobody"\nset = ["robot.lock.nobody=0.0"]\n'
    )
    file = str(campaign_file(tmp_path, 1, factor))
    plan = command_line("campaign", file, "--dry-run", cwd=tmp_path)
    assert plan.returncode == 0
    assert "2 cells, 1 replicate each: 2 runs" in plan.stdout
    assert not (tmp_path / "runs").exists()
    done = command_line("campaign", file, "--workers", "0", "--out", "r", cwd=tmp_path)
    assert done.returncode == 1
    assert "1 run with a result, 1 without" in done.stdout
    assert "nobody" in done.stdout
    command = next(line for line in done.stdout.splitlines() if "testbed run" in line)
    assert "--set robot.lock.nobody=0.0" in command


@pytest.mark.slow
def test_the_viewers_file_counts_every_run(folder: Path, tmp_path: Path) -> None:
    asked = ("campaign", "--summary", str(folder), "--rrd", str(tmp_path / "r.rrd"))
    done = command_line(*asked, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert {"/scores/external/a", "/sigma/external"} <= entities(tmp_path / "r.rrd")
    (notes,) = words(tmp_path / "r.rrd", "/notes", "TextDocument:text")
    assert notes.count("external_rms_relative_error | 25 |") == 4


def test_the_pages_curves_are_means_over_levels_and_densities(
    folder: Path, summary: Summary
) -> None:
    """Of runs that all have a result: a level's mean is that of its runs, whatever their cell."""
    name, rows = "external_rms_relative_error", pq.read_table(folder / "results.parquet")
    marginal = marginal_figure(summary, [name])
    assert marginal is not None
    found = np.array(rows[f"metric/{name}"])
    for k, panel in enumerate(marginal["panels"]):
        of_run = np.array([summary.cells[cell][k] for cell in rows["cell"].to_pylist()])
        levels, means = panel.curves["external"]
        wanted = [100 * found[of_run == level].mean() for level in levels]
        np.testing.assert_allclose(means, wanted, rtol=1e-9)
    scores = score_figure(summary.z)
    assert scores is not None
    for panel in scores["panels"]:
        at, normal = panel.curves["measured"]
        np.testing.assert_allclose(normal, norm.pdf(at), rtol=1e-12)
        edges, share = panel.curves["external"]
        assert np.sum(share[::2] * (edges[1::2] - edges[::2])) == pytest.approx(1.0)


def test_what_is_shown_of_cells_are_metrics_that_runs_have() -> None:
    assert {name for _, name in SHOWN_METRICS} <= set(METRICS)


def test_what_is_pooled_is_of_no_cell(summary: Summary) -> None:
    assert {each.cell for each in pooled(summary.parameters)} == {-1}
