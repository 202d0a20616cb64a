"""The judge: estimates and drives against the truth in the model file."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.applications.drives.friction_curves import DriveEstimate, FrictionCurve
from testbed.applications.drives.identify_drives import DriveFindings
from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.dynamics.regressor import regressor
from testbed.core.estimation.estimate import Estimate, Method, channel_units
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.parameters.minimal_set import MinimalSet, minimal_set, selection
from testbed.core.parameters.symbols import barycentric, parameter_scale
from testbed.core.recordings.columns import PLATE_UNITS
from testbed.core.recordings.recording import Recording, Truth
from testbed.core.robot.friction import COULOMB, LOAD, ROTOR, term_torque
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.shafts import shares
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import SimulationTable
from testbed.sensors.errors.torque_constant_error import TorqueConstantError
from testbed.sensors.kind_table import each_joint

INSTANTS = 400
"""Of a motion on which predictions are held against the truth, about."""

NOTHING = 1e-12
"""Signals below this are none [N, N m]."""


@dataclass(frozen=True)
class Accuracy:
    """What one estimate predicts beside what its robot does, without noise.

    Attributes:
        wrench: Rms error of the base wrench over its rms, both about their means, which are the
            weight and the plate's zero; of forces and moments the larger. None for an estimate
            that does not identify it, as that of joint torques.
        torque: Rms error of the joint torques that the bodies need, friction apart, over their
            rms; of rotary and of sliding joints the larger. None where they need none.
    """

    wrench: float | None
    torque: float | None


def accuracies(
    tree: Tree,
    estimates: Mapping[Method, Estimate],
    zeros: bool | Sequence[str],
    motion: Motion,
) -> dict[Method, Accuracy]:
    """How well estimates predict a motion, by method.

    Args:
        tree: The robot with its true inertias, under the recording's gravity.
        estimates: By method.
        zeros: Which zeros were taken as known, as in `minimal_set`.
        motion: What the robot does, M samples.
    """
    some = motion[:: max(1, motion.samples // INSTANTS)]
    dynamic = minimal_set(tree, "dynamic", zeros=zeros)
    units = channel_units(tree, "internal")
    found: dict[Method, Accuracy] = {}
    for method, estimate in estimates.items():
        own, values = estimate.minimal, estimate.base.values
        wrench = torque = None
        if method == "external":
            wrench = _share(tree, some, own, values, PLATE_UNITS, about_mean=True)
        with suppress(ValueError):  # a plate that measures changes only
            values = (
                selection(dynamic, own) @ values if method == "external" else values
            )
            torque = _share(tree, some, dynamic, values, units, about_mean=False)
        found[method] = Accuracy(wrench, torque)
    return found


def _share(
    tree: Tree,
    motion: Motion,
    minimal: MinimalSet,
    values: Array,
    units: Sequence[str],
    *,
    about_mean: bool,
) -> float | None:
    """Rms error of what parameters predict over the rms of what is true, for the worse unit."""
    columns = regressor(tree, motion, minimal)
    truth = minimal.values(barycentric(tree))
    signal, error = columns @ truth, columns @ (values - truth)
    if about_mean:
        signal, error = (each - each.mean(axis=0) for each in (signal, error))
    return share_of_signal(
        np.linalg.norm(error, axis=0), np.linalg.norm(signal, axis=0), units
    )


def share_of_signal(error: Array, signal: Array, units: Sequence[str]) -> float | None:
    """Rms error over the signal's rms; of channels of several units the worst, None without signal.

    Args:
        error: Root of the sum of squares of each channel, (C,) [N, N m].
        signal: The same of what they should be, (C,).
        units: One a channel.
    """
    shares = []
    for unit in dict.fromkeys(units):
        same = np.array([each == unit for each in units])
        size = float(np.linalg.norm(signal[same]))
        if size > NOTHING:
            shares.append(float(np.linalg.norm(error[same])) / size)
    return max(shares, default=None)


SMALL = 0.01
"""A parameter below this share of the largest of its unit is small: its error is relative to that
share."""

FAINT = 0.1
"""A joint's term that makes less than this share of the joint's rms torque is faint: its error is
relative to that share."""


@dataclass(frozen=True, eq=False)
class Errors:
    """One estimate's errors.

    Attributes:
        names: Of the parameters, (p,), as the estimate has them.
        truth: (p,).
        scale: (p,); not a number where there is none. Of a minimal parameter, abs(truth), or 1 %
            of the largest true value of the same unit if that is more; of a joint's term,
            abs(truth), or what makes 10 % of the joint's rms torque.
        relative: Errors over their scales, (p,).
        z: (estimate - truth) / sigma, (p,); this and `relative` are not numbers where a value is
            not identifiable.
    """

    names: tuple[str, ...]
    truth: Array
    scale: Array
    relative: Array
    z: Array


@dataclass(frozen=True, eq=False)
class Score:
    """A run's estimates against the truth.

    Attributes:
        errors: By method: of delta_r, and of delta_d with friction.
        metrics: What `[expect]` can bound, by name (docs/experiments.md). Those of a method
            without estimate, and those for which the robot has no scale, are absent.
        accuracy: By method, in a few numbers.
    """

    errors: Mapping[Method, Errors]
    metrics: Mapping[str, float]
    accuracy: Mapping[Method, Accuracy]

    @property
    def truths(self) -> dict[str, float]:
        """True values by parameter name."""
        return {
            name: value
            for errors in self.errors.values()
            for name, value in zip(errors.names, errors.truth.tolist(), strict=True)
        }


def score(
    tree: Tree,
    estimates: Mapping[Method, Estimate],
    zeros: bool | Sequence[str],
    plant: SimulationTable,
    motion: Motion,
    torque: Array | None,
) -> Score:
    """Compare the estimates of one run with the truth.

    Relative rms errors are over delta_d, which both methods know: the external one's is
    S delta_r.

    Args:
        tree: The robot with its true inertias and friction, under the recording's gravity.
        estimates: By method.
        zeros: Which zeros were taken as known, as in `minimal_set`.
        plant: Whether it had the file's friction, and its effects.
        motion: That was identified, M samples.
        torque: Motor torques along it, (M, n) [N m or N]; None where there are none.
    """
    errors = {
        method: _errors(estimate, _truth(tree, estimate, plant), motion, torque)
        for method, estimate in estimates.items()
    }
    metrics: dict[str, float | None] = {}
    for method, estimate in estimates.items():
        found, count = errors[method], estimate.minimal.count
        relative = found.relative[:count]
        metrics[f"{method}_max_relative_error"] = _largest(relative)
        metrics[f"{method}_max_z"] = _largest(found.z[:count])
        if method == "external":
            relative = shared_errors(tree, estimate.base.values, zeros)
        metrics[f"{method}_rms_relative_error"] = root_mean_square(relative)
    if "internal" in errors:
        own, relative = estimates["internal"], errors["internal"].relative
        resisting = [term.law.resists for term in own.joint_terms]
        metrics["friction_max_relative_error"] = _largest(
            relative[own.minimal.count :][resisting]
        )
    ours = metrics.get("internal_rms_relative_error")
    theirs = metrics.get("external_rms_relative_error")
    if ours is not None and theirs is not None:
        metrics["internal_to_external"] = ours / max(theirs, TINY)
    known = {name: value for name, value in metrics.items() if value is not None}
    return Score(errors, known, accuracies(tree, estimates, zeros, motion))


def _truth(tree: Tree, estimate: Estimate, plant: SimulationTable) -> Array:
    """True values in the order of an estimate's names."""
    theta, drives = barycentric(tree), estimate.drives
    if drives is None:
        return estimate.minimal.values(theta)
    own = tree if plant.friction else tree.without_friction()
    added = defaultdict[JointLaw, Any](float)
    for effect in plant.effect:
        for law, coefficients in effect.on(tree.names).terms(own).items():
            added[law] += coefficients
    return drives.values(theta, own, added)


