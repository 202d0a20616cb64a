"""All tools on the same recordings, each in a process of its own, as one table."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench import NOISES, ROBOTS, cases, make, score
from docs.marks import table, write
from tests.helpers.paths import ROOT

PAGE = ROOT / "docs/rivals.md"
MODULE = "benchmarks rivals"
FIRST = 100
"""Seed of the first draw; settings were chosen on seeds 0 and 1."""

SIGNALS = {"torque": "joint torques", "wrench": "plate"}


@dataclass(frozen=True)
class Rival:
    """A tool.

    Attributes:
        name: In the table.
        package: What its interpreter must have.
        script: Module of `benchmarks.rivals`.
        settings: As the script names them; of experts' the best is counted, cell by cell.
        most: Draws, where it is slow.
        robots: Which, where it is slower yet.
        faults: Setting that is asked about faults.
    """

    name: str
    package: str
    script: str
    settings: tuple[str, ...]
    most: int = 10**6
    robots: tuple[str, ...] = tuple(ROBOTS)
    faults: str = ""


EXPERT = "expert, 3 Hz", "expert, 5 Hz", "expert, 10 Hz"
RIVALS = (
    Rival("testbed", "testbed", "testbed", ("default",), faults="both signals"),
    Rival("Cramer-Rao bound", "testbed", "bound", ("bound",)),
    Rival("iDynTree", "idyntree", "idyntree", ("plain", *EXPERT), faults="plain"),
    Rival("FIGAROH", "figaroh", "figaroh", ("plain", *EXPERT), faults="plain"),
    Rival("mujoco.sysid", "mujoco.sysid", "mujoco", ("expert",), 3, faults="expert"),
    Rival("mujoco.sysid", "mujoco.sysid", "mujoco", ("plain",), 3, ("puma",)),
)


def rivals(
    folder: Path, pythons: Mapping[str, str], draws: int, jobs: int, docs: bool
) -> Iterator[str]:
    """Lines of what is done, then of the table.

    Args:
        folder: Of recordings and answers; what is there is not made again.
        pythons: Interpreters by package; default this one, for what it has.
        draws: Of every robot and noise.
        jobs: Processes at a time.
        docs: Whether the table is written into the page.
    """
    start = time.monotonic()
    if not (folder / "truth").exists():
        yield json.dumps(make(folder, list(cases(draws, True)), FIRST, jobs))
    tasks = [(rival, setting) for rival in RIVALS for setting in rival.settings]
    tasks += [(rival, "faults") for rival in RIVALS if rival.faults]
    absent = {
        rival.package for rival, _ in tasks
        if rival.package not in pythons and not find_spec(rival.package)
    }  # fmt: skip
    yield from (f"{package}: not there, left out (--python {package}=...)" for package in absent)
    there = [each for each in tasks if each[0].package not in absent]
    with ThreadPoolExecutor(jobs) as threads:
        yield from threads.map(lambda each: _run(folder, pythons, draws, *each), there)
    found = Findings(folder, there)
    lines = [*found.summary(), *found.cells(), *found.asked()]
    yield "\n".join(lines)
    yield f"{time.monotonic() - start:.0f} s"
    if docs:
        write(PAGE, MODULE, lambda _: "\n".join(["", *lines, "", ""]))


def _answers(folder: Path, rival: Rival, setting: str) -> Path:
    return folder / f"answers-{rival.script}-{re.sub('[^a-z0-9]+', '-', setting)}.json"


def _run(folder: Path, pythons: Mapping[str, str], draws: int, rival: Rival, setting: str) -> str:
    """Let a tool answer, in its own interpreter."""
    out, start = _answers(folder, rival, setting), time.monotonic()
    if out.exists():
        return f"{out.name}: there"
    asked = rival.faults if setting == "faults" else setting
    clean = f"({'|'.join(rival.robots)})-({'|'.join(NOISES)})-"
    only = clean if setting != "faults" else "-(?!coarse|coloured)[a-z]+-00"
    words = (
        pythons.get(rival.package, sys.executable), "-m", f"benchmarks.rivals.{rival.script}",
        str(folder), str(out), "--setting", asked, "--draws", str(min(draws, rival.most)),
        "--only", only,
    )  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        return f"{out.name}: {done.stderr.strip().splitlines()[-1]}"
    return f"{out.name}: {time.monotonic() - start:.0f} s"


def lines_of(script: str) -> int:
    """Lines of a script that a user writes, without comments.

    Args:
        script: Module of `benchmarks.rivals`.
    """
    text = (Path(__file__).parent / f"{script}.py").read_text()
    parts = re.findall(r"# the user's lines\n(.*?)# end\n", text, re.DOTALL)
    code = [line.strip() for part in parts for line in part.splitlines()]
    return sum(bool(line) and not line.startswith(("#", '"""')) for line in code)


