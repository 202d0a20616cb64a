"""The two methods held against each other: torques that the plate's estimate foretells.

The bedplate's parameters contain those of the joint torques (delta_d = S delta_r). What they
foretell of a joint's torque and what its drive reports differ by friction, a rotor, an
offset; beside these the drive's report must be the foretold torque times one.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from testbed.arrays import Array
from testbed.identification.estimate import METHODS, Estimate
from testbed.identification.finding import Finding
from testbed.parameters.minimal_set import selection
from testbed.robot.transmission import shares

LEAST, MOST = 0.77, 1.3
"""Factors between which it is a torque constant that is wrong."""

OFF = 0.02
"""Part by which a factor differs from one without a word."""

SURE = 8.0
"""Sigmas within which it may be noise."""

CLEAR = 10.0
"""Times the unexplained rest of a torque, in power, that must follow the foretold one."""

KNOWN = 0.05
"""Relative error up to which the foretold torque is known well enough."""

TINY = float(np.finfo(float).tiny)
"""Against division by nothing."""

APART = 1e-3
"""Part of the foretold torque, in power, that a rotor, friction or an offset cannot replace."""

UNITS = {
    1e3: "torques in N mm",
    1e-3: "moments of the plate in N mm",
    0.7376: "torques in lbf ft",
    1.3558: "a wrench in lbf and lbf ft",
    4.4482: "a wrench in lbf",
    0.2248: "torques in units of lbf",
    9.8067: "a wrench in kgf",
    0.10197: "torques in kgf m",
    180 / np.pi: "encoders in degrees",
}
"""What a factor may mean."""

ALIKE = 0.15
"""Relative difference up to which factors are the same."""


class Factor(NamedTuple):
    """Between a torque as it is reported and as it is foretold.

    Attributes:
        value: The factor.
        sigma: Its standard deviation: of noise in the torque, and of what is foretold at worst.
    """

    value: float
    sigma: float


def cross_check(external: Estimate, internal: Estimate) -> tuple[Finding, ...]:
    """Joints whose torques are not what the plate's estimate foretells.

    A factor near one says something of the drive only where nothing is wrong with the plate.

    Args:
        external: From the plate.
        internal: From the torques of the same recording, with the same zeros and gravity.
    """
    try:
        s = selection(internal.minimal, external.minimal)
    except ValueError:  # not of one robot, gravity and list of zeros
        return ()
    known, spread = s @ external.base.values, s @ external.base.covariance @ s.T
    found = []
    for joint, name in enumerate(internal.joints):
        factor = torque_factor(internal, known, spread, joint)
        if factor is None:
            continue
        if not LEAST < factor.value < MOST:
            found.append(_finding(name, factor.value))
        elif not external.findings and abs(factor.value - 1) > max(OFF, SURE * factor.sigma):
            found.append(_off(name, factor))
    return tuple(found)


def findings_of(estimates: Iterable[Estimate]) -> list[Finding]:
    """What estimates of one recording say of it, each alone and against each other.

    Args:
        estimates: By both methods or by one.
    """
    by_method = {estimate.method: estimate for estimate in estimates}
    found = [each for estimate in by_method.values() for each in estimate.findings]
    if len(by_method) == len(METHODS):
        found += cross_check(by_method["external"], by_method["internal"])
    return found


def _finding(joint: str, factor: float) -> Finding:
    unit = [said for u, said in UNITS.items() if abs(abs(factor) / u - 1) < ALIKE]
    sign = [] if factor > 0 else ["the opposite sign of torque, encoder or wrench"]
    return Finding(
        f"the torque of '{joint}'",
        f"is {factor:.3g} times what the bedplate's estimate foretells",
        factor,
        (*sign, *unit, "torques on the motor's side of the gear", "exchanged joints or channels"),
        "trust neither estimate before they agree",
        code="torque-scale",
    )


def _off(joint: str, factor: Factor) -> Finding:
    return Finding(
        f"the torque of '{joint}'",
        f"is {factor.value:.3f} times what the bedplate's estimate foretells",
        factor.value,
        ("a torque constant that is off", "friction that is not among the terms", "late torques"),
        "take the bedplate's estimate, and let it find the constants: --set "
        "'identification.drives=\"given\"'",
        code="torque-constant",
        method="internal",
        support=abs(factor.value - 1) / max(factor.sigma, TINY),
    )


def torque_factor(internal: Estimate, known: Array, spread: Array, joint: int) -> Factor | None:
    """Factor between a joint's reported torque and the foretold one.

    Args:
        internal: From the torques.
        known: The dynamic minimal parameters from elsewhere, (N_d,).
        spread: Their covariance, (N_d, N_d).
        joint: Index of the joint.

    Returns:
        None where the joint's torque does not say: it is mostly friction, rotor or noise, or
        it is not foretold well.
    """
    normal, right, square = internal.normal_equations.of_channel(joint)
    count = internal.minimal.count
    own = [k for k, body in enumerate(internal.minimal.axial) if body == joint]
    if internal.drives is not None:
        turn = shares(internal.drives.tree)[:, joint]
        own += [count + k for k, term in enumerate(internal.drives.terms) if turn[term.joint]]
    foretold = np.zeros(len(right))
    foretold[:count] = known
    foretold[own] = 0.0  # a rotor may be part of it
    size = float(foretold @ normal @ foretold)
    among = normal[np.ix_(own, own)]
    shared = np.linalg.lstsq(among, normal[own] @ foretold, rcond=1e-12)[0]
    alone = size - float(foretold @ normal[own].T @ shared)  # what friction does not explain
    if alone <= APART * size:
        return None
    factor = (float(right @ foretold) - float(right[own] @ shared)) / alone
    theirs = float(right[own] @ np.linalg.lstsq(among, right[own], rcond=1e-12)[0])
    left = square - theirs - factor**2 * alone
    error = float(np.sum(normal[:count, :count] * spread))
    if factor**2 * alone <= CLEAR * left or error >= KNOWN**2 * alone:
        return None
    rows = max(float(internal.normal_equations.used[joint]), 1.0)
    return Factor(factor, float(np.sqrt((max(left, 0.0) / rows + error) / alone)))
