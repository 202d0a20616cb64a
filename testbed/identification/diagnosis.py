"""What a careful reader of an estimate should know: wrong data say so themselves.

Nothing here needs statistics of the residuals, and nothing looks at the masses of the model
file: data are held against themselves, against limits, and against what rigid bodies can be.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import pedestal_wrench
from testbed.errors import ENOUGH, few, plural
from testbed.identification.estimate import Estimate, Method
from testbed.identification.finding import Finding, components
from testbed.identification.noise_warnings import noise_warnings
from testbed.identification.raw_signals import signal_findings
from testbed.identification.rigid_bodies import possibility
from testbed.identification.survey import Survey
from testbed.identification.trace_findings import noisy, trace_findings
from testbed.robot.transmission import shares
from testbed.robot.tree import Tree
from testbed.stages import stage

SIGNIFICANT = 0.3
"""Relative sigma above which a parameter is reported as poorly determined."""

SMALL = 0.01
"""Sigma, relative to the largest value of the same unit, below which a parameter is known well
enough, however small it is."""

ILL_CONDITIONED = 1e3
"""Condition of the scaled equations above which the estimate is reported as doubtful."""

SURE = 5.0
"""Sigmas beyond which a wrong sign is no noise."""

NOTICEABLE = 0.02
"""Part of a torque's rms for which negative friction must account to be no model error."""

UNLIKE = 0.5
"""Relative difference of two weights that should be the same."""

UNEXPLAINED = 0.2
"""Residual of a channel, relative to its signal and to like signals, that is too large."""

WORSE = 1.2
"""Relative residual of a prediction that is worse than none."""

OUTLIER = 5.0
"""Times the least residual of like channels: noise differs by less."""

NEGLIGIBLE = 0.01
"""Part of the weight's moment at the robot's reach that noise may be."""

ALIKE = 0.9
"""Squared correlation of a signal and its prediction that differ by a factor only."""

DIFFERENT = 0.1
"""How far that factor must be from one to be the cause."""

UNLIKELY = 4.0
"""Sigmas by which torques are late that are not late by chance: one in 15000 is."""

UNTIMELY = ("friction that is not among the terms", "a sampling rate that is not the stated one")
"""What looks like torques that are late."""

FEW = 2
"""Values for each unknown below which standard deviations do not hold."""

OTHER_CAUSES: Mapping[Method, tuple[str, ...]] = {
    "external": (
        "exchanged channels or encoders",
        "moments in N mm or about another point than the model's origin",
        "a turned plate",
        "wrong gravity",
    ),
    "internal": (
        "exchanged torques or encoders",
        "an encoder of opposite sign or in degrees",
        "N mm instead of N m",
        "wrong gravity",
    ),
}
"""Of signals that do not follow their predictions."""


@stage("what the residuals say")
def findings(estimate: Estimate, tree: Tree, survey: Survey, tare: Array) -> tuple[Finding, ...]:
    """What is wrong with a recording, as far as one method's data show it.

    Args:
        estimate: Made from it.
        tree: The robot under the recording's gravity: the joints' limits are read, and the
            pedestal, which is known.
        survey: Some of the raw samples.
        tare: What was taken off the wrench, (6,) [N, N m].
    """
    found = [*_few(estimate), *signal_findings(estimate, tree, survey)]
    negative: list[Finding] = []
    if estimate.method == "external":
        found += _tare(tree, tare)
        negative += _mass(estimate, tree, survey.measured, tare)
    else:
        negative += _friction(estimate)
        found += _late(estimate)
    found += [*negative, *trace_findings(estimate), *_residuals(estimate, tree)]
    if not negative:
        found += _impossible(estimate)
    return tuple(found)


