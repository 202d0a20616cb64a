"""Hostile inputs, a small share; `python -m benchmarks hostile` runs thousands of each kind."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import pytest

from benchmarks.hostile.bombs import BOMBS
from benchmarks.hostile.case import Case
from benchmarks.hostile.judge import complaints
from benchmarks.hostile.kills import kills
from benchmarks.hostile.program import MAKERS, run
from benchmarks.hostile.worker import MEGABYTES, SECONDS

SHARES = {"models": 30, "recordings": 20, "foreign": 33, "experiments": 12, "listings": 20}
SEED = 1

linux = pytest.mark.skipif(sys.platform != "linux", reason="memory is told by Linux only")


def wrong(cases: list[Case]) -> dict[str, list[str]]:
    """Cases that are not treated well, and how."""
    return {
        f"{found.case.name} ({found.case.how}): {' '.join(found.case.words)}"[:300]: [
            *found.complaints,
            str(found.done.get("stderr"))[-2000:],
        ]
        for found in run(cases)
        if found.complaints
    }


@linux
@pytest.mark.slow
@pytest.mark.parametrize("kind", MAKERS)
def test_hostile_inputs_are_taken_or_refused_in_one_line(kind: str) -> None:
    assert wrong(list(MAKERS[kind](SHARES[kind], SEED))) == {}


@linux
@pytest.mark.slow
@pytest.mark.parametrize("command", ["minimal", "equations"])
def test_no_bomb_explodes(command: str) -> None:
    cases: list[Case] = []
    for name, make in BOMBS.items():
        files = make()
        cases.append(Case(f"bomb-{len(cases)}", name, (command, next(iter(files))), files))
    assert wrong(cases) == {}


@linux
@pytest.mark.slow
def test_what_a_killed_writer_was_to_replace_stays_whole() -> None:
    found = kills(3, SEED)
    assert found["not treated well"] == []
    assert found["left something"] == found["swept by the next"]


@pytest.mark.slow
def test_the_same_numbers_make_the_same_inputs() -> None:
    for maker in MAKERS.values():
        assert list(maker(8, 3)) == list(maker(8, 3))
        assert list(maker(12, 3))[:8] == list(maker(8, 3))
        assert list(maker(8, 4)) != list(maker(8, 3))


REFUSED: dict[str, Any] = {
    "code": 2,
    "seconds": 1.0,
    "megabytes": 10.0,
    "stdout": "",
    "stderr": "testbed: there is no model file 'x'\n",
}
CASE = Case("case", "how", ("minimal", "x"), outputs=("out",))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, ""),
        ({"code": 0, "stderr": ""}, ""),
        ({"code": 1, "stdout": "a table\n", "stderr": "note: more\n"}, ""),
        ({"stderr": "note: first\ntestbed: then this\n"}, ""),
        ({"code": 3}, "exit code 3"),
        ({"code": 70}, "a traceback"),
        ({"code": -11}, "exit code -11"),
        ({"code": "it returned"}, "exit code it returned"),
        ({"died": "signal 11"}, "died: signal 11"),
        ({"stderr": ""}, "0 lines of refusal"),
        ({"stderr": "testbed: a\nb\n"}, "2 lines of refusal"),
        ({"stderr": "error: a\n"}, "1 lines of refusal"),
        ({"stderr": "testbed: \n"}, "a refusal without words"),
        ({"stderr": "testbed: a\x1b[2J\n"}, "control characters on standard error"),
        ({"stderr": f"testbed: {'a' * 501}\n"}, "a message too long"),
        ({"code": 0, "stderr": "", "stdout": "a\u202eb\n"}, "control characters on standard"),
        ({"code": 0, "stderr": "Exception ignored in: x\n"}, "words of the interpreter"),
        ({"seconds": SECONDS + 0.1}, "more than 20 s"),
        ({"megabytes": MEGABYTES + 1.0}, "more than 1000 MB"),
    ],
)
def test_the_judge_sees_what_is_wrong(change: Mapping[str, Any], said: str) -> None:
    found = complaints(CASE, {**REFUSED, **change}, {}, {})
    assert len(found) == bool(said)
    assert said in "".join(found)


@pytest.mark.parametrize(
    ("code", "before", "after", "said"),
    [
        (2, {"x": b"1"}, {"x": b"1"}, ""),
        (0, {"x": b"1"}, {"x": b"1", "out": b"", "out/result.json": b"2"}, ""),
        (2, {"x": b"1"}, {"x": b"2"}, "an input changed"),
        (2, {"x": b"1"}, {}, "an input changed"),
        (2, {}, {"out": b""}, "left behind: out"),
        (0, {}, {"MUJOCO_LOG.TXT": b""}, "left behind: MUJOCO_LOG.TXT"),
        (0, {}, {"out": b"", "out/.testbed-here-1": b""}, "left behind: .testbed-"),
    ],
)
def test_the_judge_sees_what_is_left_behind(
    code: int, before: dict[str, bytes], after: dict[str, bytes], said: str
) -> None:
    stderr = REFUSED["stderr"] if code == 2 else ""
    found = complaints(CASE, {**REFUSED, "code": code, "stderr": stderr}, before, after)
    assert found == ([said] if said else [])
