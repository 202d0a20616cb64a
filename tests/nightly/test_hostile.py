"""Bombs and killed workers, each once.

`python -m benchmarks hostile` draws thousands of inputs and kills writers, `campaign` kills command
and scheduler.
"""

from __future__ import annotations

import shutil
import sys
from typing import Any

import pytest

from benchmarks import campaign
from benchmarks.hostile.bombs import BOMBS
from benchmarks.hostile.case import Case
from benchmarks.hostile.judge import complaints
from benchmarks.hostile.kills import WRITERS, kills
from benchmarks.hostile.program import Worker
from benchmarks.hostile.worker import MEGABYTES, SECONDS

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="memory is told by Linux only"),
]


def test_no_bomb_explodes() -> None:
    with Worker() as worker:
        for name, make in BOMBS.items():
            files = make()
            case = Case(("minimal", next(iter(files))), files)
            assert not worker.complaints(case), name


def test_a_worker_killed_at_a_random_moment_costs_no_run() -> None:
    assert campaign.kills("worker", 3, 20, 1)["same_table"] == 3


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace makes system calls fail")
def test_a_fault_while_outputs_are_replaced_leaves_the_older_ones_or_the_new_ones() -> None:
    """In every command that writes, once; `python -m benchmarks hostile --kills 200` tries more."""
    assert kills(len(WRITERS), 1)["not treated well"] == []


REFUSED: dict[str, Any] = {
    "code": 2, "seconds": 1.0, "wall": 1.0, "megabytes": 10.0, "stdout": "",
    "stderr": "testbed: there is no model file 'x'\n",
}  # fmt: skip
CHANGES: list[dict[str, Any]] = [
    {"code": 3}, {"code": "it returned"}, {"died": "signal 11"}, {"stderr": ""},
    {"stderr": "testbed: a\nb\n"}, {"stderr": "testbed: a\x1b[2J\n"},
    {"stderr": f"testbed: {'a' * 501}\n"}, {"code": 0, "stderr": "", "stdout": "a\u202eb\n"},
    {"seconds": SECONDS + 0.1}, {"megabytes": MEGABYTES + 1.0},
]  # fmt: skip


def test_the_judge_sees_what_is_wrong() -> None:
    case = Case(("minimal", "x"), outputs=("out",))
    assert not complaints(case, REFUSED, {"x": b"1"}, {"x": b"1"})
    assert [change for change in CHANGES if not complaints(case, REFUSED | change, {}, {})] == []
    assert complaints(case, REFUSED, {"x": b"1"}, {"x": b"2"})
    assert complaints(case, REFUSED, {}, {"out": b""})
