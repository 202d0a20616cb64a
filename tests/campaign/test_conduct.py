"""Nothing is lost, nothing is there twice, and no way of going about it shows in the table."""

from __future__ import annotations

import errno
import math
import shutil
import statistics
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from testbed.campaign import campaign_folder
from testbed.campaign.bundle import Bundle, Outcome
from testbed.campaign.campaign import Campaign
from testbed.campaign.campaign_folder import CampaignFolder
from testbed.campaign.conduct import Standing, Supply, conduct, places_of
from testbed.errors import ExperimentError
from tests.helpers.campaigns import NOISES, Odd, campaign_file, made_up, real


def table(folder: Path) -> bytes:
    return (folder / "results.parquet").read_bytes()


def rows(folder: Path) -> list[dict[str, object]]:
    found: list[dict[str, object]] = pq.read_table(folder / "results.parquet").to_pylist()
    return found


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    return Campaign.load(campaign_file(tmp_path, 20, NOISES))


@pytest.mark.slow
def test_bundles_and_their_order_do_not_show(tmp_path: Path, campaign: Campaign) -> None:
    tables = set()
    for seed, size in enumerate((None, 1, 3, 7)):
        conduct(campaign, tmp_path / f"r{seed}", Odd(size=size, seed=seed))
        tables.add(table(tmp_path / f"r{seed}"))
    assert len(tables) == 1
    found = rows(tmp_path / "r0")
    assert [row["run"] for row in found] == list(places_of(campaign))
    assert [(row["replicate"], row["cell"]) for row in found[:3]] == [(0, 0), (0, 1), (1, 0)]
    assert [row["factor/noise"] for row in found[:2]] == [0.5, 2.0]


@pytest.mark.slow
def test_what_is_there_is_not_done_again(tmp_path: Path, campaign: Campaign) -> None:
    whole, parts = Odd(), [Odd(), Odd(), Odd()]
    conduct(campaign, tmp_path / "whole", whole)
    for engine, limit in zip(parts, (5, 17, None), strict=True):
        conduct(campaign, tmp_path / "parts", engine, limit)
    assert [len(engine.asked) for engine in parts] == [5, 12, 23]
    assert table(tmp_path / "parts") == table(tmp_path / "whole")
    again = Odd()
    conduct(campaign, tmp_path / "parts", again)
    assert again.asked == []


class Killed(BaseException):
    """The end of the process, as far as Python can play it."""


def dying(after: int) -> Odd:
    """An engine whose process ends after some bundles."""
    left = [after]

    def work(bundle: Bundle) -> tuple[list[Outcome], float]:
        left[0] -= 1
        if left[0] < 0:
            raise Killed
        return made_up(bundle)

    return Odd(work, size=2, seed=after)


