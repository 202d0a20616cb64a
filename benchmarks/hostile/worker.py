"""A process that carries out command lines one after the other, under limits, and reports.

Reads tasks from standard input and answers on what standard output was at the start, a JSON
line each; what the commands print goes to files in memory.
"""

from __future__ import annotations

import json
import os
import resource
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
    from benchmarks.timing import forget_peak, peak_rss
    from tests.helpers.command import command_line

    used = int(time.process_time())
    resource.setrlimit(resource.RLIMIT_CPU, (used + 2 * SECONDS, resource.RLIM_INFINITY))
    forget_peak()
    before, start, wall = peak_rss(), time.process_time(), time.monotonic()
    done = command_line(*words, cwd=Path(folder))
    return {
        "code": done.returncode,
        "seconds": time.process_time() - start,
        "wall": time.monotonic() - wall,
        "megabytes": (peak_rss() - before) * 1.024**2,
        "stdout": done.stdout[:SHOWN],
        "stderr": done.stderr[:SHOWN],
    }


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
