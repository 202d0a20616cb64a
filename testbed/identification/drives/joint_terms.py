"""Which terms a joint's torque has: chosen by data that the fit has not seen.

A recording is cut into parts. A law is added if it lessens what a fit of all other parts leaves of
each part, on average by more than the standard error of that gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.blas import one_blas_thread
from testbed.identification.drives.joint_regression import Torques
from testbed.identification.selection.candidates import ALWAYS, OFFERED, rivals
from testbed.identification.selection.held_out import Parts, Step, grown
from testbed.robot.friction import ROTOR, JointLaw

PARTS = 8
"""Of a recording."""

RUN = 16
"""Rows whose products are kept as one."""


@dataclass(frozen=True)
class Choice:
    """The terms of one joint.

    Attributes:
        laws: All of them.
        steps: How they were found, the first being what every joint has.
        next_best: The law that would have come next, and does not gain enough; None for none.
    """

    laws: tuple[JointLaw, ...]
    steps: tuple[Step, ...]
    next_best: Step | None


def offered(laws: Sequence[JointLaw]) -> tuple[JointLaw, ...]:
    """All laws that a choice needs columns of; a rotor where it is asked for.

    Args:
        laws: What is asked for.
    """
    rotor = tuple(law for law in laws if law == ROTOR)
    return (*ALWAYS, *rotor, *OFFERED)


def choices(torques: Torques) -> tuple[Choice, ...]:
    """The terms of every joint, chosen by held-out data.

    Args:
        torques: With columns of all laws that are `offered`.
    """
    asked = torques.drives.asked
    found = []
    for joint, products in enumerate(_products(torques)):
        place = {term.law: 1 + k for k, term in enumerate(asked) if term.joint == joint}
        found.append(_choice(products, place))
    return tuple(found)


def _products(torques: Torques) -> list[Array]:
    """By joint, the products of its columns and torque, of every part, (PARTS, m, m)."""
    n = len(torques.equations.channels)
    runs: list[list[Array]] = [[] for _ in range(n)]
    with one_blas_thread():
        for columns, measured in torques.passes.rows(torques.combined):
            for joint in range(n):
                all_rows = np.column_stack([columns[joint], measured[joint]])
                for first in range(0, len(all_rows), RUN):
                    part = all_rows[first : first + RUN]
                    runs[joint].append(part.T @ part)
    return [
        np.array([np.sum(part, axis=0) for part in np.array_split(np.array(each), PARTS)])
        for each in runs
    ]


def _choice(products: Array, place: dict[JointLaw, int]) -> Choice:
    """Of one joint's products: laws are added as long as one gains enough."""
    laws = [law for law in place if law in (*ALWAYS, ROTOR)]
    parts = Parts(products, products.sum(axis=0) - products)
    more, how = grown(
        parts,
        [0, *(place[law] for law in laws)],
        {law: place[law] for law in OFFERED if law in place},
        lambda law: law.kind,
        rivals,
    )
    return Choice((*laws, *more), how.steps, how.next_best)
