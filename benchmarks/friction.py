"""Friction under load by the plate, on a PUMA: errors, intervals, false terms.

What happens is simulated once for each loss; every seed measures it with other noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.lines import print_lines
from testbed.applications.drives.friction_curves import (
    DriveEstimate,
    JointTermChoice,
    chosen_terms,
    drive_estimate,
    offered,
    term_selection_matrices,
)
from testbed.applications.drives.joint_regression import (
    fit_joint_regressions,
    torque_regression_data,
)
from testbed.core.base.arrays import Array
from testbed.core.estimation.problem import Problem
from testbed.core.recordings.recording import Recording
from testbed.core.robot.friction import COULOMB, LOAD_LAWS, VISCOUS, stribeck_law
from testbed.core.robot.joint_law import JointLaw
from testbed.lab.experiment.rig import robot_of
from testbed.lab.instruments.chain import remeasured
from tests.helpers.paths import ROOT

LOSSES = (0.0, 0.05, 0.1, 0.2)
"""Parts of the load that gears lose."""

STATIC, FADES = 1.3, 0.3
"""Dry friction at rest over that in motion, and the speed at which it fades out [rad/s]."""

GIVEN: tuple[JointLaw, ...] = (COULOMB, VISCOUS, stribeck_law(FADES), LOAD_LAWS[0])
"""The terms of the plant."""

OFF, NOISE = 0.05, 0.005
"""Of torque constants, up and down in turns; of torques, in parts of the greatest effort."""


@lru_cache(maxsize=1)
def happened(loss: float, seconds: float) -> tuple[tb.Experiment, Recording]:
    """What is true of a motion with gears that lose a part of the load."""
    gear = f"{{kind='load_friction',share={loss},static={STATIC},speed={FADES}}}"
    words = [
        "simulation.step=5e-4", "expect={}", "identification.cutoff=10",
        "measurement.torque_constant_error={}", f"simulation.effect=[{gear}]",
        f"motion.duration={seconds}",
    ]  # fmt: skip
    asked = tb.Experiment.from_toml(ROOT / "experiments/torque_constants.toml", words)
    return asked, tb.record(asked)


def trial(loss: float, seconds: float, seed: int) -> dict[str, Any]:
    """Errors of one recording with its terms given, over sigmas, and with terms chosen."""
    asked, recording = happened(loss, seconds)
    tree = robot_of(asked)
    constants: Array = 1 + OFF * np.resize([1.0, -1.0], tree.n)
    noise = NOISE * np.array([joint.max_effort for joint in tree.joints])
    instrument = replace(
        asked.measurement,
        torque_noise=0.0,
        torque_constant_error=dict(zip(tree.names, (constants - 1).tolist(), strict=True)),
        fault=(tb.TorqueNoise(sigma=tuple(noise.tolist())),),
    )
    seen = remeasured(recording, instrument, seed)
    plain = replace(asked.identification, terms=("coulomb", "viscous"))
    bodies = tb.identify(tree, seen, settings=plain, threads=1)
    problem = Problem.from_recording(tree, seen, "torque", plain, threads=1, knows_load=True)
    torques = torque_regression_data(problem, bodies, offered(plain.laws, seen.signals))

    def drives_of(choices: Mapping[int, JointTermChoice]) -> list[DriveEstimate]:
        found = fit_joint_regressions(torques, bodies, term_selection_matrices(torques, choices))
        return [drive_estimate(tree, torques, each) for each in found]

    given = drives_of(dict.fromkeys(torques.joints, JointTermChoice(GIVEN, (), None)))
    chosen = drives_of(chosen_terms(tree, torques, bodies))
    dry = COULOMB.coefficients(tree)
    rows = [constants, dry, VISCOUS.coefficients(tree), (STATIC - 1) * dry, np.full(tree.n, loss)]
    found = [[each.constant, *(term.value for term in each.terms)] for each in given]
    sigma = [[each.sigma, *(term.sigma for term in each.terms)] for each in given]
    return {
        "error": np.array(found) - np.array(rows).T,
        "sigma": np.array(sigma),
        "load": any(term.law in LOAD_LAWS for each in chosen for term in each.terms),
    }


def line(loss: float, seconds: float, first: int, seeds: int) -> dict[str, Any]:
    """What all seeds show of one loss."""
    runs = [trial(loss, seconds, seed) for seed in range(first, first + seeds)]
    error, sigma = (np.array([run[key] for run in runs]) for key in ("error", "sigma"))
    inside = np.abs(error) < 1.96 * sigma
    kinds = ("constant", *(law.kind for law in GIVEN))
    return {
        "loss": loss,
        "load_error": _rounded(np.abs(error[..., 4]).max() / (loss or 1)),
        "constant_error": _rounded(np.abs(error[..., 0]).max()),
        "coverage": _rounded(inside.mean()),
        "coverage_by_term": dict(zip(kinds, map(_rounded, inside.mean(axis=(0, 1))), strict=True)),
        "any_load_term": _rounded(np.mean([run["load"] for run in runs])),
    }


def _rounded(value: Any) -> float:
    return float(f"{value:.3g}")


def main(
    seeds: Annotated[int, typer.Option(min=2, help="Recordings of each loss.")] = 20,
    first: Annotated[int, typer.Option(help="The first seed.")] = 100,
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 60.0,
    jobs: Annotated[int, typer.Option(help="Processes at a time.")] = 2,
) -> None:
    """Friction under load: a PUMA, gears that lose nothing to 20 %."""
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [pool.submit(line, loss, seconds, first, seeds) for loss in LOSSES]
        print_lines(each.result() for each in waiting)
