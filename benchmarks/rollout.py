"""An unseen motion by the model files that testbed and mujoco.sysid write, driven open-loop."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Iterator, Mapping
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.bench import FAST, RATE, Case, Happened, make, measured, simulated
from benchmarks.rivals.case import read
from benchmarks.rivals.compare import FIRST, PAGE
from docs.marks import table, write
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.recording import Recording
from testbed.lab.simulation.replay import replay_errors
from testbed.motion.limits import joint_limits
from tests.helpers.paths import ROOT

MODULE, ROBOT = "benchmarks rollout", "puma"
UNSEEN = 4.0
"""Of the unseen motion [s]; two of them are driven."""

METHODS: Mapping[str, tuple[Signal, ...]] = {
    "torque": ("torque",),
    "wrench": ("torque", "wrench"),
}
"""testbed's, by the signal that mujoco.sysid has beside torques and positions."""

WORDS = {"torque": "joint torques", "wrench": "joint torques and plate"}


def rollouts(python: str, draws: int, docs: bool) -> str:
    """A table of the errors of 2 s of an unseen motion, and of processor time."""
    cases = [Case(ROBOT, "white", 2 * k) for k in range(draws)]  # the even ones are simulated
    with TemporaryDirectory() as place:
        folder = Path(place) / "set"
        make(folder, cases, FIRST, jobs=1)
        answers = _sysid(python, folder, 2 * draws)
        each = [dict(_driven(folder, case, answers[case.name])) for case in cases]
    errors, cpu = (
        {name: np.array([found[name][k] for found in each]) for name in each[0]} for k in (0, 1)
    )
    rows = [
        (name, " ".join(f"{x:.3f}" for x in own), f"{cpu[name].mean():.2f}" if cpu[name][0] else "")
        for name, own in errors.items()
    ]
    lines = table("file | rms error of each draw [rad] | CPU [s]", rows)
    asked = []
    for words in WORDS.values():
        ours, theirs = f"testbed, {words}", f"mujoco.sysid, {words}"
        ratio = errors[ours] / errors[theirs]
        asked += [
            (f"error, {words}: at most 0.5 of mujoco.sysid's",
             f"{np.exp(np.log(ratio).mean()):.2f}, {ratio.min():.2f} to {ratio.max():.2f}"),
            (f"CPU, {words}: at most 1/50", f"1/{(cpu[theirs] / cpu[ours]).mean():.0f}"),
        ]  # fmt: skip
    lines += ["", *table("asked | obtained", asked)]
    if docs:
        head = f"{date.today()}, seeds {FIRST} to {FIRST + 2 * draws - 2}, every other one."
        write(PAGE, MODULE, lambda _: "\n".join(["", head, "", *lines, "", ""]))
    return "\n".join(lines)


def _driven(
    folder: Path, case: Case, answer: Mapping[str, Any]
) -> Iterator[tuple[str, tuple[float, float]]]:
    """By file, its error [rad] and the processor time that it took [s]."""
    seed = FIRST + case.draw
    real = folder / f"truth/{ROBOT}-{seed:02d}.urdf"
    motion = _unseen(case, real, seed)
    yield "the file handed out", (_error(folder / f"recordings/{case.name}/robot.urdf", motion), 0)
    yield "the real robot's", (_error(real, motion), 0.0)
    for signal, methods in METHODS.items():
        theirs, ours = folder / "theirs.xml", folder / "ours.urdf"
        theirs.write_text(answer[f"{signal}_model"])
        spent = _write(case, folder, methods, ours)
        words = WORDS[signal]
        yield f"mujoco.sysid, {words}", (_error(theirs, motion), answer["cpu"][signal])
        yield f"testbed, {words}", (_error(ours, motion), spent)


def _unseen(case: Case, real: Path, seed: int) -> Recording:
    """Another motion of the real robot, with the noise of the case."""
    tree, rng = tb.load_tree(real), np.random.default_rng([seed, 11])
    limits = joint_limits(tree, {joint.name: FAST[joint.kind] for joint in tree.joints})
    made = simulated(real, tb.random_motion(tree, limits, 0.1, 5, rng), UNSEEN)
    t = np.arange(len(made.position)) / RATE
    happened = Happened("", tree, t, made.position, made.torque, made.wrench, t, (t, t))
    return measured(case, happened, seed + 1000)


def _sysid(python: str, folder: Path, draws: int) -> dict[str, Any]:
    """As its documentation goes, in its own interpreter."""
    out = folder / "answers.json"
    words = (python, "-m", "benchmarks.rivals.mujoco", str(folder), str(out), "--setting", "plain")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(
        (*words, "--draws", str(draws)), cwd=ROOT, env=environment, check=True, capture_output=True
    )
    return dict(json.loads(out.read_text())["answers"])


def _write(case: Case, folder: Path, methods: tuple[Signal, ...], out: Path) -> float:
    """The file by testbed's defaults, as `identify --write` makes it; processor time [s]."""
    given = read(folder / f"recordings/{case.name}")
    start = time.process_time()
    file = tb.ModelFile(given.urdf)
    tree = file.tree()
    recording = Recording(given.joints, given.t, given.q, given.torque, given.wrench)
    estimates = [tb.identify(tree, recording, method, threads=1) for method in methods]
    found = tb.consistent(tree, estimates, tb.prior_of(tree))
    tb.write_model(tb.robot_of(found, tree), out)
    return time.process_time() - start


def _error(model: Path, motion: Recording) -> float:
    """Rms over joints and time [rad]."""
    return float(np.sqrt((replay_errors(tb.ModelFile(model), motion) ** 2).mean()))


def main(
    python: Annotated[str, typer.Option(help="Interpreter that has mujoco.sysid.")],
    draws: Annotated[int, typer.Option(min=1, help="Of bodies, motions and noise.")] = 5,
    docs: Annotated[bool, typer.Option("--docs", help="Write docs/rivals.md.")] = False,
) -> None:
    """An unseen motion by written model files, beside mujoco.sysid as its documentation goes."""
    print(rollouts(python, draws, docs))
