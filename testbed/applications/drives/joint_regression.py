"""One joint's reported torque on what its bodies need and its own terms: a short regression."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.noise.fits import NoiseFit, of_residuals, weighted_fits
from testbed.core.estimation.noise.lagged_products import HIGHEST, LaggedProducts, LaggedSums
from testbed.core.estimation.noise.score_tests import REPLICAS, SEED, Replicas
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
from testbed.core.robot.friction import JointLaw
from testbed.core.robot.tree import Tree

LEAST = 0.5
"""Reliability below which a constant is not identifiable: most of its column may be error."""

POOLED = 400
"""Coefficients of replicas, of a joint's regression: its sigma is found to 4 %."""


class AttenuationCorrection(NamedTuple):
    """A regression as it would be, were the bodies known exactly.

    Attributes:
        values: (1 + q,).
        covariance: Without what the bodies' own adds to first order, (1 + q, 1 + q).
        slope: How the values move with those before, (1 + q, 1 + q).
        reliability: Share of the constant that was left.
    """

    values: Array
    covariance: Array
    slope: Array
    reliability: float


def correct_attenuation(
    fit: NoiseFit, square: Array, doubt: tuple[float, float]
) -> AttenuationCorrection:
    """What errors of the bodies take of a constant is put back ([Ful87] section 1.2).

    A column with errors has more square than what it stands for, by `doubt` on average, and the
    coefficient is too small in proportion. What the doubt itself may be off counts in sigma.

    Args:
        fit: Of the columns as they are.
        square: Products of the columns, (1 + q, 1 + q).
        doubt: Mean and standard deviation of what errors add to the first column's square.
    """
    size = len(fit.values)
    alone = 1.0 / max(float(scaled_inverse(square)[0, 0]), TINY)  # square that terms do not show
    share, loose = doubt[0] / alone, doubt[1] / alone
    reliability = 1.0 - share
    kept = max(reliability, LEAST)
    toward = fit.covariance[:, 0] / max(float(fit.covariance[0, 0]), TINY)
    slope = np.eye(size) + np.outer(toward, np.eye(size)[0]) * (1 / kept - 1)
    values = slope @ fit.values
    unsure = loose / kept if reliability > LEAST else 1.0
    unsure *= abs(float(values[0])) if reliability > LEAST else max(1.0, abs(float(values[0])))
    return AttenuationCorrection(
        values,
        slope @ fit.covariance @ slope.T + unsure**2 * np.outer(toward, toward),
        slope,
        reliability,
    )


