"""Errors of estimates and drives against the true parameters of the model file."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.applications.drives.friction_curves import DriveEstimate, FrictionCurve
from testbed.applications.drives.identify_drives import DriveIdentification
from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.dynamics.regressor import regressor
from testbed.core.estimation.estimate import Estimate, channel_units
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE
from testbed.core.parameters.minimal_set import MinimalSet, minimal_set, selection
from testbed.core.parameters.rules import Signal
from testbed.core.parameters.symbols import barycentric, parameter_scale
from testbed.core.recordings.columns import WRENCH_UNITS
from testbed.core.recordings.recording import Recording, Truth
from testbed.core.robot.friction import COULOMB, LOAD_FRICTION, ROTOR, term_torque
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.shafts import transmission_matrix
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import SimulationTable
from testbed.sensors.errors.torque_constant_error import TorqueConstantError
from testbed.sensors.kind_table import joint_array

MOTION_SAMPLES = 400
"""Approximate number of samples of a motion along which predictions are compared with the truth."""

MIN_SIGNAL = 1e-12
"""Norm of a channel group up to which the true signal counts as zero [N, N m]."""


@dataclass(frozen=True)
class Accuracy:
    """Prediction errors of one estimate relative to the true signals, without noise.

    Attributes:
        wrench: Ratio of the rms error of the base wrench to its rms, after the means (weight and
            plate zero) are subtracted; the larger of forces and moments. None for an estimate from
            joint torques, which does not identify the wrench.
        torque: Ratio of the rms error of the rigid-body joint torques, without friction, to their
            rms; the larger of rotary and sliding joints. None if all these torques are zero.
    """

    wrench: float | None
    torque: float | None


def prediction_accuracies(
    tree: Tree,
    estimates: Mapping[Signal, Estimate],
    zeros: bool | Sequence[str],
    motion: Motion,
) -> dict[Signal, Accuracy]:
    """Prediction errors of estimates along a motion, keyed by method.

    The comparison uses about `MOTION_SAMPLES` evenly spaced samples.

    Args:
        tree: The robot with its true inertias, under the recording's gravity.
        estimates: Estimates by method.
        zeros: Known zeros, as in `minimal_set`.
        motion: Motion of the robot, M samples.
    """
    samples = motion[:: max(1, motion.samples // MOTION_SAMPLES)]
    torque_set = minimal_set(tree, "torque", zeros=zeros)
    units = channel_units(tree, "torque")
    accuracy: dict[Signal, Accuracy] = {}
    for method, estimate in estimates.items():
        minimal, values = estimate.minimal, estimate.base.values
        wrench = torque = None
        if method == "wrench":
            wrench = _prediction_error(
                tree, samples, minimal, values, WRENCH_UNITS, about_mean=True
            )
        with suppress(ValueError):  # a plate with unknown zero offset
            values = (
                selection(torque_set, minimal) @ values
                if method == "wrench"
                else values
            )
            torque = _prediction_error(
                tree, samples, torque_set, values, units, about_mean=False
            )
        accuracy[method] = Accuracy(wrench, torque)
    return accuracy


def _prediction_error(
    tree: Tree,
    motion: Motion,
    minimal: MinimalSet,
    values: Array,
    units: Sequence[str],
    *,
    about_mean: bool,
) -> float | None:
    """Ratio of rms prediction error to rms true signal, the largest over all units.

    With `about_mean`, the means over the motion are subtracted from error and signal.
    """
    columns = regressor(tree, motion, minimal)
    truth = minimal.values(barycentric(tree))
    signal, error = columns @ truth, columns @ (values - truth)
    if about_mean:
        signal, error = (each - each.mean(axis=0) for each in (signal, error))
    return relative_rms_error(
        np.linalg.norm(error, axis=0), np.linalg.norm(signal, axis=0), units
    )


def relative_rms_error(
    error: Array, signal: Array, units: Sequence[str]
) -> float | None:
    """Ratio of rms error to rms signal, the largest over all units; None without signal.

    Args:
        error: Root sum of squares of the error of each channel, (C,) [N, N m].
        signal: Root sum of squares of the signal of each channel, (C,) [N, N m].
        units: Units of the channels, (C,).
    """
    shares = []
    for unit in dict.fromkeys(units):
        channels = np.array([each == unit for each in units])
        norm = float(np.linalg.norm(signal[channels]))
        if norm > MIN_SIGNAL:
            shares.append(float(np.linalg.norm(error[channels])) / norm)
    return max(shares, default=None)


MIN_PARAMETER_SCALE = 0.01
"""Smallest scale of a parameter's relative error, as a share of the largest parameter of the
unit."""

MIN_TORQUE_SCALE = 0.1
"""Smallest scale of a joint term's relative error: its torque is this share of the joint's rms
torque."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of one estimate against the truth.

    Attributes:
        names: Names of the parameters, (p,).
        truth: True values, (p,).
        scale: Scales of the relative errors, (p,); NaN where there is none. The scale of a minimal
            parameter is abs(truth) or 1 % of the largest true value of the same unit, whichever is
            larger; that of a joint term is abs(truth) or the value that produces 10 % of the
            joint's rms torque, whichever is larger.
        relative: Errors divided by their scales, (p,).
        z: (estimate - truth) / sigma, (p,); `z` and `relative` are NaN for unidentifiable values.
    """

    names: tuple[str, ...]
    truth: Array
    scale: Array
    relative: Array
    z: Array


@dataclass(frozen=True, eq=False)
class Score:
    """Errors of a run's estimates against the truth, with metrics.

    Attributes:
        errors: Errors keyed by method: of the wrench's base parameters (delta_r), and of the
            torques' base parameters (delta_d) with friction.
        metrics: Metrics that `[expect]` can bound, by name (docs/experiments.md). Metrics of a
            method without estimate, and relative errors without a scale, are left out.
        accuracy: Prediction errors keyed by method.
    """

    errors: Mapping[Signal, Errors]
    metrics: Mapping[str, float]
    accuracy: Mapping[Signal, Accuracy]

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
    estimates: Mapping[Signal, Estimate],
    zeros: bool | Sequence[str],
    plant: SimulationTable,
    motion: Motion,
    torque: Array | None,
) -> Score:
    """Compare the estimates of a run with the truth.

    Rms relative errors are computed for the torques' base parameters, delta_d. Both methods
    identify these; the values from the plate are computed from its own base parameters.

    Args:
        tree: The robot with its true inertias and friction, under the recording's gravity.
        estimates: Estimates by method.
        zeros: Known zeros, as in `minimal_set`.
        plant: Simulation table, with friction on or off and further effects.
        motion: Recorded motion, M samples.
        torque: Motor torques along the motion, (M, n) [N m or N]; None if not measured.
    """
    errors = {
        method: _estimate_errors(
            estimate, _true_values(tree, estimate, plant), motion, torque
        )
        for method, estimate in estimates.items()
    }
    metrics: dict[str, float | None] = {}
    for method, estimate in estimates.items():
        error, count = errors[method], estimate.minimal.count
        relative = error.relative[:count]
        metrics[f"{method}_max_relative_error"] = _largest_error(relative)
        metrics[f"{method}_max_z"] = _largest_error(error.z[:count])
        if method == "wrench":
            relative = torque_set_errors(tree, estimate.base.values, zeros)
        metrics[f"{method}_rms_relative_error"] = finite_rms(relative)
    if "torque" in errors:
        estimate_by_torques, relative = estimates["torque"], errors["torque"].relative
        resisting = [term.law.dissipative for term in estimate_by_torques.joint_terms]
        metrics["friction_max_relative_error"] = _largest_error(
            relative[estimate_by_torques.minimal.count :][resisting]
        )
    torque_error = metrics.get("torque_rms_relative_error")
    wrench_error = metrics.get("wrench_rms_relative_error")
    if torque_error is not None and wrench_error is not None:
        metrics["torque_to_wrench"] = torque_error / max(
            wrench_error, SMALLEST_POSITIVE
        )
    known = {name: value for name, value in metrics.items() if value is not None}
    return Score(errors, known, prediction_accuracies(tree, estimates, zeros, motion))


def _true_values(tree: Tree, estimate: Estimate, plant: SimulationTable) -> Array:
    """True values of an estimate's parameters, in the estimate's order."""
    theta, drives = barycentric(tree), estimate.drives
    if drives is None:
        return estimate.minimal.values(theta)
    robot = tree if plant.friction else tree.without_friction()
    effect_terms = defaultdict[JointLaw, Any](float)
    for effect in plant.effect:
        for law, coefficients in (
            effect.for_joints(tree.names).true_coefficients(robot).items()
        ):
            effect_terms[law] += coefficients
    return drives.values(theta, robot, effect_terms)


def torque_set_errors(tree: Tree, values: Array, zeros: bool | Sequence[str]) -> Array:
    """Relative errors of the torques' base parameters, (N_d,).

    These parameters are computed from the base parameters of the wrench.

    Args:
        tree: The robot with its true inertias, under the recording's gravity.
        values: Base parameters of the wrench, (N_r,).
        zeros: Known zeros, as in `minimal_set`.
    """
    wrench_set, torque_set = (
        minimal_set(tree, model, zeros=zeros) for model in ("wrench", "torque")
    )
    delta_d = selection(torque_set, wrench_set) @ values
    return relative_errors(
        delta_d, torque_set.values(barycentric(tree)), torque_set.units
    )


def _estimate_errors(
    estimate: Estimate, truth: Array, motion: Motion, torque: Array | None
) -> Errors:
    """Errors of one estimate against true values in the same order."""
    error = estimate.values - truth
    sigma = np.maximum(estimate.sigma, SMALLEST_POSITIVE)
    count = estimate.minimal.count
    terms = _term_scales(estimate, truth[count:], motion, torque)
    scale = np.concatenate(
        [_parameter_scales(truth[:count], estimate.units[:count]), [*terms]]
    )
    error[np.isinf(sigma)] = np.nan
    return Errors(estimate.names, truth, scale, error / scale, error / sigma)


def _term_scales(
    estimate: Estimate, truth: Array, motion: Motion, torque: Array | None
) -> Iterator[float]:
    """Yield the scales of the joint terms' relative errors, in the order of the terms.

    Scales are those of `Errors.scale`. Without measured torques, the scale is the absolute true
    coefficient, or NaN if this is zero.
    """
    if estimate.drives is None:
        return
    tree = estimate.drives.tree
    for term, true in zip(estimate.drives.terms, np.abs(truth), strict=True):
        j = int(np.argmax(np.abs(transmission_matrix(tree)[term.joint])))
        unit_torque = _rms(term_torque(tree, term, motion.qd, motion.qdd)[:, j])
        if torque is not None and unit_torque > 0:
            true = max(true, MIN_TORQUE_SCALE * (_rms(torque[:, j]) / unit_torque))
        yield true if true > 0 else np.nan


def _parameter_scales(truth: Array, units: Sequence[str]) -> Array:
    """Scales of the minimal parameters' relative errors, (p,).

    The scale is NaN where all true values of the unit are zero.
    """
    scale = parameter_scale(truth, units, MIN_PARAMETER_SCALE)
    return np.where(
        scale > MIN_PARAMETER_SCALE * MIN_SIGNAL * scale.max(initial=0.0), scale, np.nan
    )


def relative_errors(values: Array, truth: Array, units: Sequence[str]) -> Array:
    """Minimal-parameter errors divided by their scales, (..., p), as in `Errors.relative`.

    Args:
        values: Parameter values, (..., p).
        truth: True values, (p,).
        units: Units of the parameters, (p,).
    """
    return (values - truth) / _parameter_scales(truth, units)


def _rms(values: Array) -> float:
    """Root mean square of all elements."""
    return float(np.sqrt(np.mean(values**2)))


def finite_rms(errors: Array) -> float | None:
    """Root mean square of the finite errors; None if no error is finite.

    Args:
        errors: Relative errors; NaN without a scale.
    """
    finite = errors[np.isfinite(errors)]
    return _rms(finite) if finite.size else None


def _largest_error(errors: Array) -> float | None:
    """Largest absolute error, ignoring NaN; None if all errors are NaN."""
    sizes = np.abs(errors[~np.isnan(errors)])
    return float(sizes.max()) if sizes.size else None


SPEED_TOLERANCE = 0.1
"""Relative distance up to which a speed is near the speed of a node."""

MIN_SAMPLES = 10
"""Smallest number of samples near a node's speed."""


