"""All tools on the same recordings, each in a process of its own, as one table."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import date
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench import NOISES, ROBOTS, cases, make, score
from docs.marks import table, write
from tests.helpers.paths import ROOT

PAGE = ROOT / "docs/rivals.md"
MODULE = "benchmarks rivals"
GOAL = 1.5
"""Of testbed's error over the bound, mean of cells."""

FIRST = 100
"""Seed of the first draw; settings were chosen on seeds 0 and 1."""

SIGNALS = {"torque": "joint torques", "wrench": "plate"}


@dataclass(frozen=True)
class Rival:
    """A tool.

    Attributes:
        name: In the table.
        package: By which an interpreter that has it is known.
        script: Module of `benchmarks.rivals`.
        settings: As the script names them; of experts' the best is counted, cell by cell.
        most: Draws, where it is slow.
        robots: Which, where it is slower yet.
        faults: Setting that is asked about faults.
        seconds: That a recording takes, about: the slowest begin first.
    """

    name: str
    package: str
    script: str
    settings: tuple[str, ...]
    most: int = 10**6
    robots: tuple[str, ...] = tuple(ROBOTS)
    faults: str = ""
    seconds: float = 0.5


EXPERT = "expert, 3 Hz", "expert, 5 Hz", "expert, 10 Hz"
RIVALS = (
    Rival("testbed", "testbed", "testbed", ("default",), faults="both signals"),
    Rival("Cramer-Rao bound", "testbed", "bound", ("bound",)),
    Rival("iDynTree", "idyntree", "idyntree", ("plain", *EXPERT), faults="plain"),
    Rival("FIGAROH", "figaroh", "figaroh", ("plain", *EXPERT[:2]), faults="plain", seconds=1),
    Rival("mujoco.sysid", "absl", "mujoco", ("expert",), 3, faults="expert", seconds=20),
    Rival("mujoco.sysid", "absl", "mujoco", ("plain",), 3, ("puma",), seconds=70),
)


def rivals(folder: Path, pythons: Mapping[str, str], draws: int, jobs: int, docs: bool) -> float:
    """Print what is done, and the tables.

    Args:
        folder: Of recordings and answers; what is there is not made again.
        pythons: Interpreters by script; default this one, for what it has.
        draws: Of every robot and noise.
        jobs: Processes at a time.
        docs: Whether the tables are written into the page, if all tools are there.

    Returns:
        testbed's error over the bound, by the worse of both signals.
    """
    start = time.monotonic()
    if not (folder / "truth").exists():
        print(json.dumps(make(folder, list(cases(draws, True)), FIRST, jobs)), flush=True)
    tasks = [(rival, setting) for rival in RIVALS for setting in rival.settings]
    tasks += [(rival, "faults") for rival in RIVALS if rival.faults]
    there = [
        (rival, setting) for rival, setting in tasks
        if rival.script in pythons or find_spec(rival.package)
        or _answers(folder, rival, setting).exists()
    ]  # fmt: skip
    for name in dict.fromkeys(rival.script for rival, task in tasks if (rival, task) not in there):
        print(f"{name}: left out, say --python {name}=INTERPRETER")
    with ThreadPoolExecutor(jobs) as threads:
        slowest_first = sorted(there, key=lambda each: -each[0].seconds)
        for line in threads.map(lambda each: _run(folder, pythons, draws, *each), slowest_first):
            print(line, flush=True)
    found = Findings(folder, there, draws)
    lines = list(found.summary())
    if len(found.scores) > 1:  # another tool is there
        lines += found.asked()
    print("\n".join(lines), f"\n{time.monotonic() - start:.0f} s", flush=True)
    absent = [
        _answers(folder, *each).name for each in tasks if not _answers(folder, *each).exists()
    ]
    if docs and absent:
        print(f"{PAGE.name} stays as it is, without {', '.join(absent)}")
    elif docs:
        head = f"{date.today()}, {draws} draws of each robot and noise (of mujoco.sysid fewer)."
        write(PAGE, MODULE, lambda _: "\n".join(["", head, *lines, "", ""]))
    return max(_mean(by.values()) for by in found.own["over"].values())


