"""Variants of an experiment share one motion; each is judged by its own claims."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import TestbedError
from testbed.experiment.comparison import (
    PLAIN,
    Compared,
    Comparison,
    compare,
    comparison_as_json,
)
from testbed.experiment.experiment_tables import Bound
from testbed.experiment.run import Run
from testbed.experiment.summary import obtained, verdict
from testbed.reporting.comparison_table import print_comparison
from tests.helpers.command import command_line
from tests.helpers.console import printed
from tests.helpers.paths import ROOT

SHORT = ["motion.duration=10", "motion.candidates=1", "simulation.step=1e-3", "seed=3"]

LATE = """
[[variant]]
name = "late"
set = ['measurement.fault=[{kind="plate_delay",delay=4e-3}]']
remedy = ['identification.nuisances=["skew"]']
says = "a plate that is late"
remedied.external_max_z = { at_most = 6.0 }
"""

QUIET = """
[[variant]]
name = "quiet"
set = ["measurement.force_noise=0.4"]
says = ""
"""


def written(folder: Path, variants: str, head: str = 'methods = ["external"]') -> Path:
    """A comparison's file."""
    path = folder / "made.toml"
    experiment = ROOT / "experiments/table6.toml"
    path.write_text(f'name = "made"\nexperiment = "{experiment}"\n{head}\n{variants}')
    return path


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> tuple[Comparison, list[Compared]]:
    comparison = Comparison.load(written(tmp_path_factory.mktemp("made"), LATE + QUIET), SHORT)
    return comparison, list(compare(comparison))


@pytest.mark.slow
def test_all_variants_share_one_motion(rows: tuple[Comparison, list[Compared]]) -> None:
    truths = [row.run.recording.truth for row in rows[1]]
    assert len({id(truth) for truth in truths}) == 1
    assert [row.variant.name for row in rows[1]] == [PLAIN, "late", "quiet"]


@pytest.mark.slow
def test_a_variant_is_what_its_experiment_alone_would_be(
    rows: tuple[Comparison, list[Compared]],
) -> None:
    """To the bit: the motion is simulated once, and measured again."""
    for row in rows[1]:
        alone = tb.simulate(row.variant.experiment)
        np.testing.assert_array_equal(alone.measured("wrench"), row.run.recording.wrench)
        np.testing.assert_array_equal(alone.position, row.run.recording.position)


@pytest.mark.slow
def test_a_fault_is_said_and_its_remedy_takes_its_error_away(
    rows: tuple[Comparison, list[Compared]],
) -> None:
    plain, late, quiet = rows[1]
    assert late.named is True
    assert late.remedied is not None
    error = "external_rms_relative_error"
    assert late.remedied.metrics[error] < 0.5 * late.run.metrics[error]
    assert plain.named is None
    assert quiet.named is True
    assert all(row.as_expected for row in rows[1])


@pytest.mark.slow
def test_only_the_methods_that_are_asked_for(rows: tuple[Comparison, list[Compared]]) -> None:
    assert {tuple(row.run.estimates) for row in rows[1]} == {("external",)}


def claiming_too_much(run: Run) -> Run:
    """With a claim that no estimate keeps."""
    assert run.experiment is not None
    bound = {"external_max_z": Bound(at_most=0.0)}
    return replace(run, experiment=run.experiment.model_copy(update={"expect": bound}))


@pytest.mark.slow
def test_a_wrong_name_and_a_broken_bound_are_not_as_expected(
    rows: tuple[Comparison, list[Compared]],
) -> None:
    late = rows[1][1]
    for says in ("", "crosstalk"):
        wrong = replace(late, variant=replace(late.variant, says=says))
        assert wrong.named is False
        assert not wrong.as_expected
    assert not replace(late, run=claiming_too_much(late.run)).as_expected


@pytest.mark.slow
def test_json_holds_every_variant(rows: tuple[Comparison, list[Compared]]) -> None:
    found = comparison_as_json(*rows)
    assert found["as_expected"] is True
    late = found["variants"][1]
    assert late["said"][0] == "a plate that is late"
    (skew,) = late["remedied"]["nuisances"]["external"]
    assert skew["value"] == pytest.approx(4e-3, abs=10 * skew["sigma"])


