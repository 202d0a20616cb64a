"""Motions designed for friction: what they gain over others, and whether sigma is as predicted.

Gears lose a tenth of the load. Each designed motion is simulated once and measured with the noise
of many seeds; scatter and sigmas of what `drives` finds stand beside the prediction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import testbed as tb
from testbed.applications.drives.friction_curves import DriveEstimate, drive_of
from testbed.applications.drives.joint_regression import regressions, torques_beside
from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.recordings.recording import Recording
from testbed.lab.experiment.evaluate import robot_of
from testbed.lab.experiment.excite import Excitation, excite, forecaster, wish_of, write_motion
from testbed.lab.instruments.chain import measured_again
from tests.helpers.paths import GOLDEN, REAL, ROOT


@dataclass(frozen=True)
class Case:
    """A robot, and what is said of it.

    Attributes:
        words: Beside those of the experiment.
        dry: Dry friction of every joint, viscous friction is as large at 1 rad/s; () for the
            model file's.
    """

    words: tuple[str, ...] = ()
    dry: tuple[float, ...] = ()


CASES: Mapping[str, Case] = {
    "puma": Case(),
    "ur5": Case(
        (f'model="{REAL}/ur_description/urdf/ur5_robot.urdf"', "measurement.torque_noise=0.2"),
        (6.0, 6.0, 4.0, 1.0, 1.0, 1.0),
    ),
    "gantry": Case(
        (f'model="{GOLDEN}/robots/gantry_ppp_rrr.urdf"',),
        (10.0, 10.0, 10.0, 1.0, 1.0, 1.0),
    ),
}
"""A plain arm, one with six joints, one whose first three joints slide."""


def drives_of(
    tree: tb.Tree, seen: Recording, bodies: Estimate, settings: tb.Settings
) -> tuple[DriveEstimate, ...]:
    """Constants and terms that are given, without curves and maps.

    Args:
        tree: The robot.
        seen: Its recording.
        bodies: By the plate.
        settings: With the terms.
    """
    problem = Problem.of(tree, seen, "internal", settings, threads=1, knows_load=True)
    torques = torques_beside(problem, bodies)
    return tuple(drive_of(tree, torques, each) for each in regressions(torques, bodies))


def experiment_of(name: str, seconds: float, *words: str) -> tb.Experiment:
    """A robot with friction, whose gears lose a tenth of the load.

    Args:
        name: One of CASES.
        seconds: Duration.
        *words: Further ones.
    """
    case = CASES[name]
    given = [
        'motion.file=""', "expect={}", "measurement.torque_constant_error={}",
        'excitation.clearance="off"', "excitation.starts=3", f"motion.duration={seconds}",
        *case.words, *words,
    ]  # fmt: skip
    base = ROOT / "experiments/load_friction.toml"
    if case.dry:
        names = robot_of(tb.Experiment.load(base, given)).names
        joints = ",".join(
            f"{joint}={{coulomb={dry},viscous={dry}}}"
            for joint, dry in zip(names, case.dry, strict=True)
        )
        given.append(f"robot.joint={{{joints}}}")
    return tb.Experiment.load(base, given)


def designs(name: str, seconds: float, seed: int) -> tuple[Excitation, dict[str, Array]]:
    """A motion for friction, and what it and others promise: sigma of every coefficient.

    Args:
        name: One of CASES.
        seconds: Duration.
        seed: Of the searches.
    """
    experiment = experiment_of(name, seconds, "excitation.aim=friction", f"seed={seed}")
    found = excite(experiment)
    bodies = excite(experiment_of(name, seconds, f"seed={seed}")).design.motion
    forecast = forecaster(experiment, wish_of(experiment, found.tree))
    assert found.random is not None
    motions = {"friction": found.design.motion, "bodies": bodies, "random": found.random}
    return found, {kind: forecast(motion).sigma for kind, motion in motions.items()}


def trials(found: Excitation, first: int, seeds: int, seconds: float) -> Iterator[Array]:
    """What drives find of a simulated motion: values and sigmas as the prediction has them, (2, N).

    Args:
        found: The motion.
        first: The first seed.
        seeds: How many.
        seconds: Duration.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / "motion.toml"
        write_motion(file, found)
        table = found.experiment.motion.model_copy(update={"file": str(file)})
        asked = found.experiment.model_copy(update={"motion": table})
        recording = tb.simulate(asked)
    settings = tb.Settings(zeros=True, terms=("coulomb", "viscous", "load"))
    for seed in range(first, first + seeds):
        seen = measured_again(recording, asked.measurement, seed)
        bodies = tb.identify(found.tree, seen, settings=settings, threads=1)
        drives = drives_of(found.tree, seen, bodies, settings)
        values = [[e.constant, *(t.value for t in e.terms)] for e in drives]
        sigmas = [[e.sigma, *(t.sigma for t in e.terms)] for e in drives]
        yield np.array([np.ravel(values, order="F"), np.ravel(sigmas, order="F")])


def line(name: str, first: int, seeds: int, seconds: float) -> dict[str, Any]:
    """One robot: gains of its designed motion, scatter over prediction.

    Args:
        name: One of CASES.
        first: The first seed.
        seeds: How many.
        seconds: Duration.
    """
    found, promised = designs(name, seconds, first)
    ours = promised["friction"]
    loads = np.array([label.startswith("load/") for label in found.predicted.names])
    drawn = np.array(list(trials(found, first, seeds, seconds)))
    scatter = drawn[:, 0].std(axis=0, ddof=1) / ours
    said = np.sqrt(np.mean(drawn[:, 1] ** 2, axis=0)) / ours
    kinds = np.array([label.partition("/")[0] for label in found.predicted.names])

    def mean(ratio: Array) -> float:
        return round(float(np.exp(np.mean(np.log(ratio)))), 3)

    def by_kind(ratio: Array) -> dict[str, float]:
        return {kind: mean(ratio[kinds == kind]) for kind in dict.fromkeys(kinds.tolist())}

    others = {kind: sigma / ours for kind, sigma in promised.items() if kind != "friction"}
    return {
        "robot": name,
        "seconds": seconds,
        "seeds": f"{first} to {first + seeds - 1}",
        "gain": {kind: mean(ratio) for kind, ratio in others.items()},
        "gain_load": {kind: np.round(r[loads], 2).tolist() for kind, r in others.items()},
        "load_sigma": [float(f"{s:.2g}") for s in ours[loads]],
        "scatter_over_predicted": by_kind(scatter),
        "scatter_rms": round(float(np.sqrt(np.mean(scatter**2))), 3),
        "scatter_range": [round(float(m), 2) for m in (scatter.min(), scatter.max())],
        "own_over_predicted": by_kind(said),
        "own_range": [round(float(m), 2) for m in (said.min(), said.max())],
    }


def study(first: int, seeds: int, seconds: float, only: str) -> Iterator[dict[str, Any]]:
    """Lines of the robots.

    Args:
        first: The first seed.
        seeds: How many.
        seconds: Duration of the recordings.
        only: Only robots whose names hold this.
    """
    for name in CASES:
        if only in name:
            yield line(name, first, seeds, seconds)