def shared_errors(tree: Tree, values: Array, zeros: bool | Sequence[str]) -> Array:
    """Relative errors of delta_d by a plate's parameters.

    Args:
        tree: The robot with its true inertias, under the recording's gravity.
        values: delta_r, (N_r,).
        zeros: Which zeros were taken as known.
    """
    reaction, dynamic = (
        minimal_set(tree, model, zeros=zeros) for model in ("reaction", "dynamic")
    )
    known = selection(dynamic, reaction) @ values
    return relative_errors(known, dynamic.values(barycentric(tree)), dynamic.units)


def _errors(
    estimate: Estimate, truth: Array, motion: Motion, torque: Array | None
) -> Errors:
    error = estimate.values - truth
    sigma = np.maximum(estimate.sigma, TINY)
    count = estimate.minimal.count
    terms = _term_scales(estimate, truth[count:], motion, torque)
    scale = np.concatenate([_usual(truth[:count], estimate.units[:count]), [*terms]])
    error[np.isinf(sigma)] = np.nan
    return Errors(estimate.names, truth, scale, error / scale, error / sigma)


def _term_scales(
    estimate: Estimate, truth: Array, motion: Motion, torque: Array | None
) -> Iterator[float]:
    """Scales of the joints' terms: what would make a small part of the torque."""
    if estimate.drives is None:
        return
    tree = estimate.drives.tree
    for term, true in zip(estimate.drives.terms, np.abs(truth), strict=True):
        j = int(np.argmax(np.abs(shares(tree)[term.joint])))
        unit_torque = _root_mean_square(
            term_torque(tree, term, motion.qd, motion.qdd)[:, j]
        )
        if torque is not None and unit_torque > 0:
            true = max(true, FAINT * (_root_mean_square(torque[:, j]) / unit_torque))
        yield true if true > 0 else np.nan