def _answers(folder: Path, rival: Rival, setting: str) -> Path:
    return folder / f"answers-{rival.script}-{re.sub('[^a-z0-9]+', '-', setting.lower())}.json"


def _run(folder: Path, pythons: Mapping[str, str], draws: int, rival: Rival, setting: str) -> str:
    """Let a tool answer, in its own interpreter."""
    out, start = _answers(folder, rival, setting), time.monotonic()
    if out.exists():
        return f"{out.name}: there"
    asked = rival.faults if setting == "faults" else setting
    clean = f"({'|'.join(rival.robots)})-({'|'.join(NOISES)})-"
    only = clean if setting != "faults" else "-(?!coarse|coloured)[a-z]+-00"
    words = (
        pythons.get(rival.script, sys.executable), "-m", f"benchmarks.rivals.{rival.script}",
        str(folder), str(out), "--setting", asked, "--draws", str(min(draws, rival.most)),
        f"--only={only}",
    )  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        return f"{out.name}: {done.stderr.strip().splitlines()[-1]}"
    cpu = json.loads(out.read_text())["seconds"]
    return f"{out.name}: {time.monotonic() - start:.0f} s, {cpu:.0f} s of a processor"


def lines_of(script: str, setting: str) -> int:
    """Lines of a script that a user writes for a setting, without comments.

    Args:
        script: Module of `benchmarks.rivals`.
        setting: Its first word may stand at a part that no other setting needs.
    """
    text = (Path(__file__).parent / f"{script}.py").read_text()
    parts = re.findall(r"# the user's lines(?:: (\w+))?\n(.*?)# end\n", text, re.DOTALL)
    wanted = [part for word, part in parts if word in ("", setting.partition(",")[0])]
    code = [line.strip() for part in wanted for line in part.splitlines()]
    return sum(bool(line) and not line.startswith(("#", '"""')) for line in code)


