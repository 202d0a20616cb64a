"""Torques held against what the plate's estimate predicts: estimates of one recording compared."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose, ordered
from testbed.core.estimation.estimate import METHODS, Estimate
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.parameters.minimal_set import selection
from testbed.core.robot.shafts import shares

UNITS = {
    1e3: "torques-in-n-mm",
    1e-3: "moments-in-n-mm",
    0.7376: "torques-in-lbf-ft",
    1.3558: "wrench-in-lbf-ft",
    4.4482: "wrench-in-lbf",
    0.2248: "torques-in-lbf",
    9.8067: "wrench-in-kgf",
    0.10197: "torques-in-kgf-m",
    180 / np.pi: "degrees",
}
"""What a factor may mean: codes of causes."""


class TorqueFactor(NamedTuple):
    """Ratio of a joint's reported torque to the predicted one.

    Attributes:
        value: The ratio.
        sigma: Its standard deviation: of noise in the torque, and of what is predicted at worst.
    """

    value: float
    sigma: float


def cross_check(external: Estimate, internal: Estimate) -> Iterator[Diagnostic]:
    """Joints whose torques are not what the plate's estimate predicts.

    A factor near one says something of the drive only where nothing is wrong with the plate.

    Args:
        external: From the plate.
        internal: From the torques of the same recording, with the same zeros and gravity.
    """
    try:
        s = selection(internal.minimal, external.minimal)
    except ValueError:  # not of one robot, gravity and list of zeros
        return
    known, spread = s @ external.base.values, s @ external.base.covariance @ s.T
    for joint, name in enumerate(internal.joints):
        factor, subject = (
            torque_factor(internal, known, spread, joint),
            f"the torque of '{name}'",
        )
        if factor is None:
            continue
        value, sigma = factor
        # between these factors it is a torque constant that is wrong
        if not 0.77 < value < 1.3:
            # relative difference up to which factors are the same
            units = [
                cause
                for unit, cause in UNITS.items()
                if abs(abs(value) / unit - 1) < 0.15
            ]
            causes = ["sign"] * (value < 0) + [*units, "motor-side", "exchanged"]
            yield diagnose("torque.scale", subject, value, sigma=sigma, causes=causes)
        # by so much it differs from one without a word, and by as many sigmas it may be noise
        elif not external.doubtful and abs(value - 1) > max(0.02, 8.0 * sigma):
            yield diagnose(
                "torque.constant",
                subject,
                value,
                sigma=sigma,
                significance=abs(value - 1) / max(sigma, TINY),
                method="internal",
            )


def diagnostics_of(estimates: Iterable[Estimate]) -> tuple[Diagnostic, ...]:
    """What estimates of one recording say of it, each alone and compared with each other.

    Args:
        estimates: By both methods or by one.
    """
    by_method = {estimate.method: estimate for estimate in estimates}
    diagnostics = [
        each for estimate in by_method.values() for each in estimate.diagnostics
    ]
    if len(by_method) == len(METHODS):
        diagnostics += cross_check(by_method["external"], by_method["internal"])
    return ordered(diagnostics)


def torque_factor(
    internal: Estimate, known: Array, spread: Array, joint: int
) -> TorqueFactor | None:
    """Factor between a joint's reported torque and the predicted one.

    Args:
        internal: From the torques.
        known: The dynamic minimal parameters from elsewhere, (N_d,).
        spread: Their covariance, (N_d, N_d).
        joint: Index of the joint.

    Returns:
        None where the joint's torque does not say: it is mostly friction, rotor or noise, or
        it is not predicted well.
    """
    equations = internal.measured_equations or internal.normal_equations
    normal, right, square = equations.of_channel(joint)
    count = internal.minimal.count
    own = [k for k, body in enumerate(internal.minimal.axial) if body == joint]
    if internal.drives is not None:
        turn = shares(internal.drives.tree)[:, joint]
        own += [
            count + k
            for k, term in enumerate(internal.drives.terms)
            if turn[term.joint]
        ]
    predicted = np.zeros(len(right))
    predicted[:count] = known
    predicted[own] = 0.0  # a rotor may be part of it
    size, both = float(predicted @ normal @ predicted), float(right @ predicted)
    across = np.column_stack([normal[own] @ predicted, right[own]])
    shared = np.linalg.lstsq(normal[np.ix_(own, own)], across, rcond=1e-12)[0]
    # what friction does not explain, of the predicted and of the reported torque
    beside = np.array([[size, both], [both, square]]) - across.T @ shared
    (alone, both), (_, residual) = beside.tolist()
    # part of the predicted torque, in power, that a rotor, friction or an offset cannot replace
    if alone <= 1e-3 * size:
        return None
    factor = both / alone
    residual -= factor**2 * alone
    error = float(np.sum(normal[:count, :count] * spread))
    # in power, ten times the unexplained rest of a torque must follow the predicted one, which is
    # known well enough up to this relative error
    if factor**2 * alone <= 10.0 * residual or error >= 0.05**2 * alone:
        return None
    rows = max(float(equations.used[joint]), 1.0)
    return TorqueFactor(
        factor, float(np.sqrt((max(residual, 0.0) / rows + error) / alone))
    )
