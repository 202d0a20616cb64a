"""What data show of their own faults.

Nothing here needs statistics of the residuals, and nothing looks at the masses of the model
file: data are compared with themselves, with limits, and with what rigid bodies can be.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ENOUGH, SettingsError, components, few
from testbed.core.base.stages import stage
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.estimation.diagnostics.residuals import (
    noise_diagnostics,
)
from testbed.core.estimation.diagnostics.rigid_bodies import SIGMAS, rigid_body_test
from testbed.core.estimation.estimate import Estimate, Method
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import total_mass
from testbed.core.estimation.regression.passes import HELD, Repeats, Survey
from testbed.core.recordings.views import pedestal_said
from testbed.core.robot.shafts import shares
from testbed.core.robot.tree import Joint, Tree


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the diagnostics.

    Attributes:
        relative_sigma: Of a parameter, beyond which it is poorly determined.
        small_sigma: Of the largest value of the same unit, below which a parameter is well known.
        condition: Of the scaled equations, beyond which an estimate is doubtful.
        negative_share: Of a torque's rms, or of a weight, from which a negative one is an error.
        weight_difference: Relative, of two weights that should be the same.
        residual: Of a channel, relative to its signal and to like signals.
        useless_residual: Relative residual of a prediction that is worse than none.
        outlier: Times the least residual of like channels; noise differs by less.
        noise_share: Of the weight's moment at the robot's reach, that noise may be.
        correlation: Squared, of a signal and a prediction that differ by a factor only.
        factor_error: Difference of that factor from one, from which it is the cause.
        values_an_unknown: Fewest for which standard deviations hold.
        outside_range: Part of a joint's range by which encoders may leave it.
        effort: Times the motor's greatest effort that no torque reaches.
        extreme_share: Of the samples at one extreme value, that is saturation.
        extreme_ratio: Of samples at the extreme value to those at the next, at a stop.
        repeats: Repeated samples that may be chance.
        repeats_ratio: Of samples that repeat in all channels to chance, beyond which it is none.
    """

    relative_sigma: float = 0.3
    small_sigma: float = 0.01
    condition: float = 1e3
    negative_share: float = 0.02
    weight_difference: float = 0.5
    residual: float = 0.2
    useless_residual: float = 1.2
    outlier: float = 5.0
    noise_share: float = 0.01
    correlation: float = 0.9
    factor_error: float = 0.1
    values_an_unknown: float = 2
    outside_range: float = 0.02
    effort: float = 2.0
    extreme_share: float = 0.01
    extreme_ratio: float = 5.0
    repeats: float = 5
    repeats_ratio: float = 10.0


THRESHOLDS = Thresholds()

STILL = {"revolute": 0.02, "prismatic": 0.002}
"""Ranges within which a joint hardly moves [rad, m]."""

OTHER_CAUSES: Mapping[Method, tuple[str, ...]] = {
    "external": ("exchanged", "moments", "pose", "gravity"),
    "internal": ("exchanged", "encoder-sign", "torques-in-n-mm", "gravity"),
}
"""Of signals that do not follow their predictions."""


@stage("what the residuals say")
def diagnostics(
    estimate: Estimate, problem: Problem, survey: Survey
) -> tuple[Diagnostic, ...]:
    """Faults of a recording, as far as one method's data show them.

    Args:
        estimate: Made from it.
        problem: Of the tree, the joints' limits and the pedestal are read.
        survey: Some of the raw samples.
    """
    tree, tare = problem.tree, problem.tare
    faults = [*_few(estimate), *_encoders(tree, survey.position)]
    faults += [
        *_channels(estimate, survey.measured, problem),
        *_repeated(estimate, survey.repeats),
    ]
    negative: list[Diagnostic] = []
    if estimate.method == "external":
        # else a tare that is not its weight is odd
        if not pedestal_said(problem.source):
            faults += _tare(tree, tare)
        negative += _mass(estimate, tree, survey.measured, tare)
    else:
        faults += _efforts(tree, survey.measured)
        negative += _friction(estimate)
    faults += [*negative, *_residuals(estimate, tree)]
    if not negative:
        faults += _impossible(estimate)
    return tuple(faults)


