"""How a command ends: exit codes, one line whatever goes wrong, Ctrl-C, a full disk, no reader."""

from __future__ import annotations

import errno
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from testbed.cli import main
from testbed.core.base.errors import LONGEST_MESSAGE, ModelError, UnknownName
from tests.helpers.command import CLI, command_line
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow

ENDS: list[tuple[BaseException, int, str]] = [
    (ModelError("r.urdf: no robot"), 2, "r.urdf: no robot"),
    (UnknownName("joint", "ellbow", ("elbow", "waist")), 2, "'elbow'"),
    (OSError(errno.ENOSPC, "No space left on device", "a.rrd"), 2, "'a.rrd': No space left"),
    (OSError("odd"), 2, "odd"),
    (MemoryError(), 2, "memory"),
    (RecursionError(), 2, "nested"),
    (UnicodeDecodeError("utf-8", b"ab\xff", 2, 3, "invalid start byte"), 2, "byte 2"),
    (ModelError("a " * 10**6), 2, "a a a"),
    (ModelError("\x1b[2J\u202e\r\nb\x85c"), 2, r"\x1b[2J\u202e b c"),
    (ImportError("no libGL"), 70, "no libGL"),
    (ZeroDivisionError("of ours"), 70, "ZeroDivisionError: of ours"),
    (BrokenPipeError(errno.EPIPE, "Broken pipe"), 141, ""),
]
"""What may happen, the exit code, and what is said of it."""


def raising(error: BaseException) -> Callable[[], int]:
    def command() -> int:
        raise error

    return command


def process(words: list[str], shell: str = "{}", **around: str) -> subprocess.CompletedProcess[str]:
    """A command of its own, as a shell runs it."""
    script = shell.format(shlex.join(words))
    return subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, check=False, cwd=ROOT,
        env=os.environ | around,
    )  # fmt: skip


def program(body: str) -> list[str]:
    """Words of the program with another command in the place of its own."""
    code = f"from testbed.cli import main\ndef command():\n    {body}\n"
    return [sys.executable, "-c", f"{code}main._command = command\nmain.main()"]


def test_whatever_happens_is_one_line_and_an_exit_code(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A fault of the program comes with all that a report needs; it is no failed claim."""
    for error, code, said in ENDS:
        monkeypatch.setattr(main, "_command", raising(error))
        done = command_line(cwd=tmp_path)
        lines = done.stderr.removesuffix("\n").split("\n")
        assert (done.returncode, done.stdout) == (code, ""), error
        assert said in done.stderr
        assert lines[-1].startswith("testbed: " if said else "")
        assert lines[-1].isprintable()
        assert len(lines) == 1 or "of ours" in said
        assert len(lines[-1]) <= LONGEST_MESSAGE + len("testbed: ")


def test_output_that_nobody_takes(place: Path) -> None:
    """A full disk is said once; a reader that has gone, or closed streams, need no word."""
    words = [*CLI, "minimal", str(place / "two.urdf")]
    full = process(words, "{} > /dev/full")
    assert (full.returncode, full.stderr) == (2, "testbed: No space left on device\n")
    for shell, codes in (("{} >&-", (0,)), ("set -o pipefail; {} | true", (0, 141))):
        done = process(words, shell)
        assert done.returncode in codes
        assert done.stderr == ""
    for shell in ("{} 2>&- >&- <&-", "{} 2> /dev/full"):
        done = process([*CLI, "minimal", "nowhere.xml"], shell)
        assert (done.returncode, done.stdout, done.stderr) == (2, "", "")


def test_ctrl_c_is_one_line_then_the_end() -> None:
    """Also where a library turns it into an error of its own; a second one ends at once.

    The same by the signals of another process and of a terminal that is closed.
    """
    kill = "import os, signal\n    try: os.kill(os.getpid(), signal.SIGINT)\n    "
    said = process(program(f"{kill}except KeyboardInterrupt: raise ImportError('no numpy')"))
    assert (said.returncode, said.stderr) == (130, "testbed: interrupted\n")
    twice = process(program(f"{kill}finally: os.kill(os.getpid(), signal.SIGINT)"), "exec {}")
    assert (twice.returncode, twice.stderr) == (-signal.SIGINT, "")
    for number in ("INT", "TERM", "HUP"):
        ended = kill.replace("SIGINT", f"SIG{number}") + "finally: pass\n    return 0"
        heard, ignored = process(program(ended)), process(program(ended), f"trap '' {number}; {{}}")
        assert (heard.returncode, heard.stderr) == (130, "testbed: interrupted\n")
        assert (ignored.returncode, ignored.stderr) == (0, "")


def test_ctrl_c_ends_a_search_with_the_best_motion_so_far(place: Path, tmp_path: Path) -> None:
    """It is proven and written like any other."""
    words = ["excite", str(place / "two.urdf"), "--set", "excitation.starts=10000"]
    with subprocess.Popen(
        [*CLI, *words, "--set", "motion.duration=6"], cwd=tmp_path, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    ) as run:  # fmt: skip
        assert run.stderr is not None
        assert run.stderr.readline().startswith("note: ")  # it has begun to search
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=120)
    assert run.returncode == 0
    assert command_line("excite", "motion.toml", "--check", cwd=tmp_path).returncode == 0


def test_starting_loads_only_what_is_needed(place: Path) -> None:
    """Help nothing heavy; `minimal` no physics engine, which would look for a window."""
    code = "import sys\nfrom testbed.cli import main, reading\nprint(*sys.modules)\n"
    code += "sys.argv[1:] = ['minimal', sys.argv[1]]\n"
    code += "try: main.main()\nfinally: print(*sys.modules)"
    first, *_, last = process(
        [sys.executable, "-c", code, str(place / "two.urdf")]
    ).stdout.splitlines()
    heavy = {"mujoco", "pinocchio", "scipy", "pyarrow", "rerun", "numpy", "numba", "matplotlib"}
    assert heavy & set(first.split()) == set()
    assert heavy & set(last.split()) == {"pinocchio", "numpy"}
