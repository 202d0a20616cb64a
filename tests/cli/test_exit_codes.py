"""How a command ends, and what it says, for each kind of thing that goes wrong."""

from __future__ import annotations

import errno
from typing import Any

import pytest

from testbed.cli import main
from testbed.cli.checkup import Check
from testbed.errors import ModelError, UnknownName

ENDS: dict[str, tuple[BaseException, int, str]] = {
    "input": (ModelError("r.urdf: no robot"), 2, "testbed: r.urdf: no robot\n"),
    "a word": (
        UnknownName("joint", "ellbow", ("elbow", "waist")),
        2,
        "testbed: unknown joint 'ellbow'; did you mean 'elbow'? (known: elbow, waist)\n",
    ),
    "a pipe": (BrokenPipeError(errno.EPIPE, "Broken pipe"), 141, ""),
    "a disk": (
        OSError(errno.ENOSPC, "No space left on device", "a.rrd"),
        2,
        "testbed: 'a.rrd': No space left on device\n",
    ),
    "a system without words": (OSError("odd"), 2, "testbed: odd\n"),
    "memory": (MemoryError(), 2, "testbed: not enough memory; ask for less, such as "),
    "depth": (RecursionError(), 2, "testbed: the input is nested too deeply\n"),
    "text": (
        UnicodeDecodeError("utf-8", b"ab\xff", 2, 3, "invalid start byte"),
        2,
        "testbed: a file that should be text is not UTF-8: invalid start byte at byte 2\n",
    ),
    "a library": (ImportError("no libGL"), 70, "testbed: a library cannot be loaded: no libGL\n"),
}


@pytest.mark.parametrize("name", ENDS)
def test_what_goes_wrong_is_one_line_and_an_exit_code(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    error, code, said = ENDS[name]
    assert main._told(error) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(said) if said else err == ""
    assert err.count("\n") == bool(said)


def test_a_fault_of_the_program_is_told_as_one(capsys: pytest.CaptureFixture[str]) -> None:
    """With all that a report needs."""
    assert main._told(ZeroDivisionError("here")) == 70
    err = capsys.readouterr().err
    assert "ZeroDivisionError: here" in err
    assert err.endswith("testbed: the above is a fault of the program; please report it\n")


def test_a_check_says_its_cure_only_where_it_is_not_fine() -> None:
    words: dict[str, Any] = {"name": "kernel", "found": "none", "cure": "make one"}
    assert Check(**words).line == f"{'ok':8s}{'kernel':22s}none"
    assert Check(**words, fine=False).line == f"{'-':8s}{'kernel':22s}none: make one"
    line = Check(**words, fine=False, needed=True).line
    assert line == f"{'MISSING':8s}{'kernel':22s}none: make one"
    assert Check("kernel", "none", False).line == f"{'-':8s}{'kernel':22s}none"