def doubt_about(normal: Array, lift: Array, bodies: Estimate) -> tuple[float, float]:
    """Mean and standard deviation of the square of what the bodies' errors make of a column."""
    spread = lift.T @ normal @ lift @ bodies.covariance
    return float(np.trace(spread)), float(np.sqrt(max(2 * np.trace(spread @ spread), 0.0)))


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
        by_bodies: How the values move with the plate's parameters, (1 + q, N_r).
        reliability: Share of the constant that is left where what the bodies need is not known
            exactly: it is put back, and below `bodies_doubt.LEAST` there is nothing to put back.
    """

    joint: int
    terms: Array
    values: Array
    covariance: Array
    residual: float
    noise: float
    rows: int
    by_bodies: Array
    reliability: float = 1.0

    @property
    def as_they_are(self) -> tuple[Array, Array]:
        """The coefficients in true torque, (q,), and their covariance, (q, q)."""
        constant, terms = float(self.values[0]), self.values[1:] / self.values[0]
        slope = np.column_stack([-terms / constant, np.eye(len(terms)) / constant])
        return terms, slope @ self.covariance @ slope.T


Pick = Callable[[int, DriveSet, NormalEquations], Array]
"""How the coefficients of a joint's regression make those of the asked terms, (asked, q): of its
index, the set and the equations."""


def all_terms(joint: int, drives: DriveSet, equations: NormalEquations) -> Array:
    """Every term of the joint has a coefficient.

    Args:
        joint: Its index.
        drives: The terms.
        equations: Of all rows.
    """
    del equations
    own = [k for k, term in enumerate(drives.asked) if term.joint == joint]
    return np.eye(len(drives.asked))[:, own]


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
    problem = problem.with_settings(terms=terms, weights="channels")
    drives = problem.drives
    assert drives is not None, "terms are those of joint torques"
    lift = _lift(problem.tree, bodies, drives, problem.settings)
    problem = replace(problem, load=(lift @ bodies.values)[: problem.minimal.count])
    passes = problem.passes(3)
    with one_blas_thread():
        equations = problem.equations(passes)
    combined = np.column_stack([lift @ bodies.values, drives.columns])
    joints = tuple(problem.tree.index(name) for name in bodies.joints[bodies.minimal.lead :])
    if not joints:
        raise SettingsError("no joint lies beyond the force sensor: it says nothing of a drive")
    return Torques(drives, passes, equations, lift, joints, combined)


SILENT = 1e-12
"""Root mean square of a torque that is none [N m or N]."""


def regressions(
    torques: Torques, bodies: Estimate, pick: Pick = all_terms
) -> tuple[JointRegression, ...]:
    """Every joint's regression, with a calibrated covariance.

    Args:
        torques: And what the bodies need.
        bodies: The external estimate.
        pick: Which terms each joint has.

    Raises:
        RecordingError: The rows of a joint do not distinguish its coefficients.
    """
    drives, equations = torques.drives, torques.equations
    picked = {joint: pick(joint, drives, equations) for joint in torques.joints}
    own = {joint: block_diag(1.0, terms) for joint, terms in picked.items()}
    for joint, each in own.items():
        _, _, squares = equations.of_channel(joint)
        if not squares > SILENT**2 * equations.used[joint]:
            raise RecordingError(
                f"the torque of joint '{equations.channels[joint]}' is zero throughout, which says "
                "nothing of its drive: record it, or hold the joint (--lock)"
            )
        if dependent(equations, joint, torques.combined @ each):
            raise RecordingError(
                f"{int(equations.used[joint])} rows of joint '{equations.channels[joint]}' do not "
                f"identify its torque constant beside {each.shape[1] - 1} coefficients of friction "
                "and rotor: record longer, or a richer motion of it"
            )
    with one_blas_thread():
        fits = _fits(torques.passes, torques.combined, own)
    found = []
    for joint, (fit, squares) in fits.items():
        lead = torques.combined @ own[joint]
        used = int(equations.used[joint])
        residual = float(np.sqrt(squares / max(used, 1)))
        normal, _, _ = equations.of_channel(joint)
        plain = np.diagonal(scaled_inverse(lead.T @ normal @ lead))
        noise = float(np.sqrt(np.mean(np.diagonal(fit.covariance) / plain)))
        undone = correct_attenuation(
            fit, lead.T @ normal @ lead, doubt_about(normal, torques.lift, bodies)
        )
        moved = undone.slope @ _by_bodies(equations, joint, lead, torques.lift, undone.values)
        found.append(
            JointRegression(
                joint=joint,
                terms=picked[joint],
                values=undone.values,
                covariance=undone.covariance + moved @ bodies.covariance @ moved.T,
                residual=residual,
                noise=max(noise, residual),
                rows=used,
                by_bodies=moved,
                reliability=undone.reliability,
            )
        )
    return tuple(found)


def dependent(equations: NormalEquations, joint: int, lead: Array) -> bool:
    """Whether columns of a joint's regression hang together.

    Args:
        equations: Of all rows.
        joint: Its index.
        lead: How the unknowns combine to the columns, (p, q).
    """
    normal, _, _ = equations.of_channel(joint)
    products = lead.T @ normal @ lead
    size = np.sqrt(np.diagonal(products))
    spread = np.linalg.eigvalsh(products / np.outer(size, size)) if size.all() else np.zeros(1)
    return bool(spread[0] <= len(size) * np.finfo(float).eps * spread[-1])


def _lift(tree: Tree, bodies: Estimate, drives: DriveSet, settings: Settings) -> Array:
    """How the plate's parameters make the internal unknowns without terms, (p, N_r)."""
    if bodies.minimal.of_sensor:
        if not {*bodies.joints} <= {*tree.names} or bodies.minimal.cuts:
            raise SettingsError(
                "drives are held against the wrench of all that a force sensor carries, of the "
                "same robot"
            )
        theta = np.zeros((tree.n, 10, bodies.minimal.count))  # of the bodies beyond the sensor
        theta[[tree.index(name) for name in bodies.joints]] = bodies.minimal.lift.reshape(
            -1, 10, bodies.minimal.count
        )
        found = np.zeros((drives.count, bodies.minimal.count))
        found[: drives.minimal.count] = drives.minimal.matrix @ theta.reshape(10 * tree.n, -1)
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
    passes: Passes, combined: Array, own: Mapping[int, Array]
) -> dict[int, tuple[NoiseFit, float]]:
    """The regression of every joint, sigma corrected by bootstrap, and the squares it leaves."""
    sums = {joint: LaggedSums(HIGHEST) for joint in own}
    for joint, part in _parts(passes, combined, own):
        sums[joint].add(part)
    given = {joint: each.finish() for joint, each in sums.items()}
    sizes = {joint: _left(each.products[0, 0]) for joint, each in given.items()}
    scaled = {joint: _in_units(each, sizes[joint]) for joint, each in given.items()}
    found = {joint: weighted_fits(each)[0] for joint, each in scaled.items()}
    replicas = {
        joint: [
            Replicas(fit.noise, scaled[joint], SEED + k)
            for k in range(math.ceil(POOLED / REPLICAS / len(fit.values)))
        ]
        for joint, fit in found.items()
    }
    for joint, part in _parts(passes, combined, own):
        for each in replicas[joint]:
            each.add(part[..., :-2] / sizes[joint], part[..., -1])
    corrected = {}
    for joint, fit in found.items():
        lead = np.eye(len(fit.values))
        made = [each.squares(weighted_fits, lead) for each in replicas[joint]]
        factor = max(1.0, float(np.sqrt(np.mean(made))))
        squares = _square(scaled[joint].products[0, 0], fit.values) * sizes[joint] ** 2
        corrected[joint] = replace(fit, covariance=factor**2 * fit.covariance), squares
    return corrected


