"""Friction under load by the plate: coefficients, intervals, false terms, unseen motions.

What happens is simulated once for each robot and loss; every seed measures it with other noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

import testbed as tb
from testbed.applications.drives.friction_curves import (
    Choice,
    DriveEstimate,
    chosen_terms,
    drive_of,
    offered,
    picked_terms,
)
from testbed.applications.drives.joint_regression import regressions, torques_beside
from testbed.core.base.arrays import Array
from testbed.core.estimation.problem import Problem
from testbed.core.recordings.recording import Recording
from testbed.core.robot.friction import COULOMB, LOADED, ROTOR, VISCOUS, JointLaw, stribeck
from testbed.lab.experiment.experiment_robot import robot_of
from testbed.lab.instruments.chain import measured_again
from testbed.lab.instruments.joints import TorqueNoise
from tests.helpers.paths import REAL, ROOT

LOSSES = (0.0, 0.05, 0.1, 0.2)
"""Parts of the load that gears lose."""

STATIC, FADES = 1.3, 0.3
"""Dry friction at rest over that in motion, and the speed at which it fades out [rad/s]."""

GIVEN: tuple[JointLaw, ...] = (COULOMB, VISCOUS, stribeck(FADES), LOADED[0])
"""The terms of the plant."""

OFF = 0.05
"""Of torque constants, up and down in turns."""

NOISE = 0.005
"""Of torques, as a part of the joint's greatest effort, as data sheets of current sensors have it:
0.5 N m at a PUMA's waist."""

CLEAR = 0.03, 1e-3
"""Asked of a load coefficient (relative) and of a constant."""

SECONDS = 20.0
"""Of an unseen motion."""


@dataclass(frozen=True)
class Case:
    """A robot, and what is said of it.

    Attributes:
        words: Beside those of experiments/torque_constants.toml.
        dry: Dry friction of every joint, viscous friction is as large at 1 rad/s; () for the
            model file's.
    """

    words: tuple[str, ...] = ()
    dry: tuple[float, ...] = ()


_PLAIN = ('motion.file=""', "motion.candidates=20", 'excitation.clearance="off"')
CASES: Mapping[str, Case] = {
    "puma": Case(),
    "ur5": Case(
        (f'model="{REAL}/ur_description/urdf/ur5_robot.urdf"', *_PLAIN),
        (6.0, 6.0, 4.0, 1.0, 1.0, 1.0),
    ),
    "panda": Case(
        (
            f'model="{REAL}/panda_description/urdf/panda.urdf"',
            "robot.lock={panda_finger_joint1=0.02}",
            *_PLAIN,
        ),
        (4.0, 4.0, 3.0, 3.0, 1.0, 1.0, 1.0),
    ),
}


def experiment_of(name: str, loss: float, seconds: float, *more: str) -> tb.Experiment:
    """A robot with gears that lose a part of the load.

    Args:
        name: One of CASES.
        loss: The part.
        seconds: Duration.
        *more: Further words.
    """
    case = CASES[name]
    gear = f"{{kind='load_friction',share={loss},static={STATIC},speed={FADES}}}"
    words = [
        f"motion.duration={seconds}", "simulation.step=5e-4", "expect={}",
        "identification.cutoff=10", "measurement.torque_constant_error={}",
        f"simulation.effect=[{gear}]", *case.words, *more,
    ]  # fmt: skip
    asked = tb.Experiment.load(ROOT / "experiments/torque_constants.toml", words)
    if case.dry:
        joints = ",".join(
            f"{joint}={{coulomb={dry},viscous={dry}}}"
            for joint, dry in zip(robot_of(asked).names, case.dry, strict=True)
        )
        words.append(f"robot.joint={{{joints}}}")
    return tb.Experiment.load(ROOT / "experiments/torque_constants.toml", words)


@lru_cache(maxsize=2)
def happened(name: str, loss: float, seconds: float) -> tuple[tb.Experiment, Recording, Recording]:
    """What is true of a robot's motion, and of another one."""
    asked = experiment_of(name, loss, seconds)
    unseen = experiment_of(name, loss, SECONDS, 'motion.file=""', "motion.candidates=1", "seed=7")
    return asked, tb.record(asked), tb.record(unseen)