def quality_warnings(estimate: Estimate) -> list[str]:
    """Ill-conditioned equations, and parameters that the data hardly determine, a line each."""
    warnings = []
    if estimate.condition > ILL_CONDITIONED:
        warnings.append(
            f"the {estimate.method} equations are ill-conditioned ({estimate.condition:.1e}): "
            "errors of the instrument grow by up to that factor"
        )
    warnings += noise_warnings(estimate)
    base = estimate.base
    largest: dict[str, float] = {}
    for unit, value in zip(base.units, base.values, strict=True):
        largest[unit] = max(largest.get(unit, 0.0), abs(value))
    loose = [
        f"{name} ({value:.3g} +- {sigma:.2g})"
        for name, unit, value, sigma in zip(
            base.names, base.units, base.values, base.sigma, strict=True
        )
        if sigma > SIGNIFICANT * abs(value) and SMALL * largest[unit] < sigma < np.inf
    ]
    if loose:
        warnings.append(f"the {estimate.method} estimate leaves poorly determined: {few(loose)}")
    return warnings


def _few(estimate: Estimate) -> Iterator[Finding]:
    """Little more values than unknowns."""
    unknowns, values = len(estimate.values) + len(estimate.nuisances), sum(estimate.samples)
    if values < FEW * unknowns:
        yield Finding(
            f"the {estimate.method} estimate",
            f"is of {plural(values, 'value')} for {plural(unknowns, 'unknown')}: standard "
            "deviations do not hold",
            values / unknowns,
            ("a recording that is too short",),
            f"record {ENOUGH * unknowns / values:.2g} times as long, and let no motion repeat "
            "within that time",
            code="few-values",
            method=estimate.method,
        )


def _tare(tree: Tree, tare: Array) -> Iterator[Finding]:
    """A tare that is not the weight of the model's pedestal."""
    expected = pedestal_wrench(tree)[:3]
    size = max(np.linalg.norm(expected), np.linalg.norm(tare[:3]))
    gap = float(np.linalg.norm(tare[:3] - expected))
    if expected.any() and gap > UNLIKE * size:
        causes = ["a tare that was never taken" if not tare.any() else "a tare in other units"]
        if tare[:3] @ expected < 0:
            causes.insert(0, "the opposite sign of tare and wrench (they are the bedplate's)")
        yield Finding(
            "the tare's force",
            f"is {components(tare[:3])} N, the model's pedestal weighs {components(expected)} N",
            gap,
            (*causes, "another pedestal or gravity than the model's"),
            "state the pedestal's static wrench, or leave the tare out to take the model's",
            code="tare",
            method="external",
            alone=True,
        )


def _mass(estimate: Estimate, tree: Tree, wrench: Array, tare: Array) -> Iterator[Finding]:
    """A total mass that is negative, or not what the plate carries on average."""
    trunks = np.zeros(10 * tree.n)
    trunks[[10 * j for j in tree.children(-1)]] = 1.0
    base, gravity = estimate.base, float(np.linalg.norm(tree.gravity))
    form = np.linalg.lstsq(base.matrix.T, trunks, rcond=None)[0]
    if gravity == 0 or np.abs(base.matrix.T @ form - trunks).max() > 1e-9:
        return
    mass = float(form @ base.values)
    sigma = float(np.sqrt(form @ base.covariance @ form))
    up = -tree.gravity / gravity
    carried = float(np.mean(wrench[:, :3] @ up)) / gravity
    if mass < -SURE * sigma and mass < -NOTICEABLE * abs(carried):
        reversed_tare = tare[:3] @ up < 0
        causes = (
            "the wrench (of the bedplate on the robot) has the opposite sign",
            "the tare is not the pedestal's, or in other units than the wrench",
            "exchanged channels",
            "wrong gravity",
        )
        yield Finding(
            "the robot's total mass",
            f"is negative: {mass:.4g} +- {sigma:.2g} kg",
            mass,
            causes if reversed_tare or not tare.any() else (causes[1], causes[0], *causes[2:]),
            "check the signs and units of wrench and tare",
            code="negative-mass",
            method="external",
            alone=True,
        )
    elif abs(mass - carried) > UNLIKE * max(abs(mass), abs(carried)) + SURE * sigma:
        yield Finding(
            "the robot's total mass",
            f"is {mass:.4g} kg, but the plate carries {carried:.4g} kg on average",
            mass - carried,
            ("wrong gravity", "a drift of the plate", "exchanged channels"),
            "weigh the robot at rest",
            code="other-mass",
            method="external",
            alone=True,
        )


