"""A payload from two recordings of one robot, in motion or in poses at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.linalg import orth

from testbed.applications.payload.static_fit import StaticPoses
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.codec import with_properties
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.dynamics.newton_euler import Motion, linear
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import check_source, tare_of
from testbed.core.estimation.regression.normal_equations import (
    TINY,
    scaled_inverse,
    standard_deviations,
    unit_diagonal,
)
from testbed.core.parameters.minimal_set import MinimalSet, minimal_set
from testbed.core.parameters.symbols import STANDARD, to_barycentric
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source, open_source
from testbed.core.robot.tree import Tree

UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
"""Of the ten."""

SEEN = 1e-9
"""A parameter that is identifiable alone lies in the space of what is seen to this."""

SMALLEST = 1e-9
"""Singular values below this share of the largest are rounding."""

IMPOSSIBLE = 1e-6
"""Chance below which the rest of the difference is no noise."""


@dataclass(frozen=True, eq=False)
class PayloadEstimate(Diagnosed):
    """Ten inertial parameters of what a link carries more, about and along the link's frame.

    Attributes:
        joint: The link is the one that this joint moves.
        identifiable: Which of them are identifiable alone, (10,).
        values: (10,); nothing but a choice where not identifiable.
        sigma: Standard deviations, (10,); infinite where not identifiable.
        covariance: (10, 10), of what is identifiable.
        rank: How many combinations are identifiable.
        chance: That noise alone leaves so much of the difference as no payload explains.
        names: Of the ten: m, mx, ..., Izz.
        units: (10,).
        diagnostics: What a careful reader should know.
    """

    joint: str
    identifiable: tuple[bool, ...]
    values: Array
    sigma: Array
    covariance: Array
    rank: int
    chance: float
    names: tuple[str, ...] = STANDARD
    units: tuple[str, ...] = UNITS
    diagnostics: tuple[Diagnostic, ...] = ()

    __get_pydantic_core_schema__ = with_properties("centre")

    def __post_init__(self) -> None:
        freeze(self, values=(10,), sigma=(10,), covariance=(10, 10))

    @property
    def centre(self) -> tuple[Array, Array] | None:
        """Centre of mass in the link's frame and its sigma, (3,) each [m].

        Not a number where not identifiable; None if the mass is not, or not by more than 5 sigma.
        """
        if not self.identifiable[0] or self.values[0] < 5 * self.sigma[0]:
            return None
        return _centre(self.values, self.covariance, self.identifiable)


def _centre(values: Array, covariance: Array, identifiable: ArrayLike) -> tuple[Array, Array]:
    """Centre of mass and standard deviations, (3,) each [m]; nan where not identifiable."""
    mass, place = values[0], values[1:4] / values[0]
    slope = np.column_stack([-place / mass, np.eye(3) / mass])
    sigma = np.sqrt(np.diagonal(slope @ covariance[:4, :4] @ slope.T))
    found = np.where(np.asarray(identifiable)[1:4], [place, sigma], np.nan)
    return found[0], found[1]


def seen_of_payload(tree: Tree, minimal: MinimalSet, joint: str) -> Array:
    """What each of a payload's ten parameters adds to the minimal ones, (p, 10).

    Args:
        tree: The robot.
        minimal: Its minimal parameters.
        joint: Of the link that carries it.

    Raises:
        UnknownName: There is no such joint.
    """
    link = tree.index(joint)
    ten = np.zeros((tree.n, 10, 10))
    ten[link] = np.eye(10)
    theta = to_barycentric(tree, ten)
    return np.array([minimal.values(theta[..., k]) for k in range(10)]).T


def payload(
    tree: Tree, without: Estimate, loaded: Estimate, joint: str | None = None
) -> PayloadEstimate:
    """What a link carries more.

    Args:
        tree: The robot; only its geometry matters.
        without: The robot alone, by plate or joint torques. Torques weigh in their own scale:
            a payload is as wrong as that (see `torque_scales`).
        loaded: And with the payload, by the same method, of the same parameters.
        joint: Of the link that carries it; default the last.

    Raises:
        SettingsError: The estimates are not of the same parameters, or with known zeros.
        UnknownName: There is no such joint.
    """
    joint = tree.names[-1] if joint is None else joint
    minimal, count = without.minimal, without.minimal.count
    if without.method != loaded.method or loaded.names[:count] != without.names[:count]:
        raise SettingsError(
            "a payload is the difference of two estimates by one method, of the same robot, "
            "gravity, zeros and rotors"
        )
    if (without.gravity != loaded.gravity).any():
        raise SettingsError("the two recordings are under different gravity")
    if minimal.names != minimal_set(tree.with_gravity(without.gravity), minimal.model).names:
        raise SettingsError("a payload breaks the symmetry of links: estimate without known zeros")
    adds = seen_of_payload(tree, minimal, joint)
    difference = loaded.values[:count] - without.values[:count]
    noise = (loaded.covariance + without.covariance)[:count, :count]
    found = payload_from(joint, adds, difference, noise)
    if without.method == "external":
        return found
    return replace(found, diagnostics=(*found.diagnostics, diagnose("payload.scale", joint)))


def payload_from(
    joint: str, adds: Array, difference: Array, noise: Array, what: str = "payload"
) -> PayloadEstimate:
    """Ten parameters of what they add to others, by the combinations that are seen.

    Args:
        joint: Of the link that carries them.
        adds: What each of the ten adds to every other, (p, 10).
        difference: Of those, (p,).
        noise: Their covariance, (p, p).
        what: "payload", of two recordings, or "tool", of one.
    """
    unit, scale = unit_diagonal(noise)
    white = np.linalg.inv(np.linalg.cholesky(unit)) / scale
    seen = orth(adds.T, rcond=SMALLEST)
    columns = white @ adds @ seen
    inverse = scaled_inverse(columns.T @ columns)
    found = inverse @ columns.T @ white @ difference
    rest = white @ difference - columns @ found
    freedom = max(len(adds) - len(found), 1)
    chance = float(special.chdtrc(freedom, rest @ rest))
    covariance = seen @ inverse @ seen.T
    identifiable = np.abs(np.linalg.norm(seen, axis=1) - 1) < SEEN
    sigma = np.where(identifiable, standard_deviations(covariance), np.inf)
    values = seen @ found
    return PayloadEstimate(
        joint=joint,
        identifiable=tuple(identifiable.tolist()),
        values=values,
        sigma=sigma,
        covariance=covariance,
        rank=len(found),
        chance=chance,
        diagnostics=tuple(_diagnostics(joint, chance, values[0], sigma[0], what)),
    )


def _diagnostics(
    joint: str, chance: float, mass: float, sigma: float, what: str
) -> Iterator[Diagnostic]:
    if chance < IMPOSSIBLE:
        yield diagnose("payload.unexplained", joint, chance)
    if mass < -5 * sigma:
        yield diagnose(f"{what}.negative-mass", joint, mass, sigma=sigma)


SPAN = 0.5
"""Seconds over which a robot at rest does not move."""

STILL = 1e-3
"""Most that a joint at rest wanders [rad or m]."""

APART = 5e-3
"""Least that some joint moves from one pose to another [rad or m]."""

LEAST = 3
"""Poses that are needed."""


@dataclass(frozen=True)
class MassEstimate:
    """A mass by its weight.

    Attributes:
        mass: [kg].
        sigma: [kg].
        centre: Of mass in the link's frame [m]; () for a whole robot, whose centre moves.
        centre_sigma: [m].
        poses: How many there were.
    """

    mass: float
    sigma: float
    centre: tuple[float, ...]
    centre_sigma: tuple[float, ...]
    poses: int


def poses_at_rest(tree: Tree, recording: Recording | Source | str) -> StaticPoses:
    """The poses in which a robot stood still, the tare taken off the wrench.

    Args:
        tree: The robot.
        recording: With the wrench.

    Raises:
        RecordingError: It has no wrench, is of another robot, or shows too few poses at rest.
    """
    source = open_source(recording)
    check_source(source, tree, "external")
    count = max(2, round(SPAN * source.rate))
    groups: list[list[Array]] = []
    for first in range(0, source.samples - count + 1, count):
        part = source.part(first, first + count).ordered(tree)
        if np.ptp(part.position, axis=0).max() > STILL:
            continue
        mean = np.hstack([part.position, part.measured("wrench")]).mean(axis=0)
        if groups and np.abs(groups[-1][0] - mean)[: tree.n].max() < APART:
            groups[-1].append(mean)
        else:
            groups.append([mean])
    if len(groups) < LEAST:
        raise RecordingError(
            f"the recording shows {len(groups)} poses at rest; a pose is {SPAN:g} s in which no "
            f"joint moves more than {STILL:g} rad or m, and {LEAST} are needed"
        )
    means = np.array([np.mean(each, axis=0) for each in groups])
    return StaticPoses(means[:, : tree.n], means[:, tree.n :] - tare_of(tree, source))


def estimate_mass(tree: Tree, poses: StaticPoses) -> MassEstimate:
    """The mass of all that moves, by its weight in a few poses.

    Args:
        tree: The robot, under its gravity.
        poses: At rest.

    Raises:
        RecordingError: There is no gravity to weigh by.
    """
    total = np.tile([1.0, 0.0, 0.0, 0.0], tree.n)
    values, covariance, identifiable = _solved(_weights(tree, poses), poses.wrench, total[None])
    if not identifiable[0]:
        raise RecordingError("the moving mass is not identifiable from these poses")
    sigma = float(np.sqrt(covariance[0, 0]))
    return MassEstimate(float(values[0]), sigma, (), (), len(poses.wrench))


def estimate_payload_mass(
    tree: Tree, without: StaticPoses, loaded: StaticPoses, joint: str | None = None
) -> MassEstimate:
    """A payload's mass and centre by what it adds to the weight; the poses need not be the same.

    Args:
        tree: The robot, under its gravity; only its geometry matters.
        without: Poses without the payload.
        loaded: Poses with it.
        joint: Of the link that carries it; default the last.

    Raises:
        RecordingError: The poses do not identify the payload's mass.
        UnknownName: There is no such joint.
    """
    link = tree.index(tree.names[-1] if joint is None else joint)
    robot = [_weights(tree, poses) for poses in (without, loaded)]
    load = robot[1][:, 4 * link : 4 * link + 4]
    columns = np.block([[robot[0], np.zeros((len(robot[0]), 4))], [robot[1], load]])
    wrench = np.concatenate([without.wrench, loaded.wrench])
    values, covariance, identifiable = _solved(columns, wrench, np.eye(columns.shape[1])[-4:])
    if not identifiable[0]:
        raise RecordingError(
            "the payload's mass is not identifiable beside the robot's: repeat some poses with and "
            "without the payload, or measure more different ones"
        )
    centre, sigma = (tuple(x.tolist()) for x in _centre(values, covariance, identifiable))
    return MassEstimate(
        float(values[0]), float(np.sqrt(covariance[0, 0])), centre, sigma, len(wrench)
    )


def _weights(tree: Tree, poses: StaticPoses) -> Array:
    """Wrench of a unit of every link's mass and first moment, (6 P, 4 n)."""
    standard = np.zeros((tree.n, 10, 4 * tree.n))
    standard[:, :4] = np.eye(4 * tree.n).reshape(tree.n, 4, -1)
    still = np.zeros_like(poses.position)
    motion = Motion(np.arange(float(len(still))), poses.position, still, still)
    return linear(tree, motion, to_barycentric(tree, standard))[1].reshape(poses.wrench.size, -1)