def trial(name: str, loss: float, seconds: float, seed: int) -> dict[str, Any]:
    """One recording, identified with its terms given, and with terms chosen.

    Args:
        name: One of CASES.
        loss: What gears lose.
        seconds: Duration.
        seed: Of the noise.
    """
    asked, recording, unseen = happened(name, loss, seconds)
    assert recording.truth is not None
    tree = robot_of(asked)
    constants: Array = 1 + OFF * np.resize([1.0, -1.0], tree.n)
    noise = NOISE * np.array([joint.max_effort for joint in tree.joints])
    instrument = replace(
        asked.measurement,
        torque_noise=0.0,
        torque_constant_error=dict(zip(tree.names, (constants - 1).tolist(), strict=True)),
        fault=(TorqueNoise(sigma=tuple(noise.tolist())),),
    )
    seen = measured_again(recording, instrument, seed)
    plain = replace(asked.identification, terms=("coulomb", "viscous"))
    bodies = tb.identify(tree, seen, settings=plain, threads=1)
    problem = Problem.of(tree, seen, "internal", plain, threads=1, knows_load=True)
    torques = torques_beside(problem, bodies, offered(plain.laws, seen.signals))

    def drives_of(choices: Mapping[int, Choice]) -> list[DriveEstimate]:
        found = regressions(torques, bodies, picked_terms(torques, choices))
        return [drive_of(tree, torques, each) for each in found]

    given, simple = (
        drives_of(dict.fromkeys(torques.joints, Choice(laws, (), None)))
        for laws in (GIVEN, GIVEN[:2])
    )
    chosen = drives_of(chosen_terms(tree, torques, bodies))
    truth = [
        np.array([k, dry, wet, (STATIC - 1) * dry, loss])
        for k, dry, wet in zip(
            constants, COULOMB.coefficients(tree), VISCOUS.coefficients(tree), strict=True
        )
    ]
    found = [np.array([e.constant, *(t.value for t in e.terms)]) for e in given]
    sigma = [np.array([e.sigma, *(t.sigma for t in e.terms)]) for e in given]
    left = [unseen_residual(tree, unseen, constants, each) for each in (chosen, simple)]
    return {
        "truth": np.array(truth),
        "found": np.array(found),
        "sigma": np.array(sigma),
        "chosen": [[t.law.kind for t in e.terms] for e in chosen],
        "unseen": left[0] / left[1],
    }


def unseen_residual(
    tree: tb.Tree, unseen: Recording, constants: Array, drives: Sequence[DriveEstimate]
) -> Array:
    """Rms of what drives report and their terms do not predict, while joints move, (n,)."""
    truth = unseen.truth
    assert truth is not None
    load = truth.torque - truth.friction - ROTOR.coefficients(tree) * truth.acceleration
    left = []
    for j, drive in enumerate(drives):
        moving = np.abs(truth.velocity[:, j]) > 0.02
        friction = drive.friction(truth.velocity[:, j], load[:, j])
        off = constants[j] * truth.torque[:, j] - drive.constant * (load[:, j] + friction)
        left.append(np.sqrt(np.mean(off[moving] ** 2)))
    return np.array(left)


def line(name: str, loss: float, seconds: float, first: int, seeds: int) -> dict[str, Any]:
    """What all seeds show of one robot and loss.

    Args:
        name: One of CASES.
        loss: What gears lose.
        seconds: Duration.
        first: The first seed.
        seeds: How many.
    """
    runs = [trial(name, loss, seconds, seed) for seed in range(first, first + seeds)]
    truth, found, sigma = (np.array([r[k] for r in runs]) for k in ("truth", "found", "sigma"))
    z = (found - truth) / sigma
    clear = (sigma[..., 0].mean(axis=0) < CLEAR[1] / 3) & (
        sigma[..., 4].mean(axis=0) < CLEAR[0] * max(loss, min(LOSSES[1:])) / 3
    )  # joints whose torques show what is asked by three sigmas
    false = [any(set(kinds) & {law.kind for law in LOADED} for kinds in r["chosen"]) for r in runs]
    unseen = np.array([r["unseen"] for r in runs])
    inside = np.abs(z) < 1.96
    return {
        "robot": name,
        "loss": loss,
        "seconds": seconds,
        "seeds": f"{first} to {first + seeds - 1}",
        "joints": int(truth.shape[1]),
        "clear_joints": int(clear.sum()),
        "load_error": _rounded(np.abs(found - truth)[:, clear, 4].max(initial=0) / (loss or 1)),
        "constant_error": _rounded(
            np.abs(found[..., 0] / truth[..., 0] - 1)[:, clear].max(initial=0)
        ),
        "coverage": _rounded(np.mean(inside)),
        "coverage_by_term": dict(
            zip(
                ("constant", *(law.kind for law in GIVEN)),
                [_rounded(share) for share in inside.mean(axis=(0, 1))],
                strict=True,
            )
        ),
        "any_load_term": _rounded(np.mean(false)),
        "unseen_ratio_clear": _rounded(unseen[:, clear].max(initial=0.0)),
    }


def _rounded(value: Any) -> float:
    return float(f"{value:.3g}")


def study(seeds: int, first: int, seconds: float, only: str, jobs: int) -> Iterator[dict[str, Any]]:
    """Lines of every robot and loss.

    Args:
        seeds: How many.
        first: The first one.
        seconds: Duration of the recordings.
        only: Only lines whose words hold this.
        jobs: Processes.
    """
    asked = [(name, loss) for name in CASES for loss in LOSSES if only in f"{name} {loss}"]
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [pool.submit(line, *each, seconds, first, seeds) for each in asked]
        for each in waiting:
            yield each.result()
