"""One joint's reported torque on what its bodies need and its own terms: a short regression."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.noise.fits import NoiseFit, weighted_fits
from testbed.core.estimation.noise.lagged_products import (
    HIGHEST,
    LaggedProducts,
    LaggedSums,
)
from testbed.core.estimation.noise.replicas import REPLICAS, SEED, Replicas
from testbed.core.estimation.noise.whitening import counted
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    TINY,
    NormalEquations,
    scaled_inverse,
    scaled_solve,
)
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.settings import Settings
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import minimal_set, selection
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree

LEAST = 0.5
"""Reliability below which a constant is not identifiable: most of its column may be error."""

POOLED = 400
"""Coefficients of replicas, of a joint's regression: its sigma is found to 4 %."""


class JointAttenuation(NamedTuple):
    """Regression on predicted torques, corrected for attenuation by their errors.

    Attributes:
        slope: How the values move with those before, (1 + q, 1 + q).
        covariance: Without what the bodies' own adds to first order, (1 + q, 1 + q).
        reliability: Share of the constant that was left.
    """

    slope: Array
    covariance: Array
    reliability: float


def correct_attenuation(
    fit: NoiseFit, square: Array, spread: Array
) -> JointAttenuation:
    """What errors of the bodies take of a constant is put back ([Ful87] section 1.2).

    A column with errors has more square than what it stands for, and the coefficient is too small
    in proportion. What that square itself may be off counts in sigma.

    Args:
        fit: Of the columns as they are.
        square: Products of the columns, (1 + q, 1 + q).
        spread: Products of the first column's parts times their covariance: its trace is what
            errors add to the column's square on average.
    """
    size = len(fit.values)
    # square that terms do not show
    alone = 1.0 / max(float(scaled_inverse(square)[0, 0]), TINY)
    reliability = 1.0 - float(np.trace(spread)) / alone
    kept = max(reliability, LEAST)
    toward = fit.covariance[:, 0] / max(float(fit.covariance[0, 0]), TINY)
    slope = np.eye(size) + np.outer(toward, np.eye(size)[0]) * (1 / kept - 1)
    constant = abs(float(slope[0] @ fit.values))
    unsure = max(1.0, constant)
    if reliability > LEAST:
        unsure = (
            constant * np.sqrt(max(2 * np.trace(spread @ spread), 0.0)) / alone / kept
        )
    covariance = slope @ fit.covariance @ slope.T + unsure**2 * np.outer(toward, toward)
    return JointAttenuation(slope, covariance, reliability)


ROUNDING = 1e-20
"""Of a torque's square: what exact data leave."""


@dataclass(frozen=True, eq=False)
class JointRegression:
    """One joint's.

    Attributes:
        joint: Index.
        terms: How its q coefficients make those of the asked terms, (asked, q).
        values: What the drive reports over what the torque is, then the coefficients as
            reported, (1 + q,).
        covariance: (1 + q, 1 + q); it holds that of the bodies.
        residual: Rms of what is left, as reported [N m or N].
        noise: What the residual would be, were rows independent of each other and as uncertain as
            the covariance has it [N m or N].
        rows: How many counted.
        reliability: Share of the constant that is left where what the bodies need is not known
            exactly: it is put back, and below `LEAST` there is nothing to put back.
    """

    joint: int
    terms: Array
    values: Array
    covariance: Array
    residual: float
    noise: float
    rows: int
    reliability: float = 1.0

    @property
    def as_they_are(self) -> tuple[Array, Array]:
        """The coefficients in true torque, (q,), and their covariance, (q, q)."""
        constant, terms = float(self.values[0]), self.values[1:] / self.values[0]
        slope = np.column_stack([-terms / constant, np.eye(len(terms)) / constant])
        return terms, slope @ self.covariance @ slope.T


@dataclass(frozen=True, eq=False)
class Torques:
    """A recording's joint torques beside what a plate's estimate says of the bodies.

    Attributes:
        drives: The unknowns.
        passes: Over the rows.
        equations: Of all rows.
        lift: How the plate's parameters make the unknowns, (p, N_r).
        joints: Indices of those whose torque the wrench contains: all, or those beyond a sensor.
        combined: How unknowns combine to the columns of a regression, (p, 1 + asked): the
            torque that the bodies need, and the terms.
    """

    drives: DriveSet
    passes: Passes
    equations: NormalEquations
    lift: Array
    joints: tuple[int, ...]
    combined: Array

    def columns(self, terms: Array) -> Array:
        """How the unknowns combine to the columns of a regression, (p, 1 + q).

        Args:
            terms: How its coefficients make those of the asked terms, (asked, q).
        """
        return np.asarray(self.combined @ block_diag(1.0, terms))

    def products(self, joint: int, terms: Array) -> Array:
        """Products of the columns of a joint's regression, (1 + q, 1 + q).

        Args:
            joint: Its index.
            terms: As for `columns`.
        """
        normal, _, _ = self.equations.of_channel(joint)
        columns = self.columns(terms)
        return columns.T @ normal @ columns

    def terms(self, joint: int, laws: Iterable[JointLaw] | None = None) -> Array:
        """Which of the asked terms are a joint's, one column a law, (asked, q).

        Args:
            joint: Its index.
            laws: In this order; default all that the joint has.
        """
        place = {t.law: k for k, t in enumerate(self.drives.asked) if t.joint == joint}
        own = place.values() if laws is None else [place[law] for law in laws]
        return np.eye(len(self.drives.asked))[:, list(own)]


