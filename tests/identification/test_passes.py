"""Passes over the samples: threads that work at once, in constant memory, in order."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.kernel import numba_engine
from testbed.recordings.recording import Recording
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.robots import random_robot

WAIT = 60.0  # seconds after which a thread that should have company has none


@pytest.fixture(scope="module")
def tree() -> tb.Tree:
    return random_robot(np.random.default_rng(4), 2).tree()


@pytest.fixture(scope="module")
def recording(tree: tb.Tree) -> Recording:
    return ideal(tree, duration=1000.0, rate=200.0, seed=3)


@pytest.fixture
def sweeps(monkeypatch: pytest.MonkeyPatch) -> list[Callable[[], None]]:
    """The compiled kernel for every job; what is in the list is called before each sweep."""
    hooks: list[Callable[[], None]] = []
    real = numba_engine.sweep

    def sweep(*arguments: Any) -> Any:
        for hook in hooks:
            hook()
        return real(*arguments)

    monkeypatch.setattr("testbed.identification.passes.SMALL", 0.0)
    monkeypatch.setattr(numba_engine, "sweep", sweep)
    return hooks


@pytest.mark.slow
@pytest.mark.parametrize("threads", [2, 3])
def test_as_many_threads_as_asked_answer_at_once(
    threads: int, tree: tb.Tree, recording: Recording, sweeps: list[Callable[[], None]]
) -> None:
    """The first windows wait for each other: with fewer threads, for ever."""
    together = threading.Barrier(threads)
    first = iter(range(threads))

    def meet() -> None:
        if next(first, None) is not None:
            together.wait(WAIT)

    sweeps.append(meet)
    tb.identify(tree, recording, "external", settings=EXACT, threads=threads)
    assert not together.broken


@pytest.mark.slow
def test_one_thread_works_where_it_was_called(
    tree: tb.Tree, recording: Recording, sweeps: list[Callable[[], None]]
) -> None:
    seen: set[int] = set()
    sweeps.append(lambda: seen.add(threading.get_ident()))
    tb.identify(tree, recording, "external", settings=EXACT, threads=1)
    assert seen == {threading.get_ident()}


def test_more_samples_are_read_only_as_answers_are_taken(
    tree: tb.Tree,
    recording: Recording,
    sweeps: list[Callable[[], None]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Windows that were read and not yet answered are at most two more than the threads."""
    lock = threading.Lock()
    read, answered, most = 0, 0, 0
    real = Recording.part

    def part(self: Recording, first: int, last: int) -> Recording:
        nonlocal read, most
        with lock:
            read += 1
            most = max(most, read - answered)
        return real(self, first, last)

    def count() -> None:
        nonlocal answered
        with lock:
            answered += 1

    monkeypatch.setattr(Recording, "part", part)
    sweeps.append(count)
    tb.identify(tree, recording, "external", settings=EXACT, threads=2)
    assert read > 8
    assert most <= 4


def test_progress_ends_at_the_end(
    tree: tb.Tree, recording: Recording, sweeps: list[Callable[[], None]]
) -> None:
    """Samples done only grow, in steps of windows, to all of them."""
    steps: list[tuple[int, int]] = []
    tb.identify(
        tree,
        recording,
        "external",
        settings=EXACT,
        progress=lambda done, total: steps.append((done, total)),
    )
    done = [now for now, _ in steps]
    assert done == sorted(done)
    assert len({total for _, total in steps}) == 1
    assert steps[-1][0] == steps[-1][1] == 2 * recording.samples
    assert len(steps) > 4
