"""The command line as a person calls it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CLI = (sys.executable, "-m", "testbed.cli")


def command_line(
    *words: str, cwd: Path, seconds: float | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command.

    Args:
        words: As typed.
        cwd: Where.
        seconds: How long it may take.
    """
    return subprocess.run(
        [*CLI, *words], cwd=cwd, capture_output=True, text=True, check=False, timeout=seconds
    )