def drive_metrics(
    tree: Tree,
    experiment: Experiment,
    recording: Recording,
    findings: DriveIdentification,
) -> dict[str, float]:
    """Metrics of the drives, keyed by name (docs/experiments.md).

    Torque constants are compared with the true ratios, including gear losses of load-dependent
    friction. Metrics that have no scale are left out.

    Args:
        tree: The robot with its true inertias, friction and rotors.
        experiment: Experiment that made the recording.
        recording: Recording of the experiment, joint columns in the order of `tree.names`.
        findings: Drives identified by the plate's estimate.
    """
    constants, load = true_torque_ratios(experiment, recording), np.zeros(tree.n)
    for effect in experiment.simulation.effect:
        gears = effect.for_joints(tree.names).gear_friction(tree)
        # as a mean loss of both directions and a factor: torques identify no more
        if gears is not None:
            constants = constants * (1 + (gears.driving - gears.driven) / 2)
            load = (gears.driving + gears.driven) / (2 + gears.driving - gears.driven)
    errors = np.array([each.constant for each in findings.estimates]) / constants - 1
    sigmas = np.array([each.sigma for each in findings.estimates]) / constants
    metrics = {
        "torque_constant_max_error": float(np.abs(errors).max()),
        "torque_constant_max_z": float(
            np.abs(errors / np.maximum(sigmas, 1e-300)).max()
        ),
        **_combined_metrics(tree, experiment, findings),
        **dict(_law_errors(tree, findings.estimates, load)),
    }
    if recording.truth is not None:
        min_speed = experiment.identification.deadband
        errors = np.concatenate(
            [*_curve_errors(findings.curves, recording.truth, min_speed)]
        )
        curves = finite_rms(errors)
        metrics["friction_curve_rms"] = np.nan if curves is None else curves
    return metrics


