"""What comes of a bundle on a worker: its outcomes, a death, or the end of the campaign."""

from __future__ import annotations

from typing import Any

import pytest

from testbed.campaign.bundle import Bundle, Outcome
from testbed.campaign.cluster import DaskEngine, SchedulerLost
from testbed.errors import ExperimentError

distributed = pytest.importorskip("distributed")


class Answer:
    """A future that has ended."""

    def __init__(self, result: Any, status: str = "finished") -> None:
        self.status, self._result = status, result
        self.released = False

    def result(self) -> Any:
        if isinstance(self._result, Exception):
            raise self._result
        return self._result

    def release(self) -> None:
        self.released = True


def bundle(count: int) -> Bundle:
    runs = tuple((f"run {k}", (f"seed={k}",)) for k in range(count))
    return Bundle("base.toml", {"a": 1}, ("external",), False, "code", runs)


def answered(answer: Answer, of: Bundle, apart: list[Bundle]) -> Any:
    found = DaskEngine(None, lambda each: ([], 0.0))._answer(answer, of, apart)
    assert answer.released
    return found


@pytest.fixture
def killed() -> Exception:
    """As Dask says that workers died."""
    error: Exception = distributed.scheduler.KilledWorker("task", None, 3)
    return error


def test_outcomes_are_handed_on() -> None:
    came = ([Outcome("run 0", "done")], 2.5)
    assert answered(Answer(came), bundle(1), []) is came


@pytest.mark.parametrize("count", [2, 3, 7])
def test_a_bundle_with_which_workers_died_is_taken_apart(count: int, killed: Exception) -> None:
    apart: list[Bundle] = []
    whole = bundle(count)
    assert answered(Answer(killed), whole, apart) is None
    assert [each.runs for each in apart] == [(run,) for run in whole.runs]
    for each in apart:
        assert (each.base, each.content, each.methods, each.keeps, each.code) == (
            whole.base, whole.content, whole.methods, whole.keeps, whole.code
        )  # fmt: skip


def test_a_run_with_which_workers_died_alone_is_an_outcome(killed: Exception) -> None:
    apart: list[Bundle] = []
    (outcome,), seconds = answered(Answer(killed), bundle(1), apart)
    assert (outcome.run, outcome.status) == ("run 0", "killed")
    assert "workers died with it, perhaps for lack of memory" in outcome.error
    assert seconds > 0
    assert apart == []


@pytest.mark.parametrize("status", ["cancelled", "lost"])
def test_what_nobody_works_at_any_more_means_that_the_scheduler_is_gone(status: str) -> None:
    engine, answer = DaskEngine(None, lambda each: ([], 0.0)), Answer(None, status)
    with pytest.raises(SchedulerLost, match="the same command goes on"):
        engine._answer(answer, bundle(1), [])


@pytest.mark.parametrize(
    ("error", "kind", "said"),
    [
        (ExperimentError("other files"), ExperimentError, "^other files$"),
        (KeyError("x"), ExperimentError, "^the workers cannot do it: KeyError: 'x'$"),
        (distributed.client.FutureCancelledError("k", "r"), SchedulerLost, "scheduler is gone"),
        (distributed.comm.CommClosedError("gone"), SchedulerLost, "scheduler is gone"),
    ],
)
def test_errors_of_the_work_and_of_the_cluster_are_told_apart(
    error: Exception, kind: type[Exception], said: str
) -> None:
    answer = Answer(error)
    with pytest.raises(kind, match=said) as told:
        DaskEngine(None, lambda each: ([], 0.0))._answer(answer, bundle(2), [])
    assert type(told.value) is kind
    assert answer.released