def _friction(estimate: Estimate) -> Iterator[Finding]:
    """Friction that would drive the joint."""
    equations, drives = estimate.normal_equations, estimate.drives
    if drives is None:
        return
    most = np.argmax(np.abs(shares(drives.tree)), axis=1)  # the joint that feels a place most
    for k, term in enumerate(estimate.joint_terms, start=estimate.minimal.count):
        place = drives.terms[k - estimate.minimal.count].joint
        normal, _, square = equations.of_channel(int(most[place]))
        torque = abs(term.value) * np.sqrt(normal[k, k])
        sure = term.value < -SURE * term.sigma and torque > NOTICEABLE * np.sqrt(square)
        if term.law.resists and sure:
            yield Finding(
                f"the friction {term.name}",
                f"is negative ({term.value:.4g} +- {term.sigma:.2g} {term.unit})",
                term.value,
                ("the sign of the joint's torque or encoder", "exchanged joints", "late torques"),
                "check each torque against its joint's velocity",
                code="negative-friction",
                method="internal",
            )


def _late(estimate: Estimate) -> Iterator[Finding]:
    """Torques that follow the motion, or go before it."""
    found = None if estimate.noise is None else estimate.noise.lateness
    if found is None or abs(found.z) < UNLIKELY or not noisy(estimate):
        return
    late, early = "torques that are late", "encoders that are late"
    yield Finding(
        "the joint torques",
        f"are {'behind' if found.z > 0 else 'ahead of'} the motion, by "
        f"{1e3 * abs(found.delay):.2g} ms at least ({abs(found.z):.0f} sigma)",
        found.delay,
        (late if found.z > 0 else early, *UNTIMELY),
        "record torques and encoders by one clock, and look at the drives' filters",
        code="late-torques",
        method="internal",
        support=abs(found.z),
    )


def _residuals(estimate: Estimate, tree: Tree) -> Iterator[Finding]:
    """Channels that the model explains poorly, and not because there is little to explain."""
    large = _large(estimate, tree)
    for c, (share, residual) in enumerate(
        zip(estimate.relative_residual, estimate.residual, strict=True)
    ):
        like = [unit == estimate.channel_units[c] for unit in estimate.channel_units]
        apart = residual > OUTLIER * estimate.residual[like].min()
        wrong = share > WORSE or (share > UNEXPLAINED and apart)
        if (wrong and estimate.matters[c]) or (share > UNEXPLAINED and residual > large[c]):
            yield Finding(
                estimate.label(c),
                f"is explained poorly (the residual is {share:.0%} of the signal)",
                float(share),
                _causes(estimate, c),
                "plot it beside its prediction (`testbed view`)",
                code="residual",
                method=estimate.method,
            )


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
    moment = max(UNEXPLAINED * moment, NEGLIGIBLE * reach * force)
    return np.repeat([UNEXPLAINED * force, moment], 3)


def _causes(estimate: Estimate, c: int) -> tuple[str, ...]:
    """The likeliest first, by how the measurement follows its prediction."""
    normal, right, square = estimate.normal_equations.of_channel(c)
    predicted = float(estimate.values @ normal @ estimate.values)
    together = float(right @ estimate.values)
    factor = together / predicted if predicted > 0 else 0.0
    if together**2 > ALIKE * predicted * square and abs(factor - 1) > DIFFERENT:
        first = "the opposite sign" if factor < 0 else "another unit or gain"
        return (f"{first} (it is {factor:.3g} times its prediction)",)
    return OTHER_CAUSES[estimate.method]


def _impossible(estimate: Estimate) -> Iterator[Finding]:
    """Minimal parameters that no rigid bodies have."""
    found = possibility(estimate)
    if not found.impossible:
        return
    base = estimate.base
    worst = np.argsort(found.gap)[::-1][:3]
    told = ", ".join(
        f"{base.names[k]} = {base.values[k]:.3g} where {found.nearest[k]:.3g} is possible"
        for k in worst
    )
    yield Finding(
        f"the {estimate.method} estimate",
        f"is of no rigid bodies, by {found.distance:.0f} sigma ({told})",
        found.distance,
        ("the sign of a channel or encoder", *OTHER_CAUSES[estimate.method]),
        "check signs, units and order of the channels",
        code="no-rigid-bodies",
        method=estimate.method,
    )