def _parts(
    passes: Passes, combined: Array, own: Mapping[int, Array]
) -> Iterator[tuple[int, Array]]:
    """Blocks of a joint's rows: its columns, the torque, and ones where a row counts, (1, k, q)."""
    for columns, measured in passes.rows(combined):
        ones = counted(columns, measured)
        for joint, which in own.items():
            last = np.stack([measured[joint], ones[joint]], axis=1)
            part = [columns[joint] @ which, last]
            yield joint, np.concatenate(part, axis=1)[None]


def _left(squares: Array) -> float:
    """Rms of what plain least squares leaves, and next to nothing at least."""
    m = len(squares) - 2
    values = scaled_solve(squares[:m, :m], squares[:m, m])
    count, whole = max(float(squares[m + 1, m + 1]), 1.0), float(squares[m, m])
    return float(np.sqrt(max(_square(squares, values), ROUNDING * whole, TINY) / count))


def _square(squares: Array, values: Array) -> float:
    return max(float(of_residuals(squares, values)), 0.0)  # but for rounding


def _in_units(given: LaggedProducts, size: float) -> LaggedProducts:
    """Columns and torques in units of what is left."""
    columns = given.products.shape[2]
    return given.combined(np.diag([*np.full(columns - 1, 1 / size), 1.0]))


def _by_bodies(
    equations: NormalEquations, joint: int, lead: Array, lift: Array, values: Array
) -> Array:
    """How a joint's numbers move with the plate's parameters, (q, N_r)."""
    normal, _, _ = equations.of_channel(joint)
    across = lead.T @ normal
    return np.asarray(-values[0] * scaled_solve(across @ lead, across @ lift))