@pytest.mark.slow
def test_ended_at_any_moment_it_goes_on(
    tmp_path: Path, campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No tidying up: as after kill -9. Table and new rows may then hold the same runs."""
    conduct(campaign, tmp_path / "whole", Odd())
    monkeypatch.setattr(campaign_folder, "LEAST_NEW", 6)
    for after in range(1, 12, 2):
        with monkeypatch.context() as patch:
            patch.setattr(CampaignFolder, "compact", _unfinished(after))
            with pytest.raises(Killed):
                conduct(campaign, tmp_path / f"r{after}", dying(after))
        conduct(campaign, tmp_path / f"r{after}", Odd())
        assert table(tmp_path / f"r{after}") == table(tmp_path / "whole")
        assert not list((tmp_path / f"r{after}" / "new").iterdir())


def _unfinished(after: int):  # type: ignore[no-untyped-def]
    """Compaction that ends before new rows are removed, or is not begun at all."""
    once = CampaignFolder.compact

    def compact(self: CampaignFolder) -> None:
        if after % 4 == 1:
            raise Killed
        kept = {path: path.read_bytes() for path in (self.path / "new").glob("*")}
        once(self)
        for path, content in kept.items():
            path.write_bytes(content)

    return compact


def test_failures_are_rows_and_are_not_tried_again_but_killed_runs_are(
    tmp_path: Path, campaign: Campaign
) -> None:
    names = list(places_of(campaign))

    def work(bundle: Bundle) -> tuple[list[Outcome], float]:
        found, seconds = made_up(bundle)
        bad = {names[3]: "failed", names[8]: "killed"}
        return [
            Outcome(o.run, bad[o.run], "because") if o.run in bad else o  # type: ignore[arg-type]
            for o in found
        ], seconds

    folder = conduct(campaign, tmp_path / "r", Odd(work))
    assert [error for _, error in folder.failures()] == ["because", "because"]
    assert all(isinstance(row["warnings"], list) for row in rows(tmp_path / "r"))
    assert folder.failures()[0][0].startswith("testbed run ")
    assert len(rows(tmp_path / "r")) == 40
    again = Odd()
    folder = conduct(campaign, tmp_path / "r", again)
    assert again.asked == [names[8]]
    assert len(folder.failures()) == 1


@pytest.mark.slow
def test_a_rule_for_stopping_looks_at_whole_rounds_alone(tmp_path: Path) -> None:
    """Which runs there are does not depend on bundles; more are made where more are needed."""
    stop = '[stop]\nfigure = "external_rms_relative_error"\nstandard_error = 0.01\nround = 4\n'
    campaign = Campaign.load(campaign_file(tmp_path, 60, NOISES + stop))
    tables = set()
    for seed, size in enumerate((None, 1, 5)):
        conduct(campaign, tmp_path / f"r{seed}", Odd(size=size, seed=seed))
        tables.add(table(tmp_path / f"r{seed}"))
    assert len(tables) == 1
    for cell in (0, 1):
        column = "metric/external_rms_relative_error"
        values = [float(str(r[column])) for r in rows(tmp_path / "r0") if r["cell"] == cell]
        assert len(values) % 4 == 0
        sizes = [_standard_error(values[:k]) for k in range(4, len(values) + 1, 4)]
        assert all(size > 0.01 for size in sizes[:-1])
        assert sizes[-1] <= 0.01 or len(values) == 60


def _standard_error(values: list[float]) -> float:
    return statistics.stdev(values) / math.sqrt(len(values))


def test_rows_that_are_not_asked_for_any_more_are_kept_apart(tmp_path: Path) -> None:
    both = Campaign.load(campaign_file(tmp_path, 3, NOISES))
    one = Campaign.load(campaign_file(tmp_path, 3, NOISES.replace("[0.5, 2.0]", "[2.0]")))
    conduct(both, tmp_path / "r", Odd())
    before = table(tmp_path / "r")
    conduct(one, tmp_path / "r", second := Odd())
    assert second.asked == []
    assert [row["cell"] for row in rows(tmp_path / "r")] == [0, 0, 0]
    assert pq.read_table(tmp_path / "r/earlier.parquet").num_rows == 3
    conduct(both, tmp_path / "r", third := Odd())
    assert third.asked == []
    assert table(tmp_path / "r") == before


@pytest.mark.slow
def test_a_full_disk_costs_what_had_no_place_and_nothing_else(
    tmp_path: Path, campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    conduct(campaign, tmp_path / "whole", Odd(size=2))
    for room in range(3, 12, 2):
        with monkeypatch.context() as patch:
            patch.setattr(pq, "ParquetWriter", _with_room_for(room))
            with pytest.raises(ExperimentError, match="No space left on device; what was written"):
                conduct(campaign, tmp_path / "r", Odd(size=2))
        conduct(campaign, tmp_path / "r", Odd(size=2))
        assert table(tmp_path / "r") == table(tmp_path / "whole")
        shutil.rmtree(tmp_path / "r")


def _with_room_for(tables: int) -> type[pq.ParquetWriter]:
    """A writer that finds the disk full after some tables, and leaves half of one."""
    left = [tables]

    class Full(pq.ParquetWriter):  # type: ignore[misc]
        def write_table(self, table: object) -> None:
            left[0] -= 1
            if left[0] < 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            super().write_table(table)

    return Full


def test_a_folder_is_written_by_one_command_and_by_no_other_kind(
    tmp_path: Path, campaign: Campaign
) -> None:
    class Nested(Odd):
        def answers(self, supply):  # type: ignore[no-untyped-def]
            with pytest.raises(ExperimentError, match="another command is writing"):
                conduct(campaign, tmp_path / "r", Odd())
            return super().answers(supply)

    conduct(campaign, tmp_path / "r", Nested())
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters/to-mum.txt").write_text("dear")
    with pytest.raises(ExperimentError, match="is no campaign's folder: it holds to-mum.txt"):
        conduct(campaign, tmp_path / "letters", Odd())
    with pytest.raises(ExperimentError, match="is a file"):
        conduct(campaign, tmp_path / "letters/to-mum.txt", Odd())


@pytest.mark.slow
def test_real_runs_give_the_same_bits_in_any_bundles_and_recordings_are_kept(
    tmp_path: Path,
) -> None:
    factors = NOISES + (
        '[[factor]]\nname = "load"\n[[factor.level]]\nname = "none"\n[[factor.level]]\n'
        'name = "Stribeck"\nset = [\'simulation.effect=[{kind="stribeck_friction"}]\']\n'
        '[[factor.level]]\nname = "hopeless"\nset = ["simulation.bandwidth=400.0"]\n'
        '[[factor.level]]\nname = "wrong"\nset = ["robot.lock.nobody=0.0"]\n'
    )
    file = campaign_file(tmp_path, 2, factors, more='recordings = "keep"')
    campaign = Campaign.load(file)
    for size in (None, 1):
        conduct(campaign, tmp_path / f"r{size}", Odd(real, size=size))
    assert table(tmp_path / "rNone") == table(tmp_path / "r1")
    found = rows(tmp_path / "r1")
    assert {row["factor/load"] for row in found if row["status"] == "failed"} >= {"wrong"}
    done = [str(row["run"]) for row in found if row["status"] == "done"]
    assert len(done) >= 8
    for run in done:
        kept = [tmp_path / name / f"recordings/{run}.parquet" for name in ("r1", "rNone")]
        assert kept[0].read_bytes() == kept[1].read_bytes()


def test_progress_counts_runs_that_are_there_and_those_without_a_result(
    tmp_path: Path, campaign: Campaign
) -> None:
    bad = list(places_of(campaign))[3]

    def work(bundle: Bundle) -> tuple[list[Outcome], float]:
        found, seconds = made_up(bundle)
        return [Outcome(o.run, "failed", "no") if o.run == bad else o for o in found], seconds

    seen: list[Standing] = []
    conduct(campaign, tmp_path / "r", Odd(work), progress=seen.append)
    assert (seen[-1].done, seen[-1].total, seen[-1].failed) == (40, 40, 1)
    assert [each.done for each in seen] == sorted({each.done for each in seen})
    assert all(each.rate > 0 for each in seen)


@pytest.mark.slow
def test_files_of_few_rows_do_not_pile_up(
    tmp_path: Path, campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They go into the table when there are as many rows in them as in it: half of all at most."""
    monkeypatch.setattr(campaign_folder, "LEAST_NEW", 4)
    seen: list[tuple[int, int]] = []

    def look(standing: Standing) -> None:
        seen.append((standing.done, len(list((tmp_path / "r/new").glob("*.parquet")))))

    conduct(campaign, tmp_path / "r", Odd(size=1), progress=look)
    assert len(seen) == 40
    assert all(files <= max(4, done / 2) for done, files in seen)


def test_a_command_that_is_refused_a_folder_leaves_no_file_open(
    tmp_path: Path, campaign: Campaign
) -> None:
    own = Path("/dev/fd")
    if not own.is_dir():
        pytest.skip("this system does not list open files")
    with campaign_folder.own_folder(tmp_path / "r", campaign.tables):
        before = len(list(own.iterdir()))
        for _ in range(5):
            with (
                pytest.raises(ExperimentError, match="another command is writing"),
                campaign_folder.own_folder(tmp_path / "r", campaign.tables),
            ):
                pass
        assert len(list(own.iterdir())) == before


@pytest.mark.parametrize("seconds", [1e-9, 0.1, 1e9, math.inf])
def test_bundles_are_never_empty_and_hold_all_runs_once(seconds: float, campaign: Campaign) -> None:
    """Whatever a run is expected to take."""
    order = [(run, place.cell, place.replicate) for run, place in places_of(campaign).items()]
    supply, seen = Supply(campaign, list(order), [seconds]), []
    while (bundle := supply.take(2)) is not None:
        assert bundle.runs
        seen += [run for run, _ in bundle.runs]
    assert seen == [run for run, _, _ in order]
