"""Interpretations of a log with the torque of a spring or cable at one joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.importing.check.remedies import Hypothesis
from testbed.importing.check.torque_products import spring_torques
from testbed.importing.check.torque_readings import LogReading, TorqueCase

LOG_ODDS = -4.0
"""Log prior odds of a spring at one joint [nats]."""

MIN_EXPECTED_GAIN = 5.0
"""Least expected log evidence gain for a spring to be fitted [nats]."""


def spring_readings(case: TorqueCase, joints: Sequence[int]) -> Iterator[LogReading]:
    """Yield interpretations of the log with a spring at one joint, after a score test.

    A spring is fitted if the expected gain of log evidence exceeds `MIN_EXPECTED_GAIN`.

    Args:
        case: Joint torques of a log, with robot and prior.
        joints: Indices of the joints with usable torques.
    """
    expected_gains = _expected_gains(case)
    for joint in joints:
        if (
            expected_gains[joint] > MIN_EXPECTED_GAIN
            and joint not in case.spring_joints
        ):
            reading = replace(case, spring_joints=(*case.spring_joints, joint)).as_given
            hypothesis = Hypothesis("spring", (joint,))
            yield replace(
                reading,
                hypotheses=(hypothesis,),
                kind="spring",
                log_odds=LOG_ODDS,
            )


def _expected_gains(case: TorqueCase) -> Array:
    """First-order gain of log evidence if a spring is added at each joint, (n,) [nats]."""
    initial, products, unit = case.as_given, case.products, np.eye(case.tree.n)
    springs = spring_torques(case.signals, case.channel_rms).T * products.valid
    cross = (products.columns.transpose(0, 2, 1) @ springs[:, :, None])[:, :, 0]
    if products.gravity_columns.shape[2]:
        heavy = np.tensordot(products.gravity_columns, case.gravity, ([2], [0]))
        cross[:, : products.shared_count] += (springs[:, None] @ heavy)[:, 0]
    square = (springs**2).sum(axis=1)
    gradient, information = initial.evidence.additional_gradient(
        cross[:, :, None] * unit[:, None],
        square[:, None, None] * unit[:, :, None] * unit[:, None],
        (springs * initial.residual).sum(axis=1)[:, None] * unit,
    )
    spread = np.diagonal(information)
    return np.asarray(0.5 * gradient**2 / (1 + spread) - 0.5 * np.log1p(spread))
