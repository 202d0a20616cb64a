"""A payload from two recordings of one robot, without it and with it.

A body that is fixed to a link adds its ten inertial parameters to the link's. The difference of two
estimates of the minimal parameters tells those of the ten, and combinations of them, that the
bedplate sees; what else it holds would be a change of something else.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from testbed.arrays import Array, readonly
from testbed.codec import with_properties
from testbed.diagnostics.diagnostic import Diagnosed, Diagnostic, diagnose
from testbed.errors import SettingsError
from testbed.identification.estimate import Estimate
from testbed.identification.regression.scaled import scaled_inverse
from testbed.parameters.barycentric import STANDARD, to_barycentric
from testbed.parameters.minimal_set import MinimalSet, minimal_set
from testbed.robot.tree import Tree

UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
"""Of the ten."""

SEEN = 1e-9
"""A parameter that is told by itself lies in the space of what is seen to this."""

SMALLEST = 1e-9
"""Singular values below this share of the largest are rounding."""

IMPOSSIBLE = 1e-6
"""Chance below which the rest of the difference is no noise."""


@dataclass(frozen=True, eq=False)
class PayloadEstimate(Diagnosed):
    """Ten inertial parameters of what a link carries more, about and along the link's frame.

    Attributes:
        joint: The link is the one that this joint moves.
        names: Of the ten: m, mx, ..., Izz.
        units: (10,).
        identifiable: Which of them are told by themselves, (10,).
        values: (10,); nothing but a choice where not told.
        sigma: Standard deviations, (10,); infinite where not told.
        covariance: (10, 10), of what is told.
        rank: How many combinations are told.
        chance: That noise alone leaves so much of the difference as no payload explains.
        diagnostics: What a careful reader should know.
    """

    joint: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    identifiable: tuple[bool, ...]
    values: Array
    sigma: Array
    covariance: Array
    rank: int
    chance: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __get_pydantic_core_schema__ = with_properties("centre")

    def __post_init__(self) -> None:
        for name in ("values", "sigma"):
            object.__setattr__(self, name, readonly(getattr(self, name), (10,), name))
        object.__setattr__(self, "covariance", readonly(self.covariance, (10, 10), "covariance"))

    @property
    def centre(self) -> tuple[Array, Array] | None:
        """Centre of mass in the link's frame and its sigma, (3,) each [m].

        Not a number where not told; None if the mass is not told, or not by more than 5 sigma.
        """
        mass = float(self.values[0])
        if not self.identifiable[0] or mass < 5 * self.sigma[0]:
            return None
        place = self.values[1:4] / mass
        slope = np.column_stack([-place / mass, np.eye(3) / mass])
        sigma = np.sqrt(np.diagonal(slope @ self.covariance[:4, :4] @ slope.T))
        identifiable = np.array(self.identifiable[1:4])
        return np.where(identifiable, place, np.nan), np.where(identifiable, sigma, np.nan)


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
        without: The plate's estimate of the robot alone.
        loaded: And with the payload, of the same parameters.
        joint: Of the link that carries it; default the last.

    Raises:
        SettingsError: The estimates are not of the same parameters, or with known zeros.
        UnknownName: There is no such joint.
    """
    joint = tree.names[-1] if joint is None else joint
    minimal = without.minimal
    if without.method != "external" or loaded.names != without.names:
        raise SettingsError(
            "a payload is the difference of two estimates by the plate, of the same robot, gravity "
            "and zeros"
        )
    if (without.gravity != loaded.gravity).any():
        raise SettingsError("the two recordings are under different gravity")
    if minimal.names != minimal_set(tree.with_gravity(without.gravity), "reaction").names:
        raise SettingsError("a payload breaks the symmetry of links: estimate without known zeros")
    adds = seen_of_payload(tree, minimal, joint)
    count = len(adds)
    difference = loaded.values[:count] - without.values[:count]
    noise = (loaded.covariance + without.covariance)[:count, :count]
    return _fitted(joint, adds, difference, noise)


def _fitted(joint: str, adds: Array, difference: Array, noise: Array) -> PayloadEstimate:
    """By the combinations that are seen, weighted by the noise."""
    scale = np.sqrt(np.diagonal(noise))
    _, sizes, directions = np.linalg.svd(adds)
    rank = int((sizes > SMALLEST * sizes[0]).sum())
    seen = directions[:rank].T
    white = np.linalg.cholesky(noise / np.outer(scale, scale))
    columns = np.linalg.solve(white, (adds @ seen) / scale[:, None])
    right = np.linalg.solve(white, difference / scale)
    inverse = scaled_inverse(columns.T @ columns)
    found = inverse @ columns.T @ right
    identifiable = np.abs(np.linalg.norm(seen, axis=1) - 1) < SEEN
    covariance = seen @ inverse @ seen.T
    left = float(np.sum((right - columns @ found) ** 2))
    chance = float(special.chdtrc(max(len(adds) - rank, 1), left))
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return PayloadEstimate(
        joint=joint,
        names=STANDARD,
        units=UNITS,
        identifiable=tuple(bool(each) for each in identifiable),
        values=seen @ found,
        sigma=np.where(identifiable, sigma, np.inf),
        covariance=covariance,
        rank=rank,
        chance=chance,
        diagnostics=tuple(_diagnostics(joint, chance, seen @ found, sigma, identifiable)),
    )


def _diagnostics(
    joint: str, chance: float, values: Array, sigma: Array, identifiable: Array
) -> Iterator[Diagnostic]:
    if chance < IMPOSSIBLE:
        yield diagnose("payload.unexplained", joint, chance)
    if identifiable[0] and values[0] < -5 * sigma[0]:
        yield diagnose("payload.negative-mass", joint, values[0], sigma=sigma[0])
