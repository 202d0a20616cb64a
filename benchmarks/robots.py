"""Robots of packages on PyPI: what `new` writes runs, no file edited.

Every URDF of example-robot-data, and the MJCF of packages that are installed (`pip install
--no-deps robosuite dm_control gymnasium gymnasium-robotics`): they are not imported.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.lines import print_lines
from tests.helpers.paths import REAL, ROOT

SECONDS = 600.0
"""Longest that one command may take."""

NO_ROBOTS = ("no joint that moves", "not a valid URDF", "not a valid MJCF", "Error opening file")
"""Why nothing can run: packages ship scenes, parts, and files without their meshes."""

LONG = 10.0
"""Of a period [s]: of the many parameters of a robot with a longer one only a whole period tells,
and coloured noise of as many unknowns takes a minute."""

MOST_SIGMAS = 6.0
"""Largest error of any of some hundred parameters, by chance once in a million runs."""

MODELS = {
    "robosuite": ("models/assets/robots/*/robot.xml",),
    "dm_control": (
        "suite/*.xml",
        "locomotion/walkers/assets/*.xml",
        "locomotion/walkers/assets/*/*.xml",
        "third_party/*/*.xml",
    ),
    "gymnasium": ("envs/mujoco/assets/*.xml",),
    "gymnasium_robotics": ("envs/assets/*/*.xml", "envs/mujoco/assets/*.xml"),
}
"""Where packages have their robots; what is to be included in others has no `<worldbody>`."""


def runs(only: str, seconds: float) -> Iterator[dict[str, Any]]:
    """A line a file, then all of them."""
    found: dict[str, list[str]] = {}
    for name, path in sorted(_files()):
        if only in name:
            line = {"robot": name} | _run(path, seconds)
            found.setdefault(line["came"], []).append(name)
            yield line
    counts = {came: len(names) for came, names in found.items()}
    yield {"benchmark": "robots", "files": sum(counts.values())} | counts


def _files() -> Iterator[tuple[str, Path]]:
    """Names and places of model files."""
    for path in REAL.rglob("*.urdf"):
        yield str(path.relative_to(REAL)), path
    for package, patterns in MODELS.items():
        spec = find_spec(package)
        for place in () if spec is None else spec.submodule_search_locations or ():
            for path in (path for pattern in patterns for path in Path(place).glob(pattern)):
                if b"<worldbody" in path.read_bytes():
                    yield f"{package}/{path.relative_to(place)}", path


def _run(path: Path, seconds: float) -> dict[str, Any]:
    """What came of one file.

    The largest error of the plate's estimate in its own sigmas, or why there is no estimate; CPU
    time [s].
    """
    before = os.times()
    found: dict[str, Any] = {"came": "runs"}
    with tempfile.TemporaryDirectory() as folder:
        for words in (["new", str(path), "--out", "r.toml"], ["run", "r.toml", "--json"]):
            if words[0] == "run":
                words += _short(Path(folder) / "r.toml", seconds)
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
                found = {"came": f"{words[0]} takes too long"}
                break
            if done.returncode > 1:
                why = (done.stderr.splitlines() or [""])[-1]
                none = any(reason in why for reason in NO_ROBOTS)
                found = {"came": "no robot" if none else f"{words[0]} refused", "why": why}
                break
            if words[0] == "run":
                found["max_z"] = json.loads(done.stdout)["score"]["metrics"].get("wrench_max_z")
                if not 0 < (found["max_z"] or 0.0) < MOST_SIGMAS:
                    found["came"] = "wrong"
    after = os.times()
    spent = after.children_user + after.children_system
    spent -= before.children_user + before.children_system
    return found | {"cpu_s": round(spent, 1)}


def _short(file: Path, seconds: float) -> list[str]:
    """Words that make a run of what `new` wrote as short as it may be."""
    period = 1 / tomllib.loads(file.read_text())["motion"]["fundamental"]
    said = [f"motion.duration={max(period if period > LONG else 0.0, seconds):g}"]
    said += ["motion.candidates=1", "excitation.clearance=off"]
    return [word for each in said for word in ("--set", each)]


def main(
    seconds: Annotated[float, typer.Option(help="Of motion.")] = 6.0,
    only: Annotated[str, typer.Option(help="Only files whose paths hold this.")] = "",
) -> None:
    """`new` and a run of every robot of some packages; exit code 1 if one is refused or wrong."""
    *_, line = print_lines(runs(only, seconds))
    raise typer.Exit(int(line.get("runs", 0) + line.get("no robot", 0) < line["files"]))