def _law_errors(
    tree: Tree, drives: Sequence[DriveEstimate], load: Array
) -> Iterator[tuple[str, float]]:
    """Yield names and values of the metrics for load, Coulomb and rotor terms.

    A metric is the largest relative error over the joints whose true coefficient is not zero. A
    missing load term counts as zero; joints without one of the other terms are left out.
    """
    for name, law, truth, missing in (
        ("load", LOAD_FRICTION, load, 0.0),
        ("coulomb", COULOMB, COULOMB.coefficients(tree), np.nan),
        ("rotor", ROTOR, ROTOR.coefficients(tree), np.nan),
    ):
        values = np.array([_law_coefficient(each, law, missing) for each in drives])
        known = (truth != 0) & ~np.isnan(values)
        if known.any():
            errors = np.abs(values[known] / truth[known] - 1)
            yield f"{name}_max_relative_error", float(errors.max())


def true_torque_ratios(experiment: Experiment, recording: Recording) -> Array:
    """Ratio of reported to true torque of each drive, (n,).

    Args:
        experiment: Experiment that made the recording.
        recording: Recording of the experiment.
    """
    ratio = np.ones(len(recording.names))
    instrument = experiment.measurement
    stages = instrument.sampled_stages(recording.names, experiment.seed)
    for fault in stages["torque"]:
        if isinstance(fault, TorqueConstantError):
            ratio = ratio * (1 + joint_array(fault.error))
    return ratio


