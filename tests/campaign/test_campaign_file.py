"""A campaign's file: what it means, what is refused, and by what a run is known."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from testbed.campaign import run_identity
from testbed.campaign.campaign import Campaign
from testbed.campaign.conduct import places_of
from testbed.campaign.run_identity import run_hash
from testbed.errors import ExperimentError
from testbed.experiment.experiment import Experiment
from tests.helpers.campaigns import NOISES, campaign_file
from tests.helpers.paths import ROOT

LEVELS = """
[[factor]]
name = "who"
[[factor.level]]
name = "plain"
[[factor.level]]
name = "late"
set = ['measurement.fault=[{kind="plate_delay",delay=1e-3}]']
"""


def test_a_level_goes_where_it_is_asked_for(tmp_path: Path) -> None:
    campaign = Campaign.load(campaign_file(tmp_path, 2, NOISES + LEVELS))
    assert campaign.factors == ("noise", "who")
    assert [cell.levels for cell in campaign.cells] == [
        (0.5, "plain"), (0.5, "late"), (2.0, "plain"), (2.0, "late"),
    ]  # fmt: skip
    run = campaign.experiment(3, 1)
    assert run.measurement.force_noise == 2.0
    assert run.measurement.moment_noise == 0.4
    assert [fault.kind for fault in run.measurement.fault] == ["plate_delay"]
    assert run.seed == campaign.experiment(0, 1).seed != campaign.experiment(3, 0).seed
    assert run.identification.engine == "numpy"  # the file's own word comes after the default
    assert not run.expect


def test_cells_have_seeds_of_their_own_where_that_is_asked_for(tmp_path: Path) -> None:
    file = campaign_file(tmp_path, 3, NOISES, more="common_seeds = false\nseed = 5")
    campaign = Campaign.load(file)
    seeds = [campaign.experiment(cell, k).seed for cell in range(2) for k in range(3)]
    assert seeds == list(range(5, 11))


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ('[[factor]]\nname = "x"\nset = ["seed=$"]\n', "one of values, level and range"),
        ('[[factor]]\nname = "x"\nvalues = [1.0]\n', "levels with names have a set each"),
        ('[[factor]]\nname = "x"\nset = ["a=$"]\nrange = [2.0, 1.0]\n', "range is empty"),
        ('[[factor]]\nname = "x"\nset = ["a=$"]\nrange = [0.0, 1.0]\nlog = true\n', "logarithm"),
        ('[[factor]]\nname = "x"\nset = ["measurement.nois=$"]\nvalues = [1.0]\n', "unknown key"),
        ('[[factor]]\nname = "x"\nset = ["seed=$*2"]\nvalues = ["u"]\n', "is no number"),
        ('[stop]\nfigure = "beauty"\nstandard_error = 0.1\n', "unknown figure 'beauty'"),
        ("[sampling]\npoint = 3\n", "did you mean 'points'"),
    ],
)
def test_what_is_not_understood_is_said(tmp_path: Path, factors: str, said: str) -> None:
    with pytest.raises(ExperimentError, match=said):
        Campaign.load(campaign_file(tmp_path, 1, factors))


def test_two_factors_of_one_name_and_too_many_runs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ExperimentError, match="two factors have one name"):
        Campaign.load(campaign_file(tmp_path, 1, NOISES + NOISES))
    values = ", ".join(f"{k}.0" for k in range(20))
    factor = f'[[factor]]\nname = "x"\nset = ["measurement.force_noise=$"]\nvalues = [{values}]'
    file = campaign_file(tmp_path, 1_000_000, factor)
    with pytest.raises(ExperimentError, match="more than"):
        Campaign.load(file)


def loaded(path: Path, *words: str) -> Experiment:
    return Experiment.load(path, words)


def test_a_hash_is_of_all_that_determines_a_run_and_of_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "experiments").mkdir()
    (tmp_path / "models").mkdir()
    moved = tmp_path / "experiments/table6.toml"
    shutil.copy(ROOT / "experiments/table6.toml", moved)
    model = shutil.copy(ROOT / "models/puma562.xml", tmp_path / "models")
    here = run_hash(loaded(ROOT / "experiments/table6.toml"), ["external"])
    assert run_hash(loaded(moved, "name=other", "claim=none"), ["external"]) == here
    assert run_hash(loaded(moved, "motion.duration=60"), ["external"]) == here  # the default
    others = {
        run_hash(loaded(moved), ["external", "internal"]),
        run_hash(loaded(moved, "seed=1"), ["external"]),
        run_hash(loaded(moved, "identification.engine=compiled"), ["external"]),
    }
    Path(model).write_text(Path(model).read_text().replace('"6.3"', '"6.4"'))
    others.add(run_hash(loaded(moved), ["external"]))
    assert len(others | {here}) == 5


def test_another_version_of_the_code_makes_other_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = Campaign.load(campaign_file(tmp_path))
    before = set(places_of(campaign))
    monkeypatch.setattr(run_identity, "code_version", lambda: "another")
    assert before.isdisjoint(places_of(campaign))


@pytest.mark.parametrize("path", sorted((ROOT / "experiments/campaigns").glob("*.toml")))
def test_what_ships_can_be_carried_out(path: Path) -> None:
    campaign = Campaign.load(path)
    assert len(places_of(campaign)) == campaign.runs
    assert campaign.tables.claim
    assert path.stem == campaign.tables.name
