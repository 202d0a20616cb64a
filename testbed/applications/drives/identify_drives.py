"""All that the plate shows of the drives: constants, terms, curves, both methods combined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.optimize import least_squares

from testbed.applications.drives.friction_curves import (
    DriveEstimate,
    FrictionCurve,
    chosen_terms,
    drive_of,
    friction_curves,
    offered,
    picked_terms,
)
from testbed.applications.drives.joint_regression import (
    JointRegression,
    Torques,
    regressions,
    torques_beside,
)
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.blas import eigh
from testbed.core.base.codec import with_properties
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.stages import Progress, unreported
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    scaled_inverse,
    standard_deviations,
    unit_diagonal,
)
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree

DONE = 1e-12
"""Relative size of the last step."""

EXACT = 1e-14
"""Part of its variance that is left of a combination which is known exactly, by rounding."""

OPEN = 1e3
"""Times its value that a parameter's standard deviation is before torques, where the plate's zero
hides it."""

INFORMATIVE = 1e-4
"""Part of a variance that joint torques must take away for their say to be judged."""

IMPOSSIBLE = 1e-6
"""Chance below which the two do not agree."""


@dataclass(frozen=True, eq=False)
class Disagreement(Diagnosed):
    """How the plate's estimate moves when joint torques are added.

    Attributes:
        names: Of parameters on which joint torques have a say, (k,).
        z: By how many sigmas of the difference each moves, (k,).
        chance: That they would move so far if both were right.
    """

    names: tuple[str, ...]
    z: Array
    chance: float

    def __post_init__(self) -> None:
        freeze(self, z=(len(self.names),))

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Which parameters, and how far; () where the two agree."""
        if self.chance >= IMPOSSIBLE:
            return ()
        worst = np.argsort(-np.abs(self.z))[:3]
        return (
            diagnose(
                "drives.disagreement",
                "plate and torques",
                self.chance,
                parameters=", ".join(
                    f"{self.names[k]} by {self.z[k]:+.1f} sigma" for k in worst
                ),
            ),
        )


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Combined(Gaussian):
    """Minimal parameters of the plate by plate and joint torques.

    Attributes:
        constants: Torque constants as reported over what they are, one an estimate of a joint.
        disagreement: Where plate and torques differ.
    """

    constants: Gaussian
    disagreement: Disagreement


def combined(
    torques: Torques, bodies: Estimate, regressions: tuple[JointRegression, ...]
) -> Combined:
    """Plate and torques together, by Gauss and Newton's method from the plate's estimate.

    Args:
        torques: The recording's joint torques.
        bodies: The plate's estimate.
        regressions: Each joint's torque on what that estimate needs: where to start, and how
            much noise there is.
    """
    unknown = np.isinf(bodies.sigma)
    before = np.where(unknown[:, None] | unknown, 0.0, bodies.covariance)
    size = OPEN * np.maximum(
        np.abs(bodies.values), np.sqrt(np.diagonal(bodies.covariance))
    )
    before[unknown, unknown] = size[unknown] ** 2
    root = _root(before)
    count = root.shape[1]
    state, covariance = _joint_fit(torques, bodies.values, root, regressions)
    widths = [len(each.values) for each in regressions[:-1]]
    places = count + np.cumsum([0, *widths])
    values = bodies.values + root @ state[:count]
    spread = root @ covariance[:count, :count] @ root.T
    still = unknown & (standard_deviations(spread) > size / OPEN)
    names = tuple(bodies.joints[each.joint] for each in regressions)
    return Combined(
        names=bodies.names,
        units=bodies.units,
        values=values,
        covariance=spread,
        unidentifiable=tuple(compress(bodies.names, still)),
        constants=Gaussian(
            names=names,
            units=("",) * len(names),
            values=state[places],
            covariance=covariance[np.ix_(places, places)],
        ),
        disagreement=_disagreement(bodies, before, values, spread),
    )


def _joint_fit(
    torques: Torques, plate: Array, root: Array, regressions: Sequence[JointRegression]
) -> tuple[Array, Array]:
    """Coordinates of the bodies and every joint's values, (m,), and their covariance, (m, m).

    Bodies are plate + root @ coordinates, those being independent with sigma one by the plate.
    """
    ends = np.cumsum([root.shape[1], *(len(each.values) for each in regressions[:-1])])
    joints = [_rows(torques, each) for each in regressions]

    def residuals(state: Array) -> Array:
        """Of the plate's estimate and of every joint's rows, in standard deviations."""
        start, *own = np.split(state, ends)
        torque = torques.lift @ (plate + root @ start)
        left = [
            rows @ (each[0] * torque + terms @ each[1:]) - right
            for each, (rows, right, terms) in zip(own, joints, strict=True)
        ]
        return np.concatenate([start, *left])

    begin = np.concatenate(
        [np.zeros(root.shape[1]), *(each.values for each in regressions)]
    )
    fit = least_squares(
        residuals, begin, "3-point", x_scale="jac", ftol=None, gtol=None, xtol=DONE
    )
    return fit.x, scaled_inverse(fit.jac.T @ fit.jac)