def quality(estimate: Estimate) -> Iterator[Diagnostic]:
    """Ill-conditioned equations, what noise does, and parameters of large standard deviations.

    Args:
        estimate: With what its noise is like.
    """
    subject = f"the {estimate.method} estimate"
    if estimate.condition > THRESHOLDS.condition:
        yield diagnose(
            "estimate.ill-conditioned",
            subject,
            estimate.condition,
            method=estimate.method,
        )
    yield from noise_diagnostics(estimate)
    base = estimate.base
    largest: dict[str, float] = {}
    for unit, value in zip(base.units, base.values, strict=True):
        largest[unit] = max(largest.get(unit, 0.0), abs(value))
    loose = [
        f"{name} ({value:.3g} +- {sigma:.2g})"
        for name, unit, value, sigma in zip(
            base.names, base.units, base.values, base.sigma, strict=True
        )
        if sigma > THRESHOLDS.relative_sigma * abs(value)
        and THRESHOLDS.small_sigma * largest[unit] < sigma < np.inf
    ]
    if loose:
        yield diagnose(
            "estimate.uncertain", subject, method=estimate.method, parameters=few(loose)
        )


def _few(estimate: Estimate) -> Iterator[Diagnostic]:
    """Little more values than unknowns."""
    unknowns, values = (
        len(estimate.values) + len(estimate.nuisances),
        sum(estimate.samples),
    )
    if values < THRESHOLDS.values_an_unknown * unknowns:
        yield diagnose(
            "estimate.few-values",
            f"the {estimate.method} estimate",
            values / unknowns,
            method=estimate.method,
            values=values,
            unknowns=unknowns,
            times=ENOUGH * unknowns / values,
        )


def _repeated(estimate: Estimate, repeats: Repeats) -> Iterator[Diagnostic]:
    """Samples in which channels, or poses, are all what they were before, too often for chance."""
    if repeats.held > HELD * repeats.pairs:
        yield diagnose("encoder.held", "the poses", repeats.held / repeats.pairs)
    if not repeats.steps or repeats.together < THRESHOLDS.repeats:
        return
    share = repeats.together / repeats.steps
    by_chance = float(np.prod(repeats.channels / repeats.steps))
    if share > THRESHOLDS.repeats_ratio * by_chance:
        yield diagnose(
            "channel.repeated",
            "the plate's samples"
            if estimate.method == "external"
            else "the torques' samples",
            share,
            method=estimate.method,
            count=repeats.together,
            steps=repeats.steps,
        )