def _solved(columns: Array, wrench: Array, asked: Array) -> tuple[Array, Array, Array]:
    """Values, covariance and which are identifiable of sums of unknowns, (q,), (q, q), (q,).

    Forces and moments are weighted by the residuals of a first fit of each.
    """
    scale = np.ones(2)
    for _ in range(2):
        weights = np.tile(np.repeat(scale, 3), len(wrench))
        left, sizes, directions = np.linalg.svd(columns / weights[:, None], full_matrices=False)
        rank = int((sizes > SMALLEST * sizes[0]).sum()) if sizes[0] > 0 else 0
        seen = directions[:rank].T
        found = seen @ (left[:, :rank].T @ (wrench.ravel() / weights) / sizes[:rank])
        rest = wrench.ravel() - columns @ found
        variance = float(np.sum((rest / weights) ** 2)) / max(wrench.size - rank, 1)
        rms = np.sqrt((rest.reshape(-1, 2, 3) ** 2).mean(axis=(0, 2)))
        scale = np.maximum(rms, max(1e-6 * rms.max(), TINY))
    half = (asked @ seen) / sizes[:rank]
    identifiable = np.linalg.norm(asked - (asked @ seen) @ seen.T, axis=1) < SEEN
    return asked @ found, variance * half @ half.T, identifiable