def torques_beside(
    problem: Problem, bodies: Estimate, laws: Sequence[str | JointLaw] | None = None
) -> Torques:
    """A recording's joint torques, ready for regressions.

    Args:
        problem: By joint torques.
        bodies: The external estimate: of this recording or of another.
        laws: Of the joints' own torque; default those of the settings.

    Raises:
        SettingsError: The estimate is not the plate's or a force sensor's, or not of these
            parameters.
    """
    if problem.tree.shafts:
        raise SettingsError(
            "joints are held against the plate one by one, and robot.coupling joins some: "
            'leave identification.drives "off"'
        )
    terms = problem.settings.words if laws is None else laws
    problem = problem.with_settings(terms=terms)
    drives = problem.drives
    assert drives is not None, "terms are those of joint torques"
    lift = _lift(problem.tree, bodies, drives, problem.settings)
    passes = problem.passes(3, load=(lift @ bodies.values)[: problem.minimal.count])
    with one_blas_thread():
        equations = problem.equations(passes)
    combined = np.column_stack([lift @ bodies.values, drives.columns])
    joints = tuple(
        problem.tree.index(name) for name in bodies.joints[bodies.minimal.lead :]
    )
    if not joints:
        raise SettingsError(
            "no joint lies beyond the force sensor: it says nothing of a drive"
        )
    return Torques(drives, passes, equations, lift, joints, combined)


SILENT = 1e-12
"""Root mean square of a torque that is none [N m or N]."""


def regressions(
    torques: Torques, bodies: Estimate, picked: Mapping[int, Array] | None = None
) -> tuple[JointRegression, ...]:
    """Every joint's regression, with a calibrated covariance.

    Args:
        torques: And what the bodies need.
        bodies: The external estimate.
        picked: By joint, how the coefficients of its regression make those of the asked terms,
            (asked, q); default all terms of the joint.

    Raises:
        RecordingError: The rows of a joint do not distinguish its coefficients.
    """
    if picked is None:
        picked = {joint: torques.terms(joint) for joint in torques.joints}
    for joint, terms in picked.items():
        _check_rows(torques, joint, terms)
    with one_blas_thread():
        fits = _fits(
            torques, {joint: block_diag(1.0, terms) for joint, terms in picked.items()}
        )
    return tuple(
        _with_bodies(torques, bodies, joint, picked[joint], *fit)
        for joint, fit in fits.items()
    )


def _check_rows(torques: Torques, joint: int, terms: Array) -> None:
    """Raise RecordingError where a joint's rows do not distinguish its coefficients."""
    equations = torques.equations
    name, used = equations.channels[joint], equations.used[joint]
    if not equations.squares[joint] > SILENT**2 * used:
        raise RecordingError(
            f"the torque of joint '{name}' is zero throughout, which says nothing of its drive: "
            "record it, or hold the joint (--lock)"
        )
    products = torques.products(joint, terms)
    size = np.sqrt(np.diagonal(products))
    spread = (
        np.linalg.eigvalsh(products / np.outer(size, size))
        if size.all()
        else np.zeros(1)
    )
    if spread[0] <= len(size) * np.finfo(float).eps * spread[-1]:
        raise RecordingError(
            f"{int(used)} rows of joint '{name}' do not identify its torque constant beside "
            f"{terms.shape[1]} coefficients of friction and rotor: record longer, or a richer "
            "motion of it"
        )


