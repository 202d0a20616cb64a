"""Comparison of measured joint torques with predictions from the plate's estimate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import (
    Diagnostic,
    make_diagnostic,
    ordered_diagnostics,
)
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE
from testbed.core.parameters.minimal_set import selection
from testbed.core.parameters.rules import SIGNALS
from testbed.core.robot.shafts import transmission_matrix

UNIT_FACTORS = {
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
"""Cause of a torque scale factor, by factor: a wrong unit."""


class TorqueFactor(NamedTuple):
    """Ratio of a joint's measured torque to the predicted torque.

    Attributes:
        value: Ratio.
        sigma: Standard deviation of the ratio, from the noise of the torque and an upper bound on
            the error of the prediction.
    """

    value: float
    sigma: float


def torque_scale_diagnostics(
    wrench_estimate: Estimate, torque_estimate: Estimate
) -> Iterator[Diagnostic]:
    """Diagnostics of joints whose torques differ from the plate's prediction by a factor.

    Factors outside 0.77 to 1.3, as caused by a wrong unit, are reported as "torque.scale". Other
    factors are reported as "torque.constant" if they differ from one by more than 2 % and 8 sigma
    and the plate's estimate has no errors. No diagnostics are given for estimates of different
    robots, gravities or zeros.

    Args:
        wrench_estimate: Estimate from the wrench.
        torque_estimate: Estimate from the torques of the same recording.
    """
    try:
        selection_matrix = selection(torque_estimate.minimal, wrench_estimate.minimal)
    except ValueError:  # different robot, gravity or list of zeros
        return
    predicted_parameters, covariance = (
        selection_matrix @ wrench_estimate.base.values,
        selection_matrix @ wrench_estimate.base.covariance @ selection_matrix.T,
    )
    for joint, name in enumerate(torque_estimate.joints):
        factor, subject = (
            torque_factor(torque_estimate, predicted_parameters, covariance, joint),
            f"the torque of '{name}'",
        )
        if factor is None:
            continue
        value, sigma = factor
        # between these factors it is a torque constant that is wrong
        if not 0.77 < value < 1.3:
            # relative difference up to which factors are the same
            unit_causes = [
                cause
                for unit, cause in UNIT_FACTORS.items()
                if abs(abs(value) / unit - 1) < 0.15
            ]
            causes = ["sign"] * (value < 0) + [*unit_causes, "motor-side", "exchanged"]
            yield make_diagnostic(
                "torque.scale", subject, value, sigma=sigma, causes=causes
            )
        # smaller differences from one, absolute or in sigmas, are not reported
        elif not wrench_estimate.has_errors and abs(value - 1) > max(0.02, 8.0 * sigma):
            yield make_diagnostic(
                "torque.constant",
                subject,
                value,
                sigma=sigma,
                significance=abs(value - 1) / max(sigma, SMALLEST_POSITIVE),
                method="torque",
            )


def diagnostics_of_estimates(estimates: Iterable[Estimate]) -> tuple[Diagnostic, ...]:
    """Diagnostics of estimates of one recording, with the comparison of both methods.

    Args:
        estimates: Estimates by one method or by both.
    """
    by_method = {estimate.method: estimate for estimate in estimates}
    diagnostics = [
        diagnostic
        for estimate in by_method.values()
        for diagnostic in estimate.diagnostics
    ]
    if len(by_method) == len(SIGNALS):
        diagnostics += torque_scale_diagnostics(
            by_method["wrench"], by_method["torque"]
        )
    return ordered_diagnostics(diagnostics)


def torque_factor(
    torque_estimate: Estimate, parameters: Array, covariance: Array, joint: int
) -> TorqueFactor | None:
    """Factor between a joint's measured torque and the predicted torque.

    Terms of the joint itself (friction, rotor, offset, axial inertia) are first eliminated from
    both torques by least squares; the factor is the regression coefficient of the remainders.

    Args:
        torque_estimate: Estimate from the torques.
        parameters: Minimal parameters of the torques from another estimate, (N_d,).
        covariance: Covariance of these parameters, (N_d, N_d).
        joint: Index of the joint.

    Returns:
        Factor with sigma. None if, in terms of squares, the predicted remainder is below 1e-3 of
            the predicted torque, or the explained part of the measured remainder is below ten times
            the unexplained part, or if the relative error of the prediction exceeds 5 %.
    """
    equations = torque_estimate.measured_equations or torque_estimate.normal_equations
    normal, right, square = equations.of_channel(joint)
    count = torque_estimate.minimal.count
    joint_columns = [
        k for k, body in enumerate(torque_estimate.minimal.axial) if body == joint
    ]
    if torque_estimate.drives is not None:
        turn = transmission_matrix(torque_estimate.drives.tree)[:, joint]
        joint_columns += [
            count + k
            for k, term in enumerate(torque_estimate.drives.terms)
            if turn[term.joint]
        ]
    predicted = np.zeros(len(right))
    predicted[:count] = parameters
    predicted[joint_columns] = 0.0  # it may contain a rotor
    predicted_square, product = (
        float(predicted @ normal @ predicted),
        float(right @ predicted),
    )
    projections = np.column_stack(
        [normal[joint_columns] @ predicted, right[joint_columns]]
    )
    coefficients = np.linalg.lstsq(
        normal[np.ix_(joint_columns, joint_columns)], projections, rcond=1e-12
    )[0]
    # what friction does not explain, of the predicted and of the reported torque
    reduced = (
        np.array([[predicted_square, product], [product, square]])
        - projections.T @ coefficients
    )
    (reduced_square, product), (_, residual) = reduced.tolist()
    # part of the predicted torque, in power, that a rotor, friction or an offset cannot replace
    if reduced_square <= 1e-3 * predicted_square:
        return None
    factor = product / reduced_square
    residual -= factor**2 * reduced_square
    error = float(np.sum(normal[:count, :count] * covariance))
    # in power, ten times the unexplained rest of a torque must follow the predicted one, which is
    # known well enough up to this relative error
    if (
        factor**2 * reduced_square <= 10.0 * residual
        or error >= 0.05**2 * reduced_square
    ):
        return None
    rows = max(float(equations.used[joint]), 1.0)
    return TorqueFactor(
        factor, float(np.sqrt((max(residual, 0.0) / rows + error) / reduced_square))
    )