def _encoders(tree: Tree, position: Array) -> Iterator[Diagnostic]:
    """Positions that the joint cannot have, or that hardly change."""
    for joint, q in zip(tree.joints, position.T, strict=True):
        unit, subject = (
            "rad" if joint.revolute else "m",
            f"the encoder of '{joint.name}'",
        )
        low, high = float(q.min()), float(q.max())
        least, greatest = joint.position_range
        room = (
            THRESHOLDS.outside_range * (greatest - least)
            if np.isfinite(greatest - least)
            else 0.0
        )
        if low < least - room or high > greatest + room:
            yield diagnose(
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
        elif high - low < STILL[joint.kind]:
            yield diagnose("encoder.still", subject, high - low, unit=unit)


def _encoder_causes(joint: Joint, low: float, high: float) -> list[str]:
    """The likeliest first, by what would bring the positions into the joint's range."""
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


def _channels(
    estimate: Estimate, measured: Array, problem: Problem
) -> Iterator[Diagnostic]:
    """Signals that stop at a value, or never leave it, and count nevertheless."""
    named = {fault.name for fault in problem.faults}
    for c, values in enumerate(measured.T):
        if estimate.channels[c] in named:
            continue
        unit, label, method = (
            estimate.channel_units[c],
            estimate.label(c),
            estimate.method,
        )
        if np.ptp(values) == 0:
            if estimate.matters[c]:
                yield diagnose(
                    "channel.constant", label, values[0], method=method, unit=unit
                )
            continue
        share, end = max(
            (_piled(values, float(e)), float(e)) for e in (values.max(), values.min())
        )
        if share > THRESHOLDS.extreme_share:
            yield diagnose(
                "channel.saturated", label, share, method=method, end=end, unit=unit
            )


def _piled(values: Array, end: float) -> float:
    """Part of the samples at an extreme value, if that is a stop and no crest."""
    distance = np.abs(values - end)
    away = distance[distance > 0]
    beside = int((away == away.min()).sum())
    here = len(values) - len(away)
    return here / len(values) if here > THRESHOLDS.extreme_ratio * beside else 0.0


def _efforts(tree: Tree, torque: Array) -> Iterator[Diagnostic]:
    """Torques that no motor of the robot has."""
    for joint, values in zip(tree.joints, torque.T, strict=True):
        most = float(np.abs(values).max())
        if most > THRESHOLDS.effort * joint.max_effort:
            causes = ["exchanged", "raw-units"]
            yield diagnose(
                "torque.effort",
                f"the torque of '{joint.name}'",
                most / joint.max_effort,
                method="internal",
                causes=["torques-in-n-mm"] * joint.revolute + causes,
                most=most,
                effort=joint.max_effort,
                unit="N m" if joint.revolute else "N",
            )


def _tare(tree: Tree, tare: Array) -> Iterator[Diagnostic]:
    """A tare that is not the weight of the model's pedestal."""
    expected = pedestal_wrench(tree)[:3]
    size = max(np.linalg.norm(expected), np.linalg.norm(tare[:3]))
    gap = float(np.linalg.norm(tare[:3] - expected))
    if expected.any() and gap > THRESHOLDS.weight_difference * size:
        causes = ["units-of-tare" if tare.any() else "no-tare", "other-pedestal"]
        yield diagnose(
            "plate.tare",
            "the tare's force",
            gap,
            method="external",
            causes=["sign-of-tare"] * bool(tare[:3] @ expected < 0) + causes,
            force=components(tare[:3]),
            expected=components(expected),
        )


def _mass(
    estimate: Estimate, tree: Tree, wrench: Array, tare: Array
) -> Iterator[Diagnostic]:
    """A total mass that is negative, or not what the plate carries on average."""
    base, gravity = estimate.base, float(np.linalg.norm(tree.gravity))
    try:
        form = total_mass(tree, estimate.minimal)
    except SettingsError:  # no minimal parameters say it
        return
    if gravity == 0:
        return
    mass = float(form @ base.values)
    sigma = float(np.sqrt(form @ base.covariance @ form))
    up = -tree.gravity / gravity
    carried = float(np.mean(wrench[:, :3] @ up)) / gravity
    subject = "the robot's total mass"
    if mass < -SIGMAS * sigma and mass < -THRESHOLDS.negative_share * abs(carried):
        first = ["sign-of-wrench", "other-tare"]
        if tare.any() and not tare[:3] @ up < 0:
            first = first[::-1]
        causes = (*first, "exchanged", "gravity")
        yield diagnose(
            "plate.negative-mass",
            subject,
            mass,
            sigma=sigma,
            method="external",
            causes=causes,
        )
    elif (
        abs(mass - carried)
        > THRESHOLDS.weight_difference * max(abs(mass), abs(carried)) + SIGMAS * sigma
    ):
        yield diagnose(
            "plate.mass",
            subject,
            mass - carried,
            sigma=sigma,
            method="external",
            mass=mass,
            carried=carried,
        )


def _friction(estimate: Estimate) -> Iterator[Diagnostic]:
    """Friction that would drive the joint."""
    equations, drives = estimate.normal_equations, estimate.drives
    if drives is None:
        return
    # the joint that feels a place most
    most = np.argmax(np.abs(shares(drives.tree)), axis=1)
    for k, term in enumerate(estimate.joint_terms, start=estimate.minimal.count):
        place = drives.terms[k - estimate.minimal.count].joint
        normal, _, square = equations.of_channel(int(most[place]))
        torque = abs(term.value) * np.sqrt(normal[k, k])
        sure = (
            term.value < -SIGMAS * term.sigma
            and torque > THRESHOLDS.negative_share * np.sqrt(square)
        )
        if term.law.resists and sure:
            yield diagnose(
                "friction.negative",
                f"the friction {term.name}",
                term.value,
                sigma=term.sigma,
                method="internal",
                unit=term.unit,
            )


def _residuals(estimate: Estimate, tree: Tree) -> Iterator[Diagnostic]:
    """Channels that the model explains poorly, and not because there is little to explain."""
    large = _large(estimate, tree)
    for c, (share, residual) in enumerate(
        zip(estimate.relative_residual, estimate.residual, strict=True)
    ):
        like = [unit == estimate.channel_units[c] for unit in estimate.channel_units]
        apart = residual > THRESHOLDS.outlier * estimate.residual[like].min()
        wrong = share > THRESHOLDS.useless_residual or (
            share > THRESHOLDS.residual and apart
        )
        if (wrong and estimate.matters[c]) or (
            share > THRESHOLDS.residual and residual > large[c]
        ):
            yield _residual(estimate, c, float(share))


def _large(estimate: Estimate, tree: Tree) -> Array:
    """Residuals that are too large beside like channels' signals, (C,) [N, N m].

    The weight is among the plate's forces, and all moments could be less than its moment. Joint
    torques have no such measure: where all of them are small, noise may be most of them.
    """
    rms = estimate.normal_equations.rms
    if estimate.method == "internal":
        return np.full(len(rms), np.inf)
    force, moment = float(rms[:3].max()), float(rms[3:].max())
    reach = sum(float(np.linalg.norm(joint.offset)) for joint in tree.joints)
    moment = max(THRESHOLDS.residual * moment, THRESHOLDS.noise_share * reach * force)
    return np.repeat([THRESHOLDS.residual * force, moment], 3)


def _residual(estimate: Estimate, c: int, share: float) -> Diagnostic:
    """By how the measurement follows its prediction: up to a factor, or not at all."""
    normal, right, square = estimate.normal_equations.of_channel(c)
    predicted = float(estimate.values @ normal @ estimate.values)
    together = float(right @ estimate.values)
    factor = together / predicted if predicted > 0 else 0.0
    label, method = estimate.label(c), estimate.method
    if (
        together**2 > THRESHOLDS.correlation * predicted * square
        and abs(factor - 1) > THRESHOLDS.factor_error
    ):
        causes = ["sign" if factor < 0 else "gain"]
        return diagnose(
            "channel.scale", label, share, method=method, causes=causes, factor=factor
        )
    return diagnose(
        "channel.residual", label, share, method=method, causes=OTHER_CAUSES[method]
    )


def _impossible(estimate: Estimate) -> Iterator[Diagnostic]:
    """Minimal parameters that no rigid bodies have."""
    test = rigid_body_test(estimate)
    if not test.impossible:
        return
    base = estimate.base
    worst = np.argsort(test.gap)[::-1][:3]
    yield diagnose(
        "estimate.impossible",
        f"the {estimate.method} estimate",
        test.distance,
        method=estimate.method,
        causes=("sign", *OTHER_CAUSES[estimate.method]),
        worst=", ".join(
            f"{base.names[k]} = {base.values[k]:.3g} where {test.nearest[k]:.3g} is possible"
            for k in worst
        ),
    )
