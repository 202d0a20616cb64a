"""Diagnostics of estimate and recording: implausible signals, masses, friction, residuals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import (
    VALUES_PER_UNKNOWN,
    SettingsError,
    shortened_list,
    vector_text,
)
from testbed.core.base.stages import timed_stage
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.estimation.diagnostics.residuals import noise_diagnostics
from testbed.core.estimation.diagnostics.rigid_bodies import (
    REJECTION_SIGMAS,
    rigid_body_test,
)
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import total_mass
from testbed.core.estimation.regression.passes import MAX_HELD_FRACTION, Repeats, Survey
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.views import states_pedestal_share
from testbed.core.robot.shafts import transmission_matrix
from testbed.core.robot.tree import Joint, Tree


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the diagnostics.

    Attributes:
        relative_sigma: Sigma relative to a parameter, above which the parameter is uncertain.
        small_sigma: Sigma relative to the largest parameter of its unit, below which it is small.
        max_condition: Condition number of the scaled equations, above which there is a warning.
        negative_share: Largest tolerated negative mass or friction, relative to weight or torque.
        weight_difference: Relative difference of two weights that should be equal.
        relative_residual: Relative residual of a channel, above which it is poorly explained.
        useless_residual: Relative residual above which a prediction is worse than zero.
        outlier_ratio: Residual relative to the smallest of its unit, above which it is an outlier.
        noise_share: Noise of a moment relative to the moment of the weight at full arm length.
        correlation: Squared correlation above which signal and prediction differ by a factor only.
        factor_error: Difference of that factor from one, above which it is the cause.
        min_values_per_unknown: Smallest number of values per unknown for valid standard deviations.
        outside_range: Fraction of a joint's range by which its encoder may exceed the range.
        max_effort_ratio: Largest possible ratio of a measured torque to the motor's maximum.
        extreme_share: Fraction of the samples at one extreme value, above which it is saturated.
        extreme_ratio: Ratio of samples at an extreme to those at the next value, if saturated.
        min_repeats: Smallest number of repeated samples that is reported.
        repeats_ratio: Largest tolerated ratio of repeated samples to those expected by chance.
    """

    relative_sigma: float = 0.3
    small_sigma: float = 0.01
    max_condition: float = 1e3
    negative_share: float = 0.02
    weight_difference: float = 0.5
    relative_residual: float = 0.2
    useless_residual: float = 1.2
    outlier_ratio: float = 5.0
    noise_share: float = 0.01
    correlation: float = 0.9
    factor_error: float = 0.1
    min_values_per_unknown: float = 2
    outside_range: float = 0.02
    max_effort_ratio: float = 2.0
    extreme_share: float = 0.01
    extreme_ratio: float = 5.0
    min_repeats: float = 5
    repeats_ratio: float = 10.0


THRESHOLDS = Thresholds()
"""Default thresholds."""

MIN_RANGE_OF_MOTION = {"revolute": 0.02, "prismatic": 0.002}
"""Range of positions below which a joint hardly moves, by kind of joint [rad, m]."""

MISFIT_CAUSES: Mapping[Signal, tuple[str, ...]] = {
    "wrench": ("exchanged", "moments", "pose", "gravity"),
    "torque": ("exchanged", "encoder-sign", "torques-in-n-mm", "gravity"),
}
"""Likely causes of signals that do not follow their predictions, by method."""


@timed_stage("what the residuals say")
def diagnostics(
    estimate: Estimate, problem: Problem, survey: Survey
) -> tuple[Diagnostic, ...]:
    """Diagnostics of the faults of a recording that the data of one method reveal.

    They cover the number of values, encoders, channels and repeated samples; tare and mass, or
    motor limits and friction; residuals; and, unless mass or friction is negative, the test of
    rigid bodies.

    Args:
        estimate: Estimate from the recording.
        problem: Problem of the estimate, with tree, joint limits and tare.
        survey: Subsample of the raw signals.
    """
    tree, tare = problem.tree, problem.tare
    faults = [
        *_few_values_diagnostics(estimate),
        *_encoder_diagnostics(tree, survey.position),
    ]
    faults += [
        *_channel_diagnostics(estimate, survey.measured, problem),
        *_repeated_sample_diagnostics(estimate, survey.repeats),
    ]
    negative: list[Diagnostic] = []
    if estimate.method == "wrench":
        # without such a statement the tare should be the pedestal's weight
        if not states_pedestal_share(problem.source):
            faults += _tare_diagnostics(tree, tare)
        negative += _mass_diagnostics(estimate, tree, survey.measured, tare)
    else:
        faults += _effort_diagnostics(tree, survey.measured)
        negative += _friction_diagnostics(estimate)
    faults += [*negative, *_residual_diagnostics(estimate, tree)]
    if not negative:
        faults += _consistency_diagnostics(estimate)
    return tuple(faults)