class Findings:
    """What all tools have answered."""

    def __init__(self, folder: Path, tasks: Sequence[tuple[Rival, str]]) -> None:
        self.scores: dict[tuple[str, str], dict[str, Any]] = {}
        self.said: dict[str, dict[str, Any]] = {}
        self.versions: dict[str, str] = {}
        self.scripts = {rival.name: rival.script for rival, _ in tasks}
        for rival, setting in tasks:
            file = _answers(folder, rival, setting)
            if not file.exists():
                continue
            held = json.loads(file.read_text())
            self.versions[rival.name] = held["version"]
            scored = score(folder, held["answers"])
            if setting == "faults":
                self.said[rival.name] = scored
            else:
                self.scores[rival.name, setting] = scored
        self.bound = self.scores.pop(("Cramer-Rao bound", "bound"))["error"]
        self.own = self.scores["testbed", "default"]["error"]

    def _over_bound(self, errors: Mapping[str, float], signal: str) -> float:
        """Geometric mean over cells."""
        ratios = [np.log(e / self.bound[signal][cell]) for cell, e in errors.items()]
        return float(np.exp(np.mean(ratios)))

    def best(self, signal: str) -> dict[str, tuple[float, str]]:
        """Least error of an expert's settings of all rivals by cell, and whose."""
        found = {}
        for cell in self.own[signal]:
            every = [
                (scored["error"][signal][cell], f"{name} {setting.removeprefix('expert, ')}")
                for (name, setting), scored in self.scores.items()
                if name != "testbed" and setting.startswith("expert")
                and cell in scored["error"][signal]
            ]  # fmt: skip
            found[cell] = min(every)
        return found

    def summary(self) -> Iterator[str]:
        """A table of tools for each signal, the best one first."""
        for signal, words in SIGNALS.items():
            rows = []
            for (name, setting), scored in self.scores.items():
                errors = scored["error"].get(signal)
                if not errors:
                    continue
                held = scored["coverage"][signal].values()
                over = self._over_bound(errors, signal)
                worst = max(e / self.bound[signal][cell] for cell, e in errors.items())
                faults = self.said.get(name)
                planted = [] if faults is None else [*faults["noticed"], *faults["missed"]]
                rows.append(
                    (
                        over,
                        (
                            f"{name} {self.versions[name]}, {setting}",
                            f"{over:.2f}",
                            f"{worst:.1f}",
                            f"{np.mean(list(held)):.2f}, {min(held):.2f} to {max(held):.2f}"
                            if held else "gives none",
                            f"{scored['cpu'][signal]:.2f}",
                            str(lines_of(self.scripts[name])),
                            f"{len(faults['noticed'])} of {len(planted)}" if faults else "-",
                            "all" if len(errors) == len(self.own[signal]) else str(len(errors)),
                        ),
                    )
                )  # fmt: skip
            head = (
                f"by {words} | error over the bound | worst cell | intervals of 95 % that hold, "
                "mean and cells | CPU s | lines | faults noticed | cells"
            )
            yield from ("", *table(head, [row for _, row in sorted(rows)]))

    def cells(self) -> Iterator[str]:
        """Errors by robot and noise."""
        best = {signal: self.best(signal) for signal in SIGNALS}
        rows = []
        for cell in self.own["torque"]:
            row = [cell]
            for signal in SIGNALS:
                error, who = best[signal][cell]
                numbers = self.bound[signal][cell], self.own[signal][cell], error
                row += [f"{100 * number:.3g}" for number in numbers]
                row[-1] += f" {who}"
            rows.append(row)
        head = "error [%] | torques: bound | testbed | best expert | plate: bound | testbed | best expert"
        yield from ("", *table(head, rows))

    def asked(self) -> Iterator[str]:
        """What issue and page ask for, and what is obtained."""
        rows = []
        for signal, words in SIGNALS.items():
            ratios = np.array(
                [self.own[signal][cell] / error for cell, (error, _) in self.best(signal).items()]
            )
            mean = np.exp(np.log(ratios).mean())
            rows.append((
                f"by {words}, testbed over the best expert: at most 1.05 in each cell, below 1 in the mean",
                f"{mean:.2f}; {(ratios <= 1.05).sum()} of {len(ratios)} cells, worst {ratios.max():.2f}",
            ))  # fmt: skip
        plain = self.scores.get(("FIGAROH", "plain"))
        if plain is not None:
            ratio = [self.own["torque"][c] / e for c, e in plain["error"]["torque"].items()]
            rows.append((
                "torques, testbed over FIGAROH as documented: at most 0.2",
                f"{np.exp(np.log(ratio).mean()):.2f}, {min(ratio):.2f} to {max(ratio):.2f}",
            ))  # fmt: skip
        script = self.scores.get(("iDynTree", "expert, 5 Hz"))
        if script is not None:
            own = self.scores["testbed", "default"]["cpu"]
            rows.append((
                "CPU, testbed over the decimated script: at most 1.5",
                ", ".join(f"{own[s] / script['cpu'][s]:.1f} ({w})" for s, w in SIGNALS.items()),
            ))  # fmt: skip
        yield from ("", *table("asked | obtained", rows))
