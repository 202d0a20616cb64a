"""Bombs and killed writers, each once; `python -m benchmarks hostile` draws thousands of inputs."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from benchmarks.hostile.bombs import BOMBS
from benchmarks.hostile.case import Case
from benchmarks.hostile.judge import complaints
from benchmarks.hostile.kills import kills
from benchmarks.hostile.program import Worker
from benchmarks.hostile.worker import MEGABYTES, SECONDS

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="memory is told by Linux only"),
]


def test_no_bomb_explodes() -> None:
    with Worker() as worker:
        wrong = {
            name: found
            for name, make in BOMBS.items()
            if (found := worker.complaints(_minimal(make())))
        }
    assert wrong == {}


def _minimal(files: dict[str, bytes]) -> Case:
    return Case(("minimal", next(iter(files))), files)


def test_what_a_killed_writer_was_to_replace_stays_whole() -> None:
    found = kills(3, 1)
    assert found["not treated well"] == []
    assert found["left something"] == found["swept by the next"]


REFUSED: dict[str, Any] = {
    "code": 2, "seconds": 1.0, "megabytes": 10.0, "stdout": "",
    "stderr": "testbed: there is no model file 'x'\n",
}  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        {"code": 3}, {"code": "it returned"}, {"died": "signal 11"}, {"stderr": ""},
        {"stderr": "testbed: a\nb\n"}, {"stderr": "testbed: a\x1b[2J\n"},
        {"stderr": f"testbed: {'a' * 501}\n"}, {"code": 0, "stderr": "", "stdout": "a\u202eb\n"},
        {"seconds": SECONDS + 0.1}, {"megabytes": MEGABYTES + 1.0},
    ],
)  # fmt: skip
def test_the_judge_sees_what_is_wrong(change: dict[str, Any]) -> None:
    case = Case(("minimal", "x"), outputs=("out",))
    assert not complaints(case, REFUSED, {"x": b"1"}, {"x": b"1"})
    assert complaints(case, {**REFUSED, **change}, {}, {})
    assert complaints(case, REFUSED, {"x": b"1"}, {"x": b"2"})
    assert complaints(case, REFUSED, {}, {"out": b""})