def accuracy_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Diagnostics of an estimate's condition number (over 1e3), noise, and sigmas (over 30 %)."""
    subject = f"the {estimate.method} estimate"
    if estimate.condition > THRESHOLDS.max_condition:
        yield make_diagnostic(
            "estimate.ill-conditioned",
            subject,
            estimate.condition,
            method=estimate.method,
        )
    yield from noise_diagnostics(estimate)
    base = estimate.base
    largest_values: dict[str, float] = {}
    for unit, value in zip(base.units, base.values, strict=True):
        largest_values[unit] = max(largest_values.get(unit, 0.0), abs(value))
    uncertain = [
        f"{name} ({value:.3g} +- {sigma:.2g})"
        for name, unit, value, sigma in zip(
            base.names, base.units, base.values, base.sigma, strict=True
        )
        if sigma > THRESHOLDS.relative_sigma * abs(value)
        and THRESHOLDS.small_sigma * largest_values[unit] < sigma < np.inf
    ]
    if uncertain:
        yield make_diagnostic(
            "estimate.uncertain",
            subject,
            method=estimate.method,
            parameters=shortened_list(uncertain),
        )


def _few_values_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Diagnostic of fewer than two measured values per unknown."""
    unknown_count, value_count = (
        len(estimate.values) + len(estimate.nuisances),
        sum(estimate.samples),
    )
    if value_count < THRESHOLDS.min_values_per_unknown * unknown_count:
        yield make_diagnostic(
            "estimate.few-values",
            f"the {estimate.method} estimate",
            value_count / unknown_count,
            method=estimate.method,
            values=value_count,
            unknowns=unknown_count,
            times=VALUES_PER_UNKNOWN * unknown_count / value_count,
        )


def _repeated_sample_diagnostics(
    estimate: Estimate, repeats: Repeats
) -> Iterator[Diagnostic]:
    """Diagnostics of repeated poses (over 10 %) and repeated samples (over ten times chance)."""
    if repeats.repeated_poses > MAX_HELD_FRACTION * repeats.pairs:
        yield make_diagnostic(
            "encoder.held", "the poses", repeats.repeated_poses / repeats.pairs
        )
    if not repeats.moving_pairs or repeats.all_equal < THRESHOLDS.min_repeats:
        return
    share = repeats.all_equal / repeats.moving_pairs
    by_chance = float(np.prod(repeats.equal_by_channel / repeats.moving_pairs))
    if share > THRESHOLDS.repeats_ratio * by_chance:
        yield make_diagnostic(
            "channel.repeated",
            "the plate's samples"
            if estimate.method == "wrench"
            else "the torques' samples",
            share,
            method=estimate.method,
            count=repeats.all_equal,
            steps=repeats.moving_pairs,
        )


def _encoder_diagnostics(tree: Tree, position: Array) -> Iterator[Diagnostic]:
    """Diagnostics of positions outside a range (by 2 %), or of resting joints (0.02 rad, 2 mm)."""
    for joint, q in zip(tree.joints, position.T, strict=True):
        unit, subject = (
            "rad" if joint.revolute else "m",
            f"the encoder of '{joint.name}'",
        )
        low, high = float(q.min()), float(q.max())
        least, greatest = joint.position_range
        margin = (
            THRESHOLDS.outside_range * (greatest - least)
            if np.isfinite(greatest - least)
            else 0.0
        )
        if low < least - margin or high > greatest + margin:
            yield make_diagnostic(
                "encoder.range",
                subject,
                max(least - low, high - greatest),
                causes=_encoder_causes(joint, low, high),
                low=low,
                high=high,
                least=least,
                greatest=greatest,
                unit=unit,
            )
        elif high - low < MIN_RANGE_OF_MOTION[joint.kind]:
            yield make_diagnostic("encoder.still", subject, high - low, unit=unit)


def _encoder_causes(joint: Joint, low: float, high: float) -> list[str]:
    """Likely causes of positions outside a range; a sufficient unit or sign error comes first."""
    least, greatest = joint.position_range
    factor = 180 / np.pi if joint.revolute else 1000.0
    converted = least <= low / factor and high / factor <= greatest
    converted &= high - low > greatest - least
    negated = least <= -high and -low <= greatest
    unit = "degrees" if joint.revolute else "millimetres"
    causes = (
        (converted, unit),
        (negated, "sign"),
        (not converted, "zero"),
        (True, "exchanged"),
        (not converted, unit),
    )
    return [cause for holds, cause in causes if holds]


def _channel_diagnostics(
    estimate: Estimate, measured: Array, problem: Problem
) -> Iterator[Diagnostic]:
    """Diagnostics of constant or saturated channels (1 % of samples), except `channel_faults`."""
    faulty_channels = {fault.name for fault in problem.channel_faults}
    for c, values in enumerate(measured.T):
        if estimate.channels[c] in faulty_channels:
            continue
        unit, label, method = (
            estimate.channel_units[c],
            estimate.label(c),
            estimate.method,
        )
        if np.ptp(values) == 0:
            if estimate.matters[c]:
                yield make_diagnostic(
                    "channel.constant", label, values[0], method=method, unit=unit
                )
            continue
        share, extreme = max(
            (_stop_fraction(values, float(e)), float(e))
            for e in (values.max(), values.min())
        )
        if share > THRESHOLDS.extreme_share:
            yield make_diagnostic(
                "channel.saturated", label, share, method=method, end=extreme, unit=unit
            )


def _stop_fraction(values: Array, extreme: float) -> float:
    """Fraction of samples at an extreme value; 0 for a smooth peak.

    A saturated extreme has over five times as many samples as the nearest other value.
    """
    distance = np.abs(values - extreme)
    other_distances = distance[distance > 0]
    next_count = int((other_distances == other_distances.min()).sum())
    extreme_count = len(values) - len(other_distances)
    return (
        extreme_count / len(values)
        if extreme_count > THRESHOLDS.extreme_ratio * next_count
        else 0.0
    )


def _effort_diagnostics(tree: Tree, torque: Array) -> Iterator[Diagnostic]:
    """Diagnostics of torques above twice the maximum torque of the motors."""
    for joint, values in zip(tree.joints, torque.T, strict=True):
        greatest_torque = float(np.abs(values).max())
        if greatest_torque > THRESHOLDS.max_effort_ratio * joint.max_effort:
            other_causes = ["exchanged", "raw-units"]
            yield make_diagnostic(
                "torque.effort",
                f"the torque of '{joint.name}'",
                greatest_torque / joint.max_effort,
                method="torque",
                causes=["torques-in-n-mm"] * joint.revolute + other_causes,
                most=greatest_torque,
                effort=joint.max_effort,
                unit="N m" if joint.revolute else "N",
            )


def _tare_diagnostics(tree: Tree, tare: Array) -> Iterator[Diagnostic]:
    """Diagnostic of a tare that differs by more than 50 % from the model's pedestal weight."""
    expected = pedestal_wrench(tree)[:3]
    largest_force = max(np.linalg.norm(expected), np.linalg.norm(tare[:3]))
    difference = float(np.linalg.norm(tare[:3] - expected))
    if expected.any() and difference > THRESHOLDS.weight_difference * largest_force:
        causes = ["units-of-tare" if tare.any() else "no-tare", "other-pedestal"]
        yield make_diagnostic(
            "plate.tare",
            "the tare's force",
            difference,
            method="wrench",
            causes=["sign-of-tare"] * bool(tare[:3] @ expected < 0) + causes,
            force=vector_text(tare[:3]),
            expected=vector_text(expected),
        )