class Findings:
    """What all tools have answered."""

    def __init__(self, folder: Path, tasks: Sequence[tuple[Rival, str]], draws: int) -> None:
        self.scores: dict[tuple[str, str], dict[str, Any]] = {}
        self.said: dict[str, dict[str, Any]] = {}
        self.titles: dict[str, str] = {}
        self.lines = {(r.name, setting): lines_of(r.script, setting) for r, setting in tasks}
        answers = {}
        for rival, setting in tasks:
            file = _answers(folder, rival, setting)
            if file.exists():
                held = json.loads(file.read_text())
                self.titles[rival.name] = f"{rival.name} {held['version']}"
                every = held["answers"].items()
                kept = {name: each for name, each in every if int(name[-2:]) < draws}
                answers[rival, setting] = kept
        bound = next(each for (rival, _), each in answers.items() if rival.script == "bound")
        own = answers[RIVALS[0], "default"]
        for (rival, setting), each in answers.items():
            scored = score(folder, each)
            if setting == "faults":
                self.said[rival.name] = scored
            else:
                same = {name: bound[name] for name in each}  # some tools have fewer draws
                least = score(folder, same)["error"]
                scored["over"] = {
                    signal: {cell: e / least[signal][cell] for cell, e in by.items()}
                    for signal, by in scored["error"].items()
                }
                scored["whole"] = len(each) == len(bound)
                if not scored["whole"]:
                    usual = score(folder, {name: own[name] for name in each})["error"]
                    scored["same"] = {
                        signal: _mean(usual[signal][cell] / e for cell, e in by.items())
                        for signal, by in least.items()
                    }
                self.scores[rival.name, setting] = scored
        del self.scores["Cramer-Rao bound", "bound"]
        self.own = self.scores["testbed", "default"]

    def best(self, signal: str) -> dict[str, float]:
        """By cell, least error over the bound of experts' settings with all draws."""
        every = [
            scored["over"][signal]
            for (_, setting), scored in self.scores.items()
            if setting.startswith("expert") and scored["whole"] and scored["over"][signal]
        ]  # by plate nobody if FIGAROH alone is there, which has no way
        cells = self.own["over"][signal]
        return {cell: min((over[cell] for over in every), default=np.nan) for cell in cells}

    def _same(self, scored: Mapping[str, Any], signal: str) -> float:
        """The error of testbed over the bound for the recordings that another tool has answered."""
        whole = _mean(self.own["over"][signal].values())
        return float(scored.get("same", {}).get(signal, whole))

    def _one_setting(self, signal: str) -> float:
        """Least mean over cells of another tool's setting with all draws."""
        others = (scored for (name, _), scored in self.scores.items() if name != "testbed")
        whole = (scored["over"][signal].values() for scored in others if scored["whole"])
        return min((_mean(over) for over in whole if over), default=np.nan)

    def summary(self) -> Iterator[str]:
        """A table of tools for each signal, the best one first."""
        for signal, words in SIGNALS.items():
            rows = []
            for (name, setting), scored in self.scores.items():
                over = scored["over"][signal].values()
                if not over:
                    continue
                held = list(scored["coverage"][signal].values())
                faults = self.said.get(name, {"noticed": (), "missed": ()})
                noticed = len(faults["noticed"])
                planted = noticed + len(faults["missed"])
                cells = (
                    f"{self.titles[name]}, {setting}",
                    f"{_mean(over):.2f}",
                    f"{max(over):.1f}",
                    f"{self._same(scored, signal):.2f}",
                    f"{np.mean(held):.2f} ({min(held):.2f} to {max(held):.2f})" if held else "none",
                    f"{scored['cpu'][signal]:.2f}",
                    str(self.lines[name, setting]),
                    f"{noticed} of {planted}" if planted else "-",
                    str(scored["cases"][signal]),
                )
                rows.append((_mean(over) / self._same(scored, signal), cells))
            head = (
                f"by {words} | error over the bound | worst cell | testbed's on the same | "
                "intervals of 95 % that hold | CPU [s] | lines to write | faults noticed | "
                "recordings"
            )
            yield from ("", *table(head, [cells for _, cells in sorted(rows)]))

    def asked(self) -> Iterator[str]:
        """What is asked of testbed, and what is obtained."""
        rows = []
        for signal, words in SIGNALS.items():
            best, own = self.best(signal), self.own["over"][signal]
            ratio = np.array([own[cell] / over for cell, over in best.items()])
            held = f"{(ratio <= 1.05).sum()} of {len(ratio)} cells, worst {ratio.max():.2f}"
            rows += [
                (f"by {words}, over the best expert, each cell: at most 1.05", held),
                (f"by {words}, over the best expert, mean: below 1", f"{_mean(ratio):.2f}"),
                (f"by {words}, over the best of all settings that are the same in all cells",
                 f"{_mean(own.values()) / self._one_setting(signal):.2f}"),
            ]  # fmt: skip
        plain = self.scores.get(("FIGAROH", "plain"))
        if plain is not None:
            by = plain["over"]["torque"]
            ratio = np.array([self.own["over"]["torque"][cell] / over for cell, over in by.items()])
            words = f"{_mean(ratio):.2f}, {ratio.min():.2f} to {ratio.max():.2f}"
            rows.append(("by torques, over FIGAROH as documented: at most 0.2", words))
            least = 1 / np.array(list(by.values()))
            words = f"{_mean(least):.2f}, at most 0.2 in {(least <= 0.2).sum()} of {len(least)}"
            rows.append(("the Cramer-Rao bound over FIGAROH as documented, cells", words))
        script = self.scores.get(("iDynTree", "expert, 5 Hz"))
        if script is not None:
            ratios = {w: self.own["cpu"][s] / script["cpu"][s] for s, w in SIGNALS.items()}
            words = ", ".join(f"{by} {ratio:.1f}" for by, ratio in ratios.items())
            rows.append(("CPU over the decimated script: at most 1.5", words))
        yield from ("", *table("testbed's error: asked | obtained", rows))


def _mean(ratios: Iterable[float]) -> float:
    """Geometric."""
    return float(np.exp(np.log([*ratios]).mean()))
