"""Mappings that the product writes for foreign files, held against what was planted in these.

`testbed import FILE... --guess --model ROBOT --out MAPPING.toml` is called as a person would.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.foreign_recordings import LAYOUTS, TURNS, planted, raw_signals
from benchmarks.inverse_recordings import ROBOTS, Truth
from benchmarks.judged_mappings import GOALS, Judged, judged, marked
from benchmarks.lines import print_lines
from testbed.core.base.errors import TestbedError
from testbed.importing.check.check import import_and_check
from testbed.importing.mapping import read_mapping
from tests.helpers.command import command_line

SIX = ("ur5", "xarm7", "panda", "kinova", "puma562", "scara")
"""Robots of the study, unless others are asked for."""


def tried(robot: str, kind: str, layout: str, seed: int) -> dict[str, Any]:
    """A case: files written, a mapping asked for as a person would, and judged."""
    made, told = planted(robot, kind, layout, seed)
    line: dict[str, Any] = {"robot": robot, "layout": layout, "turn": kind, "planted": told.what}
    path, held = ROBOTS[robot]
    with TemporaryDirectory() as name:
        folder = Path(name)
        files = LAYOUTS[layout](folder, made, raw_signals(made, told), seed)
        out = folder / "mapping.toml"
        words = ["import", *(each.name for each in files.paths), "--guess", "--model", str(path)]
        words += [word for joint in held for word in ("--lock", joint)]
        begun = time.process_time()
        ended = command_line(*words, "--out", str(out), cwd=folder)
        line["cpu"] = round(time.process_time() - begun, 2)
        if ended.returncode or not out.exists():
            said = (ended.stderr.strip().splitlines() or ["no word"])[-1]
            return line | {"result": "refused", "said": said[:300]}
        try:
            read_mapping(out)
        except TestbedError as error:
            return line | {"result": "incomplete", "said": str(error).replace(name, "")[:300]}
        worth = judged(robot, out.read_text(), files, made, told)
        line |= {"wrong": worth.wrong, "errors": worth.errors, "z": worth.sigmas}
        return line | ({"result": "right"} if not worth.wrong else _excused(worth, made, out))


def _excused(worth: Judged, made: Truth, mapping: Path) -> dict[str, Any]:
    """Who says that a wrong mapping may be wrong: itself, the check, its sigmas or nobody."""
    said = ""
    try:
        import_and_check(mapping, lambda each: (made.tree, each))
    except TestbedError as error:
        said = str(error)[:300]
    if marked(mapping.read_text(), worth.wrong):
        result = "marked"
    elif said:
        result = "wrong refused"
    else:
        result = "as unsure as said" if worth.as_unsure_as_said else "wrong accepted"
    return {"result": result, "said": said}


def study(
    robots: Sequence[str], layouts: Sequence[str], count: int, seed: int
) -> Iterator[dict[str, Any]]:
    """Each case."""
    for robot in robots:
        rng = np.random.default_rng([seed, sum(map(ord, robot))])
        pairs = zip(itertools.cycle(layouts), itertools.cycle(TURNS), strict=False)
        for layout, kind in itertools.islice(pairs, count):
            yield tried(robot, kind, layout, int(rng.integers(1 << 31)))


def total(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """What a study says in all."""
    count = {result: sum(line["result"] == result for line in lines)
             for result in ("right", "marked", "as unsure as said", "incomplete", "refused",
                            "wrong refused", "wrong accepted")}  # fmt: skip
    right = [line for line in lines if line["result"] == "right"]
    found = [line for line in lines if line["result"] in ("right", "as unsure as said")]
    cpu = [line["cpu"] for line in lines]
    return {
        "cases": len(lines), **count,
        "right [%]": round(100 * len(right) / len(lines), 1),
        "rms": {name: _rms([line["errors"][name] for line in found]) for name in GOALS},
        "rms at least": {name: _rms_at_least([line["errors"][name] for line in found])
                         for name in GOALS},
        "rms z": {name: _rms([line["z"][name] for line in found if name in line["z"]])
                  for name in GOALS},
        "cpu median, most [s]": [round(float(f(cpu)), 2) for f in (np.median, np.max)],
    }  # fmt: skip


def _rms(values: Sequence[float]) -> float | None:
    return round(float(np.sqrt(np.mean(np.square(values)))), 4) if len(values) else None


def _rms_at_least(values: Sequence[float]) -> float | None:
    """The rms that few cases leave no doubt of: two standard errors of the mean square less."""
    squares = np.square(values)
    if len(squares) < 2:
        return None
    least = squares.mean() - 2 * squares.std(ddof=1) / np.sqrt(len(squares))
    return round(float(np.sqrt(max(least, 0.0))), 4)


def reached(found: dict[str, Any]) -> bool:
    """Whether a total is good enough; an rms misses its goal beyond two standard errors."""
    rms = [(found["rms at least"][name], goal) for name, goal in GOALS.items()]
    z = list(found["rms z"].values())
    return bool(
        found["right [%]"] >= 95
        and not found["wrong accepted"]
        and not found["incomplete"]
        and all(value is not None and value <= goal for value, goal in rms)
        and all(value is not None and 0.8 <= value <= 1.2 for value in z)
    )


def main(
    robots: Annotated[str, typer.Option(help="Names, with commas.")] = ",".join(SIX),
    layouts: Annotated[str, typer.Option(help="Of files, with commas.")] = ",".join(LAYOUTS),
    count: Annotated[int, typer.Option(min=1, help="Recordings of each robot.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Of robots, motions and what is planted.")] = 43,
) -> None:
    """Mappings by --guess, held against the truth; exit code 1 where the goal is missed."""
    asked, kinds = robots.split(","), layouts.split(",")
    for name, known in [*((each, ROBOTS) for each in asked), *((each, LAYOUTS) for each in kinds)]:
        if name not in known:
            raise typer.BadParameter(f"{name} is none of {', '.join(known)}")
    found = total(print_lines(study(asked, kinds, count, seed)))
    print_lines([found])
    raise typer.Exit(int(not reached(found)))