def _mass_diagnostics(
    estimate: Estimate, tree: Tree, wrench: Array, tare: Array
) -> Iterator[Diagnostic]:
    """Diagnostic of a total mass that is negative, or differs from the mean measured weight.

    Thresholds are 5 sigma and 2 % of the weight (negative), or 5 sigma plus 50 % (different). There
    is no diagnostic without gravity, or if the parameters do not determine the total mass.
    """
    base, gravity = estimate.base, float(np.linalg.norm(tree.gravity))
    try:
        mass_functional = total_mass(tree, estimate.minimal)
    except SettingsError:  # the minimal parameters do not determine it
        return
    if gravity == 0:
        return
    mass = float(mass_functional @ base.values)
    sigma = float(np.sqrt(mass_functional @ base.covariance @ mass_functional))
    up = -tree.gravity / gravity
    carried = float(np.mean(wrench[:, :3] @ up)) / gravity
    subject = "the robot's total mass"
    if mass < -REJECTION_SIGMAS * sigma and mass < -THRESHOLDS.negative_share * abs(
        carried
    ):
        likely_causes = ["sign-of-wrench", "other-tare"]
        if tare.any() and not tare[:3] @ up < 0:
            likely_causes = likely_causes[::-1]
        causes = (*likely_causes, "exchanged", "gravity")
        yield make_diagnostic(
            "plate.negative-mass",
            subject,
            mass,
            sigma=sigma,
            method="wrench",
            causes=causes,
        )
    elif (
        abs(mass - carried)
        > THRESHOLDS.weight_difference * max(abs(mass), abs(carried))
        + REJECTION_SIGMAS * sigma
    ):
        yield make_diagnostic(
            "plate.mass",
            subject,
            mass - carried,
            sigma=sigma,
            method="wrench",
            mass=mass,
            carried=carried,
        )


