"""How often intervals of 95 % hold the truth, under white and coloured noise.

Motions are random ones, inside the robot's limits, or the best of forty; signals are those of
rigid bodies with dry and viscous friction, simulated where the joints' torques are asked for.
Every seed is another motion and other noise.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks import random_recordings
from benchmarks.lines import print_lines
from benchmarks.random_recordings import NOISES, ROBOTS, ROOT, SPEEDS, instrument
from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate, Method
from testbed.core.recordings.recording import Recording
from testbed.lab.instruments.fault import Fault
from testbed.lab.instruments.joints import EncoderResolution

NORMAL = 1.96

LEAST = 0.93
"""Share of all intervals that must hold the truth, but for two standard errors."""

COARSE = (EncoderResolution(count=1e-3),)
"""Encoders that stand still from sample to sample in slow motions."""


@dataclass(frozen=True)
class Study:
    """What is repeated.

    Attributes:
        robot: One of ROBOTS.
        motion: One of SPEEDS, or "chosen": the best of forty.
        noise: One of NOISES: the plate's; joints' torques have white noise always.
        method: Whose sigmas.
        seconds: Duration of every recording.
        settings: Of the identification.
        faults: Of the instrument.
    """

    robot: str
    motion: str
    noise: str
    method: Method
    seconds: float
    settings: tb.Settings
    faults: tuple[Fault, ...] = ()

    @property
    def words(self) -> str:
        """By which it is picked."""
        return " ".join(
            [self.robot, self.motion, self.noise, self.method, *(f.kind for f in self.faults)]
        )


def coverage(study: Study, first: int, runs: int) -> dict[str, Any]:
    """Shares of 95 % intervals that hold the truth, and errors."""
    tree = tb.load_tree(ROBOTS[study.robot])
    scores, errors, taken, alarms, steps = [], [], 0.0, 0, 0
    names: tuple[str, ...] = ()
    for seed in range(first, first + runs):
        recording = recorded(tree, study, seed)
        start = time.process_time()
        estimate = tb.identify(tree, recording, study.method, settings=study.settings)
        taken += time.process_time() - start
        truth = truth_of(tree, estimate)
        scores.append((estimate.values - truth) / estimate.sigma)
        errors.append((estimate.values - truth) / truth)
        names = estimate.names
        alarms += estimate.doubtful
        steps += estimate.noise is not None and estimate.noise.steps_matter
        if sys.stderr.isatty():
            print(f"\r{seed - first + 1} of {runs}", end="", file=sys.stderr)
    inside = np.abs(scores) < NORMAL
    mass = np.array([name.startswith("mbar") for name in names])
    each = inside.mean(axis=0)
    kept = each[~mass]
    bodies = estimate.minimal.count
    bound = 2 * inside[:, ~mass].mean(axis=1).std(ddof=1) / np.sqrt(runs)
    line: dict[str, Any] = {
        "robot": study.robot,
        "motion": study.motion,
        "noise": study.noise,
        "method": study.method,
        "faults": [fault.kind for fault in study.faults],
        "seconds": study.seconds,
        "runs": runs,
        "seeds": f"{first} to {first + runs - 1}",
        "coverage": _share(kept.mean()),
        "bound": _share(bound),
        "held": bool(kept.mean() + bound >= LEAST),
        "worst": _share(kept.min()),
        "worst_parameter": np.array(names)[~mass][kept.argmin()],
        "total_mass": _share(each[mass].mean()) if mass.any() else None,
        "rms_z": _share(float(np.sqrt(np.mean(np.square(scores))))),
        "error_of_nine": float(f"{np.sqrt(np.mean(np.square(errors)[:, :9])):.3g}"),
        "findings": _share(alarms / runs),
        "coarse_encoders": _share(steps / runs),
        "cpu_seconds": round(taken / runs, 2),
    }
    if study.method == "internal":
        line |= {"bodies": _share(each[:bodies].mean()), "friction": _share(each[bodies:].mean())}
    return line


def recorded(tree: tb.Tree, study: Study, seed: int) -> Recording:
    """A recording of a motion of its own; simulated with friction where torques are asked for."""
    if study.method == "external":
        kind = (study.motion, study.noise, study.seconds)
        return random_recordings.recorded(tree, *kind, seed, study.faults)
    settings = [f"seed={seed}", f"motion.duration={study.seconds}"]
    settings += ["motion.candidates=1"] * (study.motion != "chosen")
    speed = SPEEDS.get(study.motion)
    if speed is not None:
        listed = ",".join(f'"{name}"={speed}' for name in tree.names)
        settings.append(f"motion.max_velocity={{{listed}}}")
    experiment = tb.Experiment.from_toml(ROOT / "experiments/table6.toml", settings)
    changed = {"model": str(ROBOTS[study.robot]), "measurement": instrument(study.noise)}
    return tb.record(experiment.model_copy(update=changed)).blind()


def truth_of(tree: tb.Tree, estimate: Estimate) -> Array:
    """The true values of what was estimated."""
    theta, drives = tb.barycentric(tree), estimate.drives
    return estimate.minimal.values(theta) if drives is None else drives.values(theta, tree)


def studies(settings: tb.Settings, seconds: float) -> Iterator[Study]:
    """All that docs/uncertainty.md shows."""
    zeros = replace(settings, zeros=True)
    for motion in SPEEDS:
        for noise in NOISES:
            yield Study("puma", motion, noise, "external", seconds, zeros)
    for noise in ("white", "ar .3 s"):
        yield Study("ur5", "default", noise, "external", seconds, settings)
    for motion in (*SPEEDS, "chosen"):
        yield Study("puma", motion, "white", "internal", seconds, zeros)
    for noise in ("white", "ar .3 s"):
        yield Study("puma", "slow", noise, "external", seconds, zeros, COARSE)
    yield Study("ur5", "slow", "ar .3 s", "external", seconds, settings, COARSE)


def _share(value: float) -> float:
    return round(float(value), 3)


def main(
    runs: Annotated[int, typer.Option(min=2, help="Recordings of each kind.")] = 200,
    first: Annotated[int, typer.Option(help="The first seed.")] = 5000,
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 20.0,
    only: Annotated[str, typer.Option(help="Only studies whose words hold this.")] = "",
) -> None:
    """How often intervals of 95 % hold the truth: docs/uncertainty.md; exit code 1 if too few."""
    asked = (study for study in studies(tb.Settings(), seconds) if only in study.words)
    lines = print_lines(coverage(study, first, runs) for study in asked)
    raise typer.Exit(int(not all(line["held"] for line in lines)))
