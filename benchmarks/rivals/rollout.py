"""An unseen motion by the model files that testbed and mujoco.sysid write, driven open-loop."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import testbed as tb
from benchmarks.bench import FAST, Case, Happened, make, measured, simulated
from benchmarks.rivals.case import read
from benchmarks.rivals.compare import FIRST
from testbed.excitation.limits import limits_of
from testbed.identification.estimate import Method
from testbed.recordings.recording import Recording
from testbed.simulation.replay import replay
from tests.helpers.paths import ROOT

ROBOT = "puma"
UNSEEN = 4.0
"""Of the unseen motion [s]; two of them are driven."""

METHODS: Mapping[str, tuple[Method, ...]] = {
    "torque": ("internal",),
    "wrench": ("internal", "external"),
}
"""testbed's, by the signal that mujoco.sysid has beside torques and positions."""


def rollouts(python: str, draws: int) -> dict[str, Any]:
    """Errors of 2 s of an unseen motion, and CPU times, by signal and tool.

    Args:
        python: Interpreter that has mujoco.sysid.
        draws: Of bodies, motions and noise, all of them simulated with MuJoCo's own dry friction.
    """
    cases = [Case(ROBOT, "white", 2 * k) for k in range(draws)]  # the even ones are simulated
    rows: dict[str, list[Any]] = {}
    with TemporaryDirectory() as place:
        folder = Path(place) / "set"
        make(folder, cases, FIRST, jobs=1)
        answers = _sysid(python, folder, 2 * draws)
        for case in cases:
            seed, answer = FIRST + case.draw, answers[case.name]
            given = folder / f"recordings/{case.name}/robot.urdf"
            real = folder / f"truth/{ROBOT}-{seed:02d}.urdf"
            motion = _unseen(case, real, seed)
            rows.setdefault("model file", []).append((_error(given, motion), 0.0))
            rows.setdefault("real robot", []).append((_error(real, motion), 0.0))
            for signal, methods in METHODS.items():
                theirs, ours = folder / "theirs.xml", folder / "ours.urdf"
                theirs.write_text(answer[f"{signal}_model"])
                spent = _write(case, folder, methods, ours)
                for name, file, cpu in (
                    (f"mujoco.sysid, {signal}", theirs, answer["cpu"][signal]),
                    (f"testbed, {signal}", ours, spent),
                ):
                    rows.setdefault(name, []).append((_error(file, motion), cpu))
    return {
        name: {
            "rms error [rad]": [float(f"{x:.3g}") for x in np.array([e for e, _ in each])],
            "cpu [s]": [round(cpu, 2) for _, cpu in each],
        }
        for name, each in rows.items()
    }


def _unseen(case: Case, real: Path, seed: int) -> Recording:
    """Another motion of the real robot, with the noise of the case."""
    tree, rng = tb.load_tree(real), np.random.default_rng([seed, 11])
    limits = limits_of(tree, {joint.name: FAST[joint.kind] for joint in tree.joints})
    made = simulated(real, tb.random_motion(tree, limits, 0.1, 5, rng), UNSEEN)
    t = np.arange(len(made.position)) / 500.0
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


def _write(case: Case, folder: Path, methods: tuple[Method, ...], out: Path) -> float:
    """Testbed's file by its defaults, as `identify --write` makes it; processor time [s]."""
    given = read(folder / f"recordings/{case.name}")
    start = time.process_time()
    file = tb.ModelFile(given.urdf)
    tree = file.tree()
    recording = Recording(given.joints, given.t, given.q, given.torque, given.wrench)
    estimates = [tb.identify(tree, recording, method, threads=1) for method in methods]
    found = tb.consistent(tree, estimates, tb.prior_of(tree))
    tb.write_model(file, tb.robot_of(found, tree), out)
    return time.process_time() - start


def _error(model: Path, motion: Recording) -> float:
    """Rms over joints and time [rad]."""
    return float(np.sqrt((replay(tb.ModelFile(model), motion) ** 2).mean()))
