"""Joint torques as measurements of the drives: torque constants, rotors, friction, offsets.

The plate tells what torque the bodies need, free of friction and drives. What a drive reports is a
constant times that torque and the joint's own terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.arrays import Array
from testbed.identification.drives.joint_regression import JointRegression, Torques, all_terms
from testbed.identification.drives.joint_terms import Choice
from testbed.identification.regression.normal_equations import NormalEquations
from testbed.parameters.joint_terms import DriveSet
from testbed.robot.friction import JointLaw, JointTerm
from testbed.robot.tree import Tree


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
