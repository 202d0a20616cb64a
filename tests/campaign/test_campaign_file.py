"""A campaign's file: which runs it means, by what each is known, and what is refused."""

from __future__ import annotations

import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.campaigns import bundle
from testbed.campaigns.bundle import run_hash
from testbed.campaigns.campaign import Campaign, Choice, cells_of, sample
from testbed.campaigns.conduct import Supply, places_of
from testbed.core.base.errors import ExperimentError
from tests.helpers.campaigns import NOISES, campaign_file
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
SPANS = [(0.5, 2.5, False), (1e-2, 1e2, True), (-3.0, -1.0, False)]


def test_a_level_goes_where_it_is_asked_for_and_cells_share_seeds_unless_told(
    tmp_path: Path,
) -> None:
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
    file = campaign_file(tmp_path, 3, NOISES, more="common_seeds = false\nseed = 5")
    own = Campaign.load(file)
    assert [own.experiment(c, k).seed for c in range(2) for k in range(3)] == list(range(5, 11))


def test_what_a_campaign_file_cannot_mean_is_refused_by_name(tmp_path: Path) -> None:
    """A typing error would cost thousands of runs of another campaign."""
    head = '[[factor]]\nname = "x"\n'
    twenty = ", ".join(f"{k}.0" for k in range(20))
    for factors, replicates, culprit in (
        (head + 'set = ["seed=$"]', 1, "values"),
        (head + 'set = ["a=$"]\nrange = [0.0, 1.0]\nlog = true', 1, "log"),
        (head + 'set = ["measurement.nois=$"]\nvalues = [1.0]', 1, "nois"),
        ("[sampling]\npoint = 3", 1, "points"),
        (NOISES + NOISES, 1, "noise"),
        (head + f'set = ["measurement.force_noise=$"]\nvalues = [{twenty}]', 1_000_000, "runs"),
    ):
        with refuses(ExperimentError, culprit):
            Campaign.load(campaign_file(tmp_path, replicates, factors))


def test_a_run_is_known_by_all_that_determines_it_and_by_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or results would be taken for others, or made twice."""
    for part in ("experiments/table6.toml", "models/puma562.xml"):
        (tmp_path / part).parent.mkdir()
        shutil.copy(ROOT / part, tmp_path / part)
    moved, model = tmp_path / "experiments/table6.toml", tmp_path / "models/puma562.xml"

    def known(*words: str, path: Path = moved, methods: tuple[str, ...] = ("external",)) -> str:
        return run_hash(tb.Experiment.load(path, words), methods)

    here = known(path=ROOT / "experiments/table6.toml")
    assert known("name=other", "claim=none") == known("motion.duration=60") == here  # its default
    others = {known(methods=("external", "internal")), known("seed=1")}
    others.add(known("identification.engine=compiled"))
    campaign = Campaign.load(campaign_file(tmp_path))
    before = set(places_of(campaign))
    model.write_text(model.read_text().replace('"6.3"', '"6.4"'))
    others.add(known())
    motion = tmp_path / "motion.toml"
    for text in ((ROOT / "experiments/motions/table6.toml").read_text(), "another"):
        motion.write_text(text)
        others.add(known(f'motion.file="{motion}"'))
    assert len(others | {here}) == 7
    monkeypatch.setattr(bundle, "code_version", lambda: "another")
    assert before.isdisjoint(places_of(campaign))


def test_what_ships_can_be_carried_out() -> None:
    for path in sorted((ROOT / "experiments/campaigns").glob("*.toml")):
        campaign = Campaign.load(path)
        assert len(places_of(campaign)) == campaign.runs
        assert campaign.tables.claim
        assert path.stem == campaign.tables.name


# points and bundles


@given(st.integers(0, 1000), st.sampled_from(["random", "latin_hypercube", "sobol"]))
def test_sampled_points_fill_their_ranges_evenly_and_a_seed_makes_the_same(
    seed: int, method: str
) -> None:
    points = sample(method, SPANS, 64, seed)
    np.testing.assert_array_equal(points, sample(method, SPANS, 64, seed))
    assert (points != sample(method, SPANS, 64, seed + 1)).any()
    there = np.empty_like(points)  # back in the unit cube
    for k, (low, high, log) in enumerate(SPANS):
        x, a, b = (np.log(v) if log else v for v in (points[:, k], low, high))
        there[:, k] = (x - a) / (b - a)
    assert there.shape == (64, 3)
    assert ((there >= 0) & (there <= 1)).all()
    if method != "random":  # every slice of every range has one
        slices = np.sort(np.floor(64 * there).astype(int), axis=0)
        np.testing.assert_array_equal(slices, np.outer(np.arange(64), [1, 1, 1]))
    if method == "sobol":
        quarters = np.floor(4 * there[:, :2]).astype(int)
        assert (np.bincount(4 * quarters[:, 0] + quarters[:, 1], minlength=16) == 4).all()


def test_crossed_factors_meet_every_point_once_in_the_order_of_the_file() -> None:
    a = [Choice(0, x, (f"a={x}",)) for x in (1.0, 2.0)]
    c = [Choice(2, x, (f"c={x}",)) for x in ("u", "v", "w")]
    points = [[Choice(1, y, (f"b={y}",)), Choice(3, -y, (f"d={-y}",))] for y in (0.1, 0.2)]
    cells = cells_of([a, c], points)
    wanted = [(x, y, z, -y) for x, z, y in product((1.0, 2.0), "uvw", (0.1, 0.2))]
    assert [cell.levels for cell in cells] == wanted
    for cell in cells:
        assert cell.words == tuple(f"{k}={v}" for k, v in zip("abcd", cell.levels, strict=True))


def test_bundles_are_never_empty_and_hold_all_runs_once(tmp_path: Path) -> None:
    """Whatever a run is expected to take."""
    campaign = Campaign.load(campaign_file(tmp_path, 20, NOISES))
    order = [(run, place.cell, place.replicate) for run, place in places_of(campaign).items()]
    for seconds in (1e-9, 0.1, 1e9, np.inf):
        supply, seen = Supply(campaign, list(order), [seconds]), []
        while (bundle := supply.take(2)) is not None:
            assert bundle.runs
            seen += [run for run, _ in bundle.runs]
        assert seen == [run for run, _, _ in order]
