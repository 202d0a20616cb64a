"""Joint torques as measurements of the drives: torque constants, rotors, friction, offsets.

The plate tells what torque the bodies need, free of friction and drives. What a drive reports is a
constant times that torque and the joint's own terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array
from testbed.identification.drive_laws import Choice, choices, offered
from testbed.identification.drive_regression import JointRegression, regressions, torques_beside
from testbed.identification.estimate import Estimate
from testbed.identification.normal_equations import NormalEquations
from testbed.identification.passes import Progress
from testbed.identification.settings import Settings
from testbed.parameters.joint_terms import DriveSet
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source
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


def drive_estimates(
    tree: Tree,
    recording: Recording | Source | str,
    bodies: Estimate,
    *,
    gravity: ArrayLike | None = None,
    settings: Settings | None = None,
    choose: bool = False,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> tuple[DriveEstimate, ...]:
    """Torque constants and the joints' own terms, joint by joint.

    Args:
        tree: The robot; its inertias are not used, except for `settings.zeros`.
        recording: With joint torques, as for `identify`.
        bodies: The external estimate: of this recording or of another.
        gravity: (3,) [m/s^2], bedplate frame; default as for `identify`.
        settings: How the signals are treated, and which terms are looked for.
        choose: Choose each joint's terms by held-out data; of those in the settings, only a
            rotor's inertia counts then.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: The recording has no torques, or is of another robot.
        SettingsError: The estimate is not the plate's, or not of these parameters.
    """
    settings = settings or Settings()
    torques = torques_beside(
        tree,
        recording,
        bodies,
        offered(settings.laws) if choose or settings.open_speed else settings.laws,
        gravity=gravity,
        settings=settings,
        threads=threads,
        progress=progress,
    )
    asked = torques.drives.asked
    if not (choose or settings.open_speed):
        return tuple(drive_of(tree, asked, found) for found in regressions(torques, bodies))
    chosen = choices(torques)

    def picked(joint: int, drives: DriveSet, equations: NormalEquations) -> Array:
        del equations
        laws = chosen[joint].laws
        own = [k for k, t in enumerate(drives.asked) if t.joint == joint and t.law in laws]
        return np.eye(len(drives.asked))[:, own]

    return tuple(
        replace(drive_of(tree, asked, found), choice=chosen[found.joint])
        for found in regressions(torques, bodies, picked)
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
