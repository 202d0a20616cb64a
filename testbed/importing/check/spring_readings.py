"""Readings with a torque in proportion to a joint's position, as of a cable or a spring."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.importing.check.remedies import Hypothesis
from testbed.importing.check.torque_products import spring_torques
from testbed.importing.check.torque_readings import LogReading, TorqueCase

ODDS = -4.0
"""Logarithm of the prior odds [nats]."""

FAINT = 5.0
"""Nats that a spring must promise to be judged."""


def spring_readings(case: TorqueCase, joints: Sequence[int]) -> Iterator[LogReading]:
    """Yield readings with a spring at one joint, screened by a score test.

    Args:
        case: The log.
        joints: Indices of those with torques that count.
    """
    promise = _promise(case)
    for joint in joints:
        if promise[joint] > FAINT and joint not in case.sprung:
            reading = replace(case, sprung=(*case.sprung, joint)).as_given
            hypothesis = Hypothesis("spring", (joint,))
            yield replace(
                reading,
                hypotheses=(hypothesis,),
                kind="spring",
                odds=ODDS,
            )


def _promise(case: TorqueCase) -> Array:
    """First-order log evidence gain of a spring at each joint, (n,) [nats]."""
    first, products, unit = case.as_given, case.products, np.eye(case.tree.n)
    springs = spring_torques(case.signals, case.size).T * products.counted
    cross = (products.columns.transpose(0, 2, 1) @ springs[:, :, None])[:, :, 0]
    if products.gravity_columns.shape[2]:
        heavy = np.tensordot(products.gravity_columns, case.gravity, ([2], [0]))
        cross[:, : products.shared] += (springs[:, None] @ heavy)[:, 0]
    square = (springs**2).sum(axis=1)
    gradient, information = first.evidence.marginal(
        cross[:, :, None] * unit[:, None],
        square[:, None, None] * unit[:, :, None] * unit[:, None],
        (springs * first.residual).sum(axis=1)[:, None] * unit,
    )
    spread = np.diagonal(information)
    return np.asarray(0.5 * gradient**2 / (1 + spread) - 0.5 * np.log1p(spread))