def _root(covariance: Array) -> Array:
    """R with R R' the covariance, (p, r): what is known exactly does not move."""
    unit, scale = unit_diagonal(covariance)
    spread, axes = eigh(unit)
    kept = spread > EXACT
    return scale[:, None] * axes[:, kept] * np.sqrt(spread[kept])


def _rows(torques: Torques, found: JointRegression) -> tuple[Array, Array, Array]:
    """What one joint's rows say of its unknowns, in units of their noise: R x - y, and its terms.

    R, (r, p), and y, (r,), have the products of all rows; the terms' columns are (p, q).
    """
    normal, right, _ = torques.equations.of_channel(found.joint)
    root = _root(normal)
    rows = root.T / found.noise
    return (
        rows,
        np.linalg.pinv(root) @ right / found.noise,
        torques.drives.columns @ found.terms,
    )


def _disagreement(
    bodies: Estimate, before: Array, values: Array, covariance: Array
) -> Disagreement:
    """Change of an estimate in standard deviations of the difference, by both covariances."""
    moved, spread = values - bodies.values, before - covariance
    _, scale = unit_diagonal(before)
    unit = spread / np.outer(scale, scale)
    said = np.diagonal(unit) > INFORMATIVE
    z = (moved[said] / scale[said]) / np.sqrt(np.diagonal(unit)[said])
    sizes, axes = eigh((unit + unit.T) / 2)
    kept = sizes > INFORMATIVE
    along = (moved / scale) @ axes[:, kept] / np.sqrt(sizes[kept])
    chance = float(special.chdtrc(max(int(kept.sum()), 1), along @ along))
    if z.size:
        chance = min(chance, z.size * 2 * float(special.ndtr(-np.abs(z).max())))
    names = tuple(name for name, each in zip(bodies.names, said, strict=True) if each)
    return Disagreement(names, z, min(chance, 1.0))


@dataclass(frozen=True, eq=False)
class DriveFindings(Diagnosed):
    """What a recording's joint torques are, beside the plate's estimate.

    Attributes:
        estimates: Constants and terms, one a joint.
        curves: Friction over velocity, one a joint.
        combined: The bodies by plate and torques together.
    """

    estimates: tuple[DriveEstimate, ...]
    curves: tuple[FrictionCurve, ...]
    combined: Combined

    @property
    def gears(self) -> dict[str, float]:
        """True torque over what the drive reports, by joint."""
        return {each.joint: 1 / each.constant for each in self.estimates}

    __get_pydantic_core_schema__ = with_properties("diagnostics")

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What a careful reader should know."""
        return self.combined.disagreement.diagnostics


def with_drives(tree: Tree, found: DriveFindings) -> Tree:
    """The robot with the friction and rotors of its drives; other terms have no place there.

    Args:
        tree: The robot.
        found: Its drives.
    """
    settings = {
        drive.joint: {
            term.law.parameter: max(term.value, 0.0)
            for term in drive.terms
            if term.law.parameter is not None
        }
        for drive in found.estimates
    }
    return tree.with_joints(settings)


def identify_drives(
    tree: Tree,
    recording: Recording | Source | str,
    bodies: Estimate,
    *,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    choose: bool = False,
    threads: int | None = None,
    progress: Progress = unreported,
) -> DriveFindings:
    """Torque constants, the joints' own terms and friction curves; plate and torques together.

    Args:
        tree: The robot; its inertias are not used, except for `settings.zeros`.
        recording: With joint torques, as for `identify`.
        bodies: The external estimate: of this recording or of another. By a force sensor in the
            robot that has all beyond it: the joints beyond are held against it.
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
    problem = Problem.of(
        tree,
        recording,
        "internal",
        settings,
        gravity=gravity,
        threads=threads,
        progress=progress,
        knows_load=True,
    )
    settings = problem.settings
    laws = offered(settings.laws, problem.source.signals) if choose else None
    torques = torques_beside(problem, bodies, laws)
    choices = chosen_terms(problem.tree, torques, bodies) if choose else {}
    found = regressions(
        torques, bodies, picked_terms(torques, choices) if choose else None
    )
    drives = tuple(
        drive_of(problem.tree, torques, each, choices.get(each.joint)) for each in found
    )
    curves = friction_curves(problem, bodies, drives)
    return DriveFindings(drives, curves, combined(torques, bodies, found))