def _with_bodies(
    torques: Torques,
    bodies: Estimate,
    joint: int,
    terms: Array,
    fit: NoiseFit,
    squares: float,
) -> JointRegression:
    """A joint's regression, errors of the bodies counted."""
    normal, _, _ = torques.equations.of_channel(joint)
    products, used = torques.products(joint, terms), int(torques.equations.used[joint])
    spread = torques.lift.T @ normal @ torques.lift @ bodies.covariance
    corrected = correct_attenuation(fit, products, spread)
    values = corrected.slope @ fit.values
    across = torques.columns(terms).T @ normal @ torques.lift
    moved = -values[0] * corrected.slope @ scaled_solve(products, across)
    residual = float(np.sqrt(squares / max(used, 1)))
    plain = np.diagonal(scaled_inverse(products))
    noise = float(np.sqrt(np.mean(np.diagonal(fit.covariance) / plain)))
    return JointRegression(
        joint=joint,
        terms=terms,
        values=values,
        covariance=corrected.covariance + moved @ bodies.covariance @ moved.T,
        residual=residual,
        noise=max(noise, residual),
        rows=used,
        reliability=corrected.reliability,
    )


def _lift(tree: Tree, bodies: Estimate, drives: DriveSet, settings: Settings) -> Array:
    """How the plate's parameters make the internal unknowns without terms, (p, N_r)."""
    if bodies.minimal.of_sensor:
        if not {*bodies.joints} <= {*tree.names} or bodies.minimal.cuts:
            raise SettingsError(
                "drives are held against the wrench of all that a force sensor carries, of the "
                "same robot"
            )
        # of the bodies beyond the sensor
        theta = np.zeros((tree.n, 10, bodies.minimal.count))
        theta[[tree.index(name) for name in bodies.joints]] = (
            bodies.minimal.lift.reshape(-1, 10, bodies.minimal.count)
        )
        found = np.zeros((drives.count, bodies.minimal.count))
        found[: drives.minimal.count] = drives.minimal.matrix @ theta.reshape(
            10 * tree.n, -1
        )
        return found
    reaction = minimal_set(tree, "reaction", zeros=settings.zeros)
    if bodies.method != "external" or bodies.names != reaction.names:
        raise SettingsError(
            "drives are held against the plate's estimate, of the same robot, gravity and zeros"
        )
    found = np.zeros((drives.count, reaction.count))
    found[: drives.minimal.count] = selection(drives.minimal, reaction)
    return found


def _fits(
    torques: Torques, own: Mapping[int, Array]
) -> dict[int, tuple[NoiseFit, float]]:
    """The regression of every joint, sigma corrected by bootstrap, and the squares it leaves."""
    sums = {joint: LaggedSums(HIGHEST) for joint in own}
    for joint, part in _parts(torques, own):
        sums[joint].add(part)
    plain = {joint: _in_units(each.finish()) for joint, each in sums.items()}
    replicas = {
        joint: [
            Replicas(fit.noise, SEED + k)
            for k in range(math.ceil(POOLED / REPLICAS / len(fit.values)))
        ]
        for joint, (fit, _, _) in plain.items()
    }
    for joint, part in _parts(torques, own):
        for each in replicas[joint]:
            each.add(part[..., :-2] / plain[joint][2], part[..., -1])
    found = {}
    for joint, (fit, given, size) in plain.items():
        unit = np.eye(len(fit.values))
        factor = float(
            np.mean([each.squares(weighted_fits, unit) for each in replicas[joint]])
        )
        squares = _square(given.products[0, 0], fit.values) * size**2
        found[joint] = (
            replace(fit, covariance=max(1.0, factor) * fit.covariance),
            squares,
        )
    return found


def _parts(torques: Torques, own: Mapping[int, Array]) -> Iterator[tuple[int, Array]]:
    """Blocks of a joint's rows: its columns, the torque, and ones where a row counts, (1, k, q)."""
    for columns, measured in torques.passes.rows(torques.combined):
        ones = counted(columns, measured)
        for joint, which in own.items():
            last = np.stack([measured[joint], ones[joint]], axis=1)
            part = [columns[joint] @ which, last]
            yield joint, np.concatenate(part, axis=1)[None]


def _in_units(given: LaggedProducts) -> tuple[NoiseFit, LaggedProducts, float]:
    """Fit and products of rows in units of the rms that plain least squares leaves, and that."""
    squares = given.products[0, 0]
    m = len(squares) - 2
    values = scaled_solve(squares[:m, :m], squares[:m, m])
    count, whole = max(float(squares[m + 1, m + 1]), 1.0), float(squares[m, m])
    size = float(np.sqrt(max(_square(squares, values), ROUNDING * whole, TINY) / count))
    scaled = given.combined(np.diag([*np.full(m + 1, 1 / size), 1.0]))
    return weighted_fits(scaled)[0], scaled, size


def _square(products: Array, values: Array) -> float:
    """Square of what values leave of the residuals, by products of columns and both, (q, q)."""
    m, combine = len(values), np.append(-values, 1.0)
    left = np.einsum("ij,i,j->", products[: m + 1, : m + 1], combine, combine)
    return max(float(left), 0.0)  # but for rounding