def _friction_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Diagnostics of friction coefficients below zero by 5 sigma and 2 % of the RMS torque."""
    equations, drives = estimate.normal_equations, estimate.drives
    if drives is None:
        return
    # joint whose torque has the largest share of each shaft's
    joints_of_shafts = np.argmax(np.abs(transmission_matrix(drives.tree)), axis=1)
    for k, term in enumerate(estimate.joint_terms, start=estimate.minimal.count):
        shaft = drives.terms[k - estimate.minimal.count].joint
        normal, _, square = equations.of_channel(int(joints_of_shafts[shaft]))
        torque = abs(term.value) * np.sqrt(normal[k, k])
        significant = (
            term.value < -REJECTION_SIGMAS * term.sigma
            and torque > THRESHOLDS.negative_share * np.sqrt(square)
        )
        if term.law.dissipative and significant:
            yield make_diagnostic(
                "friction.negative",
                f"the friction {term.name}",
                term.value,
                sigma=term.sigma,
                method="torque",
                unit=term.unit,
            )


def _residual_diagnostics(estimate: Estimate, tree: Tree) -> Iterator[Diagnostic]:
    """Diagnostics of channels that the model explains poorly although their signal is large.

    The relative residual exceeds 1.2, or it exceeds 0.2 and the residual exceeds `_residual_limits`
    or five times the smallest residual of the same unit.
    """
    limits = _residual_limits(estimate, tree)
    for c, (share, residual) in enumerate(
        zip(estimate.relative_residual, estimate.residual, strict=True)
    ):
        same_unit = [
            unit == estimate.channel_units[c] for unit in estimate.channel_units
        ]
        outlying = (
            residual > THRESHOLDS.outlier_ratio * estimate.residual[same_unit].min()
        )
        poorly_explained = share > THRESHOLDS.useless_residual or (
            share > THRESHOLDS.relative_residual and outlying
        )
        if (poorly_explained and estimate.matters[c]) or (
            share > THRESHOLDS.relative_residual and residual > limits[c]
        ):
            yield _residual_diagnostic(estimate, c, float(share))


def _residual_limits(estimate: Estimate, tree: Tree) -> Array:
    """Largest acceptable residual of each channel, (C,) [N, N m]; infinite for joint torques.

    Limits are 20 % of the largest RMS force or moment; for moments, at least 1 % of the moment that
    the largest force has at full arm length.
    """
    rms = estimate.normal_equations.rms
    if estimate.method == "torque":
        return np.full(len(rms), np.inf)
    force, moment = float(rms[:3].max()), float(rms[3:].max())
    arm_length = sum(float(np.linalg.norm(joint.offset)) for joint in tree.joints)
    moment = max(
        THRESHOLDS.relative_residual * moment,
        THRESHOLDS.noise_share * arm_length * force,
    )
    return np.repeat([THRESHOLDS.relative_residual * force, moment], 3)


def _residual_diagnostic(estimate: Estimate, c: int, share: float) -> Diagnostic:
    """Diagnostic of a poorly explained channel: wrong scale factor, else large residual.

    A wrong scale factor differs from 1 by over 10 %, with a squared correlation above 0.9.
    """
    normal, right, square = estimate.normal_equations.of_channel(c)
    predicted = float(estimate.values @ normal @ estimate.values)
    product = float(right @ estimate.values)
    factor = product / predicted if predicted > 0 else 0.0
    label, method = estimate.label(c), estimate.method
    if (
        product**2 > THRESHOLDS.correlation * predicted * square
        and abs(factor - 1) > THRESHOLDS.factor_error
    ):
        causes = ["sign" if factor < 0 else "gain"]
        return make_diagnostic(
            "channel.scale", label, share, method=method, causes=causes, factor=factor
        )
    return make_diagnostic(
        "channel.residual", label, share, method=method, causes=MISFIT_CAUSES[method]
    )


def _consistency_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Diagnostic of minimal parameters that no rigid bodies can have (`rigid_body_test`)."""
    test = rigid_body_test(estimate)
    if not test.impossible:
        return
    base = estimate.base
    largest_gaps = np.argsort(test.gap)[::-1][:3]
    yield make_diagnostic(
        "estimate.impossible",
        f"the {estimate.method} estimate",
        test.distance,
        method=estimate.method,
        causes=("sign", *MISFIT_CAUSES[estimate.method]),
        worst=", ".join(
            f"{base.names[k]} = {base.values[k]:.3g} where {test.nearest[k]:.3g} is possible"
            for k in largest_gaps
        ),
    )