def _usual(truth: Array, units: Sequence[str]) -> Array:
    """Scales of minimal parameters, (p,); not a number where all of a unit are zero."""
    scale = parameter_scale(truth, units, SMALL)
    return np.where(scale > SMALL * NOTHING * scale.max(initial=0.0), scale, np.nan)


def relative_errors(values: Array, truth: Array, units: Sequence[str]) -> Array:
    """Errors of minimal parameters over their scales, (..., p), as in `Errors.relative`.

    Args:
        values: (..., p).
        truth: (p,).
        units: (p,).
    """
    return (values - truth) / _usual(truth, units)


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def root_mean_square(errors: Array) -> float | None:
    """Of those errors that are numbers; None without any.

    Args:
        errors: Some of them not numbers, where there is no scale.
    """
    there = errors[np.isfinite(errors)]
    return _root_mean_square(there) if there.size else None


def _largest(errors: Array) -> float | None:
    there = np.abs(errors[~np.isnan(errors)])
    return float(there.max()) if there.size else None


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
    constants, load = true_constants(experiment, recording), np.zeros(tree.n)
    for effect in experiment.simulation.effect:
        gears = effect.on(tree.names).gears(tree)
        # as one loss in both directions and a constant: no torque shows more
        if gears is not None:
            constants = constants * (1 + (gears.driving - gears.driven) / 2)
            load = (gears.driving + gears.driven) / (2 + gears.driving - gears.driven)
    errors = np.array([each.constant for each in found.estimates]) / constants - 1
    sigmas = np.array([each.sigma for each in found.estimates]) / constants
    metrics = {
        "torque_constant_max_error": float(np.abs(errors).max()),
        "torque_constant_max_z": float(
            np.abs(errors / np.maximum(sigmas, 1e-300)).max()
        ),
        **_bodies(tree, experiment, found),
        **dict(_law_errors(tree, found.estimates, load)),
    }
    if recording.truth is not None:
        least = experiment.identification.deadband
        errors = np.concatenate([*_curve_errors(found.curves, recording.truth, least)])
        curves = root_mean_square(errors)
        metrics["friction_curve_rms"] = np.nan if curves is None else curves
    return metrics


def _law_errors(
    tree: Tree, drives: Sequence[DriveEstimate], load: Array
) -> Iterator[tuple[str, float]]:
    """Largest relative errors of coefficients that the robot has, by metric."""
    for name, law, truth, missing in (
        ("load", LOAD, load, 0.0),
        ("coulomb", COULOMB, COULOMB.coefficients(tree), np.nan),
        ("rotor", ROTOR, ROTOR.coefficients(tree), np.nan),
    ):
        values = np.array([_coefficient(each, law, missing) for each in drives])
        there = (truth != 0) & ~np.isnan(values)
        if there.any():
            off = np.abs(values[there] / truth[there] - 1)
            yield f"{name}_max_relative_error", float(off.max())


def true_constants(experiment: Experiment, recording: Recording) -> Array:
    """What each drive reports over what its torque is, (n,).

    Args:
        experiment: What was carried out.
        recording: What it recorded.
    """
    shown = np.ones(len(recording.names))
    instrument = experiment.measurement
    stages = instrument.installed(recording.names, experiment.seed)
    for fault in stages["torque"]:
        if isinstance(fault, TorqueConstantError):
            shown = shown * (1 + each_joint(fault.error))
    return shown


def _coefficient(drive: DriveEstimate, law: JointLaw, missing: float) -> float:
    """Coefficient of a law at a joint; `missing` where the joint has no such term."""
    return next((term.value for term in drive.terms if term.law == law), missing)


def _curve_errors(
    curves: Iterable[FrictionCurve], truth: Truth, least: float
) -> Iterator[Array]:
    """Of every joint at its nodes: against true friction near the nodes' speeds."""
    for j, curve in enumerate(curves):
        there = [
            true_friction(truth, j, float(speed)) if abs(speed) > least else np.nan
            for speed in curve.speed
        ]
        yield curve.torque - np.array(there)


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


def _bodies(
    tree: Tree, experiment: Experiment, found: DriveFindings
) -> dict[str, float]:
    """The estimate of plate and torques together."""
    zeros, both = experiment.identification.zeros, found.combined
    truth = minimal_set(tree, "reaction", zeros=zeros).values(barycentric(tree))
    uncertain = both.sigma > 0  # what is known beforehand has no error in sigmas
    z = (both.values - truth)[uncertain] / both.sigma[uncertain]
    rms = root_mean_square(shared_errors(tree, both.values, zeros))
    metrics = {} if rms is None else {"combined_rms_relative_error": rms}
    return metrics | {"combined_max_z": float(np.abs(z).max(initial=0.0))}
