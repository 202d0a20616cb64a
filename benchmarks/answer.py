"""The default answer, all checks and sigmas, beside what people write themselves.

A script on Pinocchio makes rows of every sample, filters and decimates them, as users of its
regressors do; one on iDynTree makes rows of every tenth sample of filtered signals. Both then call
lstsq: no sigma, no checks. They read the same recordings, in the same process, in turns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import idyntree.bindings as idt
import numpy as np
import pinocchio as pin
import typer
from scipy import signal

import testbed as tb
from benchmarks.lines import print_lines
from benchmarks.random_recordings import recorded
from benchmarks.rivals.idyntree import regressor
from benchmarks.timing import least
from testbed.core.base.arrays import Array
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.recording import Recording
from tests.helpers.paths import GOLDEN, ROOT

ROBOTS = {"puma": ROOT / "models/puma562.urdf", "ur5": GOLDEN / "robots/ur5.urdf"}
SECONDS = (20, 200)
EVERY = 10
"""Samples from one row to the next."""
CUTOFF = 5.0
"""Of the scripts' filters [Hz]."""


def _filtered(signals: Array, rate: float) -> Array:
    b, a = signal.butter(4, CUTOFF, fs=rate)
    return np.asarray(signal.filtfilt(b, a, signals, axis=0))


def _motion(recording: Recording) -> tuple[Array, Array, Array]:
    q = _filtered(recording.position, recording.rate)
    qd = np.gradient(q, 1 / recording.rate, axis=0)
    return q, qd, np.gradient(qd, 1 / recording.rate, axis=0)


def _measured(recording: Recording, method: Signal) -> Array:
    return recording.measured("wrench" if method == "wrench" else "torque")


def pinocchio_script(file: Path, recording: Recording, method: Signal) -> Array:
    """Rows of every sample, filtered and decimated."""
    root = (pin.JointModelFreeFlyer(),) if method == "wrench" else ()
    robot = pin.buildModelFromUrdf(str(file), *root)
    data, still, made = robot.createData(), np.zeros(6 if root else 0), []
    at = np.array([0, 0, 0, 0, 0, 0, 1.0] if root else [])
    rows = slice(6) if root else slice(None)
    for q, qd, qdd in zip(*_motion(recording), strict=True):
        states = (np.concatenate(each) for each in ((at, q), (still, qd), (still, qdd)))
        made.append(pin.computeJointTorqueRegressor(robot, data, *states)[rows].copy())
    columns = signal.decimate(np.array(made), EVERY, axis=0)
    wanted = _filtered(_measured(recording, method), recording.rate)[::EVERY]
    return _least_squares(columns, wanted)


def idyntree_script(file: Path, recording: Recording, method: Signal) -> Array:
    """Rows of every tenth sample of filtered signals."""
    loader, dynamics = idt.ModelLoader(), idt.KinDynComputations()
    loader.loadReducedModelFromFile(str(file), list(recording.names))
    dynamics.loadRobotModel(loader.model())
    dynamics.setFrameVelocityRepresentation(idt.BODY_FIXED_REPRESENTATION)
    q, qd, qdd = (each[::EVERY] for each in _motion(recording))
    made = regressor(dynamics, q, qd, qdd, "wrench" if method == "wrench" else "torque")
    wanted = _filtered(_measured(recording, method), recording.rate)[::EVERY]
    return _least_squares(made, wanted)


def _least_squares(rows: Array, wanted: Array) -> Array:
    found, *_ = np.linalg.lstsq(rows.reshape(-1, rows.shape[2]), wanted.ravel(), rcond=1e-8)
    return np.asarray(found)


def answers(rounds: int) -> Iterator[dict[str, Any]]:
    """Times by robot, length and method [us a sample], and their ratios."""
    for name, file in ROBOTS.items():
        tree = tb.load_tree(file)
        for seconds in SECONDS:
            recording = recorded(tree, "default", "white", seconds, 0)
            for method in SIGNALS:
                yield _compared(name, file, tree, recording, method, rounds)


def _compared(
    name: str, file: Path, tree: tb.Tree, recording: Recording, method: Signal, rounds: int
) -> dict[str, Any]:
    tasks: dict[str, Callable[[], object]] = {
        "testbed": partial(tb.identify, tree, recording, method, threads=1),
        "idyntree": partial(idyntree_script, file, recording, method),
        "pinocchio": partial(pinocchio_script, file, recording, method),
    }
    tasks["testbed"]()  # the compiled kernel is loaded
    best = least(tasks, rounds)
    return {
        "benchmark": "answer",
        "robot": name,
        "method": method,
        "samples": recording.samples,
        "us_a_sample": {task: round(t / recording.samples * 1e6, 2) for task, t in best.items()},
        "over_pinocchio": round(best["pinocchio"] / best["testbed"], 1),
        "over_idyntree": round(best["idyntree"] / best["testbed"], 2),
    }


def main(rounds: Annotated[int, typer.Option(help="Turns that each rival has.")] = 2) -> None:
    """The default answer beside scripts on Pinocchio and iDynTree (extra `rivals`)."""
    print_lines(answers(rounds))