def _law_coefficient(drive: DriveEstimate, law: JointLaw, missing: float) -> float:
    """Coefficient of a drive's term with a given law; `missing` without such a term."""
    return next((term.value for term in drive.terms if term.law == law), missing)


def _curve_errors(
    curves: Iterable[FrictionCurve], truth: Truth, min_speed: float
) -> Iterator[Array]:
    """Yield the errors of each joint's friction curve at its nodes.

    Errors at nodes with speeds up to `min_speed` [rad/s or m/s] are NaN.
    """
    for j, curve in enumerate(curves):
        friction = [
            true_friction(truth, j, float(speed)) if abs(speed) > min_speed else np.nan
            for speed in curve.speed
        ]
        yield curve.torque - np.array(friction)


def true_friction(truth: Truth, joint: int, speed: float) -> float:
    """True friction of a joint at a speed, from a local linear fit [N m or N].

    The result is NaN if there are too few samples near the speed.

    Args:
        truth: Simulated velocities and friction.
        joint: Joint index.
        speed: Velocity [rad/s or m/s].
    """
    distance = truth.velocity[:, joint] - speed
    is_near = np.abs(distance) < SPEED_TOLERANCE * abs(speed)
    if is_near.sum() < MIN_SAMPLES:
        return float("nan")
    coefficients = np.polynomial.polynomial.polyfit(
        distance[is_near], truth.friction[is_near, joint], 1
    )
    return float(coefficients[0])


def _combined_metrics(
    tree: Tree, experiment: Experiment, findings: DriveIdentification
) -> dict[str, float]:
    """Error metrics of the base parameters estimated from plate and torques together."""
    zeros, combined = experiment.identification.zeros, findings.combined
    truth = minimal_set(tree, "wrench", zeros=zeros).values(barycentric(tree))
    is_uncertain = combined.sigma > 0  # known parameters have no z
    z = (combined.values - truth)[is_uncertain] / combined.sigma[is_uncertain]
    rms = finite_rms(torque_set_errors(tree, combined.values, zeros))
    metrics = {} if rms is None else {"combined_rms_relative_error": rms}
    return metrics | {"combined_max_z": float(np.abs(z).max(initial=0.0))}
