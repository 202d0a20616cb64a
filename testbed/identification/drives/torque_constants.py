"""Joint torques as measurements of the drives: torque constants, rotors, friction, their terms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.arrays import Array
from testbed.blas import one_blas_thread
from testbed.identification.drives.joint_regression import JointRegression, Torques, all_terms
from testbed.identification.regression.normal_equations import NormalEquations
from testbed.identification.selection.held_out import ALWAYS, OFFERED, Parts, Step, grown, rivals
from testbed.parameters.joint_terms import DriveSet
from testbed.robot.friction import ROTOR, JointLaw, JointTerm
from testbed.robot.tree import Tree

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


@dataclass(frozen=True)
class DriveTerm:
    """One coefficient of a joint's own torque, as it is, not as the drive reports it.

    Attributes:
        law: Which.
        unit: Of the coefficient.
        value: The coefficient.
        sigma: Its standard deviation.
    """

    law: JointLaw
    unit: str
    value: float
    sigma: float


@dataclass(frozen=True)
class DriveEstimate:
    """What the plate's parameters make of one joint's torque.

    Attributes:
        joint: Its name.
        constant: What the drive reports over what the torque is: 1 if the torque constant is right.
        sigma: Its standard deviation.
        terms: The joint's own.
        residual: Rms of what is left, as reported [N m or N].
        unit: N m or N.
        rows: How many counted.
        choice: How the terms were chosen; None where they were given.
    """

    joint: str
    constant: float
    sigma: float
    terms: tuple[DriveTerm, ...]
    residual: float
    unit: str
    rows: int
    choice: Choice | None = None


@dataclass(frozen=True)
class ChosenTerms:
    """Which terms each joint has.

    Attributes:
        choices: By joint, chosen by held-out data; None where each joint has all.
    """

    choices: tuple[Choice, ...] | None

    def pick(self, joint: int, drives: DriveSet, equations: NormalEquations) -> Array:
        """As `drive_regression.Pick`."""
        every = all_terms(joint, drives, equations)
        if self.choices is None:
            return every
        laws = self.choices[joint].laws
        own = [k for k, t in enumerate(drives.asked) if t.joint == joint and t.law in laws]
        return np.eye(len(drives.asked))[:, own]

    def estimates(
        self, tree: Tree, torques: Torques, found: Sequence[JointRegression]
    ) -> tuple[DriveEstimate, ...]:
        """Every joint's regression in words."""
        asked = torques.drives.asked
        estimates = tuple(drive_of(tree, asked, each) for each in found)
        if self.choices is None:
            return estimates
        return tuple(
            replace(each, choice=choice)
            for each, choice in zip(estimates, self.choices, strict=True)
        )


def drive_of(tree: Tree, asked: Sequence[JointTerm], found: JointRegression) -> DriveEstimate:
    """A joint's regression in words: its own terms as they are, not as reported.

    Args:
        tree: The robot.
        asked: All terms.
        found: The regression, each coefficient that of one term.
    """
    laws = [asked[k].law for k in found.terms.argmax(axis=0)]
    joint = tree.joints[found.joint]
    terms, covariance = found.as_they_are
    sigmas = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return DriveEstimate(
        joint=joint.name,
        constant=float(found.values[0]),
        sigma=float(np.sqrt(max(float(found.covariance[0, 0]), 0.0))),
        terms=tuple(
            DriveTerm(law, law.unit(joint), float(value), float(sigma))
            for law, value, sigma in zip(laws, terms, sigmas, strict=True)
        ),
        residual=found.residual,
        unit="N m" if joint.revolute else "N",
        rows=found.rows,
    )