WRONG = {
    'variant = "none"': "variant",
    '[[variant]]\nname = "x"\nset = ["motion.duration=3"]': "changes motion",
    '[[variant]]\nname = "x"\nset = ["measurement.rate=500"]': "changes measurement.rate",
    '[[variant]]\nname = "x"\nset = ["seed=4"]': "changes seed",
    '[[variant]]\nname = "x"\nset = ["measurement.nothing=1"]': "nothing",
    '[[variant]]\nname = "x"\nremedied.external_max_z = { at_most = 1.0 }': "no remedy",
    '[[variant]]\nname = "x"\nexpect.nothing = { at_most = 1.0 }': "nothing",
    '[[variant]]\nname = "x"\nsays = 3': "says",
    '[[variant]]\nset = ["seed=4"]': "name",
    "": "variant",
}


@pytest.mark.parametrize(("variants", "named"), WRONG.items())
def test_what_is_wrong_is_said(variants: str, named: str, tmp_path: Path) -> None:
    with pytest.raises(TestbedError) as error:
        Comparison.load(written(tmp_path, variants), SHORT)
    assert named in str(error.value)
    assert "\n" not in str(error.value)


def test_the_projects_own_comparison_can_be_read() -> None:
    comparison = Comparison.load(ROOT / "experiments/faults.toml")
    assert len(comparison.variants) > 10
    assert all(v.says is not None for v in comparison.variants[1:])


@pytest.mark.slow
def test_the_command_prints_a_table_or_json_and_its_exit_code_is_the_verdict(
    tmp_path: Path,
) -> None:
    words = [word for each in SHORT for word in ("--set", each)]
    written(tmp_path, QUIET)
    shown = command_line("compare", "made.toml", *words, cwd=tmp_path)
    assert shown.returncode == 0
    assert "quiet" in shown.stdout
    assert "the claim holds (2 of 2" in shown.stdout
    impossible = "expect.external_max_z = { at_most = 0.0 }"
    written(tmp_path, QUIET + impossible)
    failed = command_line("compare", "made.toml", "--json", *words, cwd=tmp_path)
    assert failed.returncode == 1
    assert json.loads(failed.stdout)["as_expected"] is False
    assert failed.stderr == ""


@pytest.mark.slow
def test_wrong_input_is_one_line(tmp_path: Path) -> None:
    written(tmp_path, "")
    for name in ("made.toml", "nowhere.toml"):
        found = command_line("compare", name, cwd=tmp_path)
        assert found.returncode == 2
        assert found.stdout == ""
        assert found.stderr.startswith("testbed: ")
        assert found.stderr.count("\n") == 1
    written(tmp_path, QUIET)
    found = command_line("compare", "made.toml", "--set", "motion.length=1", cwd=tmp_path)
    assert found.returncode == 2
    assert "'length'" in found.stderr


@pytest.mark.slow
def test_why_a_variant_is_not_as_expected_is_printed(
    rows: tuple[Comparison, list[Compared]],
) -> None:
    comparison, (plain, late, *_) = rows
    assert late.remedied is not None
    wrong = replace(
        late,
        run=claiming_too_much(late.run),
        remedied=claiming_too_much(late.remedied),
        variant=replace(late.variant, says="crosstalk"),
    )
    claimed = replace(comparison, claim="a late plate is said")
    said = printed(200, print_comparison, claimed, [plain, wrong])
    z = obtained(late.run, "external_max_z")
    assert f"late: {verdict(wrong.run)}" in said
    assert wrong.remedied is not None
    assert f"late: with its remedy: {verdict(wrong.remedied)}" in said
    assert z in verdict(wrong.run)
    assert f"late: what is said first is '{late.said[0]}', claimed 'crosstalk'" in said
    assert "claim: a late plate is said" in said
    assert "verdict: THE CLAIM FAILS (1 of 2 lines as expected)" in said
    told = printed(200, print_comparison, comparison, [plain, late])
    assert "verdict: the claim holds (2 of 2 lines as expected)" in told
    assert "late:" not in told
