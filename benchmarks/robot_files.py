"""Robots of packages on PyPI: what `new` writes runs, no file edited.

Every URDF of example-robot-data, and the MJCF of robosuite where it is installed
(`pip install --no-deps robosuite`): it is not imported.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tests.helpers.paths import REAL, ROOT

SECONDS = 600.0
"""Longest that one command may take."""

NO_ROBOTS = ("no joint that moves", "not a valid URDF")
"""Why nothing can run."""


def runs(only: str, seconds: float) -> Iterator[dict[str, Any]]:
    """A line a file, then all of them.

    Args:
        only: Files whose paths hold this.
        seconds: Of motion.
    """
    found: dict[str, list[str]] = {}
    for name, path in sorted(_files()):
        if only in name:
            came, why, spent = _run(path, seconds)
            found.setdefault(came, []).append(name)
            yield {"robot": name, "came": came, "why": why, "cpu_s": round(spent, 1)}
    counts = {came: len(names) for came, names in found.items()}
    yield {"benchmark": "robots", "files": sum(counts.values())} | counts


def _files() -> Iterator[tuple[str, Path]]:
    """Names and places of model files."""
    for path in REAL.rglob("*.urdf"):
        yield str(path.relative_to(REAL)), path
    package = find_spec("robosuite")
    for place in () if package is None else package.submodule_search_locations or ():
        for path in (Path(place) / "models/assets/robots").glob("*/robot.xml"):
            yield f"robosuite/{path.parent.name}", path


def _run(path: Path, seconds: float) -> tuple[str, str, float]:
    """What came of one file, why, and the CPU time that it took [s]."""
    short = (f"motion.duration={seconds:g}", "motion.candidates=1")
    settings = [word for each in short for word in ("--set", each)]
    before = os.times()
    came, why = "runs", ""
    with tempfile.TemporaryDirectory() as folder:
        for words in (["new", str(path), "--out", "r.toml"], ["run", "r.toml", *settings]):
            command = [sys.executable, "-m", "testbed", *words]
            try:
                done = subprocess.run(
                    command,
                    cwd=folder,
                    env={**os.environ, "PYTHONPATH": str(ROOT)},
                    capture_output=True,
                    text=True,
                    check=False,
                    timeout=SECONDS,
                )
            except subprocess.TimeoutExpired:
                came, why = f"{words[0]} takes too long", ""
                break
            if done.returncode > 1:
                why = (done.stderr.splitlines() or [""])[-1]
                none = any(reason in why for reason in NO_ROBOTS)
                came = "no robot" if none else f"{words[0]} refused"
                break
    after = os.times()
    spent = after.children_user + after.children_system
    return came, why, spent - before.children_user - before.children_system
