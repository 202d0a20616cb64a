"""What the plate says of the drives, against what they are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from testbed.arrays import Array
from testbed.experiment.experiment import Experiment
from testbed.experiment.score import root_mean_square, shared_errors
from testbed.identification.drives.friction_curves import FrictionCurve
from testbed.identification.drives.identify_drives import DriveFindings
from testbed.identification.drives.torque_constants import DriveEstimate
from testbed.instruments.drives import TorqueConstantError
from testbed.kind_table import each_joint
from testbed.parameters.barycentric import barycentric
from testbed.parameters.minimal_set import minimal_set
from testbed.recordings.recording import Recording, Truth
from testbed.robot.friction import COULOMB, ROTOR, JointLaw
from testbed.robot.tree import Tree

NEAR = 0.1
"""Relative distance from a speed that is near it."""

FEW = 10
"""Samples that are needed there."""


def drive_metrics(
    tree: Tree, experiment: Experiment, recording: Recording, found: DriveFindings
) -> dict[str, float]:
    """Figures of merit by name (docs/experiments.md); those that make no sense are absent.

    Args:
        tree: The robot with its true inertias, friction and rotors.
        experiment: What was carried out.
        recording: What it recorded, columns in the order of `tree.names`.
        found: What the plate says of the drives.
    """
    constants = true_constants(experiment, recording)
    estimates = found.estimates
    errors = np.array([each.constant for each in estimates]) / constants - 1
    sigmas = np.array([each.sigma for each in estimates]) / constants
    metrics = {
        "torque_constant_max_error": float(np.abs(errors).max()),
        "torque_constant_max_z": float(np.abs(errors / np.maximum(sigmas, 1e-300)).max()),
        **_bodies(tree, experiment, found),
    }
    for law, name in ((COULOMB, "coulomb"), (ROTOR, "rotor")):
        off = list(_relative(tree, law, estimates))
        if off:
            metrics[f"{name}_max_relative_error"] = max(off)
    if recording.truth is not None:
        least = experiment.identification.deadband
        metrics["friction_curve_rms"] = _rms(_curve_errors(found.curves, recording.truth, least))
    return metrics


def true_constants(experiment: Experiment, recording: Recording) -> Array:
    """What each drive reports over what its torque is, (n,).

    Args:
        experiment: What was carried out.
        recording: What it recorded.
    """
    shown = np.ones(len(recording.names))
    instrument = experiment.measurement
    stages = instrument.installed(recording.names, recording.position, experiment.seed)
    for fault in stages["torque"]:
        if isinstance(fault, TorqueConstantError):
            shown = shown * (1 + each_joint(fault.error))
    return shown


def _relative(tree: Tree, law: JointLaw, drives: Iterable[DriveEstimate]) -> Iterator[float]:
    """Relative errors of one law's coefficients, where the robot has them."""
    for true, drive in zip(law.coefficients(tree), drives, strict=True):
        for term in drive.terms:
            if term.law == law and true:
                yield abs(term.value / float(true) - 1)


def _curve_errors(curves: Iterable[FrictionCurve], truth: Truth, least: float) -> Iterator[Array]:
    """Of every joint at its nodes: against true friction near the nodes' speeds."""
    for j, curve in enumerate(curves):
        there = [
            true_friction(truth, j, float(speed)) if abs(speed) > least else np.nan
            for speed in curve.speed
        ]
        errors = curve.torque - np.array(there)
        yield errors[np.isfinite(errors)]


def true_friction(truth: Truth, joint: int, speed: float) -> float:
    """What friction took near a speed, by a straight line; not a number without data.

    Args:
        truth: What happened.
        joint: Index.
        speed: [rad/s or m/s].
    """
    away = truth.velocity[:, joint] - speed
    near = np.abs(away) < NEAR * abs(speed)
    if near.sum() < FEW:
        return float("nan")
    line = np.polynomial.polynomial.polyfit(away[near], truth.friction[near, joint], 1)
    return float(line[0])


def _rms(errors: Iterator[Array]) -> float:
    every = np.concatenate([*errors, np.zeros(0)])
    return float(np.sqrt(np.mean(every**2))) if every.size else float("nan")


def _bodies(tree: Tree, experiment: Experiment, found: DriveFindings) -> dict[str, float]:
    """The estimate of plate and torques together."""
    zeros, both = experiment.identification.zeros, found.combined
    truth = minimal_set(tree, "reaction", zeros=zeros).values(barycentric(tree))
    uncertain = both.sigma > 0  # what is known beforehand has no error in sigmas
    z = (both.values - truth)[uncertain] / both.sigma[uncertain]
    rms = root_mean_square(shared_errors(tree, both.values, zeros))
    metrics = {} if rms is None else {"combined_rms_relative_error": rms}
    return metrics | {"combined_max_z": float(np.abs(z).max(initial=0.0))}
