"""A process that carries out command lines one after the other, under limits, and reports.

Reads tasks from standard input and answers on what standard output was at the start, a JSON
line each; what the commands print goes to files in memory.
"""

from __future__ import annotations

import io
import json
import os
import resource
import signal
import sys
import time
from pathlib import Path
from typing import Any

SECONDS = 20
"""Of processor time, and on the clock, that a command may take."""
MEGABYTES = 1000
"""That it may take above what the loaded libraries do."""
SHOWN = 100_000
"""Characters of output that are reported."""


def main() -> None:
    """Until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    for stream in (1, 2):
        os.dup2(os.memfd_create(f"stream{stream}"), stream)
    _load_libraries()
    _limit_memory()
    for line in sys.stdin:
        task = json.loads(line)
        answers.write(json.dumps(carried_out(task["folder"], task["words"])) + "\n")
        answers.flush()


def carried_out(folder: str, words: list[str]) -> dict[str, Any]:
    """Exit code, streams, seconds and megabytes of a command line."""
    from testbed.cli.main import main as command

    os.chdir(folder)
    sys.argv = ["testbed", *words]
    for stream in (1, 2):
        os.ftruncate(stream, 0)
        os.lseek(stream, 0, os.SEEK_SET)
    sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False))
    sys.stderr = io.TextIOWrapper(io.FileIO(2, "w", closefd=False), errors="backslashreplace")
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    used = int(time.process_time())
    resource.setrlimit(resource.RLIMIT_CPU, (used + 2 * SECONDS, resource.RLIM_INFINITY))
    before = _resident(reset=True)
    start, wall = time.process_time(), time.monotonic()
    code: Any = "it returned"
    try:
        command()
    except SystemExit as done:
        code = done.code
    seconds = time.process_time() - start
    sys.stdout.flush()
    sys.stderr.flush()
    return {
        "code": code,
        "seconds": seconds,
        "wall": time.monotonic() - wall,
        "megabytes": (_resident(peak=True) - before) / 1e6,
        "stdout": _content(1),
        "stderr": _content(2),
    }


def _content(stream: int) -> str:
    size = os.fstat(stream).st_size
    text = os.pread(stream, min(size, SHOWN), 0).decode(errors="replace")
    return text if size <= SHOWN else f"{text}\n({size} bytes)"


def _resident(*, peak: bool = False, reset: bool = False) -> int:
    """Bytes in memory, now or at most since the last reset."""
    if reset:
        Path("/proc/self/clear_refs").write_text("5")
    word = "VmHWM:" if peak else "VmRSS:"
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith(word)]
    return int(line.split()[1]) * 1024


def _limit_memory() -> None:
    """An end to what may be asked for, far above what may be used: libraries reserve much."""
    reserved = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    most = reserved + 6 * MEGABYTES * 1_000_000
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _load_libraries() -> None:
    """What commands import when they are called: once for all, so that it counts for none."""
    import testbed.cli.commands
    import testbed.core.robot.formats.mjcf
    import testbed.core.robot.formats.urdf
    import testbed.equations.compare
    import testbed.equations.languages
    import testbed.lab.experiment.carry_out
    import testbed.view.minimal_sets
    import testbed.view.output
    import testbed.view.viewer.log  # noqa: F401
    from testbed.core.kernel.warm_up import warm_up

    warm_up()


if __name__ == "__main__":
    main()
