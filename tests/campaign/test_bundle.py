"""A bundle where the worker is: what fails is an outcome with its reason, the rest goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from testbed.campaign.bundle import Bundle, Outcome, carry_out_bundle
from testbed.campaign.campaign import Campaign
from testbed.campaign.conduct import conduct
from testbed.errors import ExperimentError
from testbed.experiment import evaluate
from testbed.experiment import simulate as simulation
from tests.helpers.campaigns import NOISES, Odd, campaign_file, made_up


@pytest.fixture
def bundle(tmp_path: Path) -> Bundle:
    kept: list[Bundle] = []

    def work(bundle: Bundle) -> tuple[list[Outcome], float]:
        kept.append(bundle)
        return made_up(bundle)

    conduct(Campaign.load(campaign_file(tmp_path, 1, NOISES)), tmp_path / "r", Odd(work))
    return kept[0]


def test_another_version_of_the_code_does_nothing(bundle: Bundle) -> None:
    with pytest.raises(ExperimentError, match="a worker has another version of testbed"):
        carry_out_bundle(replace(bundle, code="another"))


def test_other_files_are_found_run_by_run(bundle: Bundle) -> None:
    (run, words), *rest = bundle.runs
    wrong = (("0" * len(run), words), (run, (*words, "seed=many")), *rest)
    outcomes, seconds = carry_out_bundle(replace(bundle, runs=wrong))
    assert [each.run for each in outcomes] == [run for run, _ in wrong]
    first, second, *others = outcomes
    assert (first.status, second.status) == ("failed", "failed")
    assert first.error == "the worker finds other files than this command did"
    assert "seed" in second.error
    assert (first.metrics, second.metrics, first.recording) == (None, None, None)
    assert {each.status for each in others} <= {"done"}
    assert seconds > 0


def raising(error: Exception) -> Callable[..., Any]:
    def work(*_: object, **__: object) -> None:
        raise error

    return work


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (ExperimentError("there is no plate"), "failed", "there is no plate"),
        (ZeroDivisionError("by nothing"), "failed", "ZeroDivisionError: by nothing"),
        (MemoryError("none left"), "killed", "MemoryError: none left"),
    ],
)
@pytest.mark.parametrize("where", ["simulation", "evaluation"])
def test_a_run_that_fails_says_why(
    where: str,
    error: Exception,
    status: str,
    said: str,
    bundle: Bundle,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Errors that are none of testbed's with their kind; without memory, it may be tried again."""
    if where == "evaluation":
        monkeypatch.setattr(evaluate, "evaluate", raising(error))
    else:
        monkeypatch.setattr(simulation, "simulate_motions", raising(error))
    outcomes, _ = carry_out_bundle(bundle)
    assert {(each.status, each.error) for each in outcomes} == {(status, said)}


def test_a_run_without_any_estimate_says_why_there_is_none(
    bundle: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = evaluate.evaluate

    def without(*words: Any, **options: Any) -> Any:
        done = whole(*words, **options)
        return replace(done, estimates={}, failures={"external": "no wrench", "internal": "none"})

    monkeypatch.setattr(evaluate, "evaluate", without)
    outcomes, _ = carry_out_bundle(bundle)
    assert {each.error for each in outcomes} == {"no wrench; none"}
