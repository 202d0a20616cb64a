"""All that the plate shows of the drives: constants, terms, curves, both methods combined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.linalg import block_diag

from testbed.applications.drives.friction_curves import (
    CLEAR,
    ChosenTerms,
    DriveEstimate,
    FrictionCurve,
    chosen_terms,
    friction_curves,
    offered,
)
from testbed.applications.drives.friction_map import FrictionMap, friction_maps
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
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    scaled_inverse,
    standard_deviations,
    unit_diagonal,
)
from testbed.core.estimation.regression.passes import Progress
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.friction import LAWS
from testbed.core.robot.tree import Tree

ROUNDS = 20
"""Most rounds of Gauss and Newton's method."""

DONE = 1e-10
"""A step that is smaller than this, in sigmas, is the last."""

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
                parameters=", ".join(f"{self.names[k]} by {self.z[k]:+.1f} sigma" for k in worst),
            ),
        )


@dataclass(frozen=True, eq=False)
class Combined:
    """The bodies by plate and joint torques.

    Attributes:
        names: Of the plate's minimal parameters, (N_r,).
        values: (N_r,).
        sigma: (N_r,); infinite where neither separates a parameter from the plate's zero.
        constants: Torque constants as reported over what they are, one an estimate of a joint.
        constant_sigma: Likewise.
        disagreement: Where plate and torques differ.
    """

    names: tuple[str, ...]
    values: Array
    sigma: Array
    constants: Array
    constant_sigma: Array
    disagreement: Disagreement

    def __post_init__(self) -> None:
        p, n = len(self.names), len(self.constants)
        freeze(self, values=(p,), sigma=(p,), constants=(n,), constant_sigma=(n,))


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
    size = OPEN * np.maximum(np.abs(bodies.values), np.sqrt(np.diagonal(bodies.covariance)))
    before[unknown, unknown] = size[unknown] ** 2
    root = _root(before)
    count = root.shape[1]
    inputs = [_Joint.of(torques, found) for found in regressions]
    state = np.concatenate([np.zeros(count), *(found.values for found in regressions)])
    for _ in range(ROUNDS):
        normal = block_diag(np.eye(count), np.zeros((len(state) - count,) * 2))
        slope = np.zeros(len(state))
        slope[:count] = -state[:count]
        values, at = bodies.values + root @ state[:count], count
        for joint in inputs:
            own = slice(at, at + joint.width)
            at += joint.width
            columns = joint.columns(values, state[own])
            full = np.zeros((columns.shape[0], len(state)))
            full[:, :count] = columns[:, : len(values)] @ root
            full[:, own] = columns[:, len(values) :]
            left = joint.right - joint.normal @ joint.made(values, state[own])
            normal += full.T @ joint.normal @ full
            slope += full.T @ left
        covariance = scaled_inverse(normal)
        step = covariance @ slope
        state = state + step
        if np.abs(step / np.sqrt(np.diagonal(covariance))).max() <= DONE:
            break
    values, spread = bodies.values + root @ state[:count], covariance[:count, :count]
    spread = root @ spread @ root.T
    sigma = standard_deviations(spread)
    places = count + np.cumsum([0, *(joint.width for joint in inputs[:-1])])
    return Combined(
        names=bodies.names,
        values=values,
        sigma=np.where(unknown & (sigma > size / OPEN), np.inf, sigma),
        constants=state[places],
        constant_sigma=np.sqrt(np.diagonal(covariance)[places]),
        disagreement=_disagreement(bodies, before, values, spread),
    )


def _root(covariance: Array) -> Array:
    """R with R R' the covariance, (p, r): what is known exactly does not move."""
    unit, scale = unit_diagonal(covariance)
    spread, axes = eigh(unit)
    kept = spread > EXACT
    return scale[:, None] * axes[:, kept] * np.sqrt(spread[kept])


@dataclass(frozen=True, eq=False)
class _Joint:
    """What one joint's rows say, in units of their noise.

    Attributes:
        normal: Products of the unknowns' columns, (p, p).
        right: And of these with the torque, (p,).
        lift: How the plate's parameters make the unknowns, (p, N_r).
        terms: How the joint's own coefficients do, (p, q).
    """

    normal: Array
    right: Array
    lift: Array
    terms: Array

    @staticmethod
    def of(torques: Torques, found: JointRegression) -> _Joint:
        normal, right, _ = torques.equations.of_channel(found.joint)
        scale = found.noise**2
        terms = torques.drives.columns @ found.terms
        return _Joint(normal / scale, right / scale, torques.lift, terms)

    @property
    def width(self) -> int:
        """How many unknowns of its own."""
        return 1 + int(self.terms.shape[1])

    def made(self, bodies: Array, own: Array) -> Array:
        """The unknowns as the joint reports them, (p,)."""
        found: Array = own[0] * (self.lift @ bodies) + self.terms @ own[1:]
        return found

    def columns(self, bodies: Array, own: Array) -> Array:
        """How these move with the plate's parameters and the joint's own, (p, N_r + 1 + q)."""
        return np.column_stack([own[0] * self.lift, self.lift @ bodies, self.terms])


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
        maps: Friction over velocity and load, one a joint.
    """

    estimates: tuple[DriveEstimate, ...]
    curves: tuple[FrictionCurve, ...]
    combined: Combined
    maps: tuple[FrictionMap, ...] = ()

    @property
    def gears(self) -> dict[str, float]:
        """True torque over what the drive reports, by joint."""
        return {each.joint: 1 / each.constant for each in self.estimates}

    __get_pydantic_core_schema__ = with_properties("diagnostics")

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What a careful reader should know."""
        return (
            *self.combined.disagreement.diagnostics,
            *(
                diagnose(
                    "drives.hysteresis", each.joint, each.hysteresis[0], unit=each.unit,
                    sigma=each.hysteresis[1],
                )
                for each in self.curves
                if each.hysteresis and abs(each.hysteresis[0]) > CLEAR * each.hysteresis[1]
            ),
        )  # fmt: skip


def with_drives(tree: Tree, found: DriveFindings) -> Tree:
    """The robot with the friction and rotors of its drives; other terms have no place there.

    Args:
        tree: The robot.
        found: Its drives.
    """
    settings = {
        drive.joint: {
            str(term.law.parameter): max(term.value, 0.0)
            for term in drive.terms
            if term.law in LAWS and term.law.parameter is not None
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
    progress: Progress = lambda done, total: None,
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
    choose = choose or settings.open_speed  # which is chosen with the terms
    laws = offered(settings.laws, problem.source.signals) if choose else None
    torques = torques_beside(problem, bodies, laws)
    chosen = chosen_terms(problem.tree, torques, bodies) if choose else ChosenTerms(None)
    found = regressions(torques, bodies, chosen.pick)
    drives = chosen.estimates(problem.tree, torques, found)
    curves = friction_curves(problem, bodies, drives)
    maps = friction_maps(problem, bodies, found)
    return DriveFindings(drives, curves, combined(torques, bodies, found), maps)
