"""A payload from two recordings of one robot in motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.linalg import orth

from testbed.core.base.arrays import Array
from testbed.core.base.codec import with_properties
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.errors import SettingsError
from testbed.core.base.gaussian import Gaussian
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import (
    scaled_inverse,
    unit_diagonal,
)
from testbed.core.parameters.minimal_set import MinimalSet, minimal_set
from testbed.core.parameters.symbols import STANDARD, to_barycentric
from testbed.core.robot.tree import Tree

UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
"""Of the ten."""

SEEN = 1e-9
"""A parameter that is identifiable alone lies in the space of what is seen to this."""

SMALLEST = 1e-9
"""Singular values below this share of the largest are rounding."""

IMPOSSIBLE = 1e-6
"""Chance below which the rest of the difference is no noise."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PayloadEstimate(Diagnosed, Gaussian):
    """Ten inertial parameters of what a link carries more, about and along the link's frame.

    Attributes:
        joint: The link is the one that this joint moves.
        rank: How many combinations are identifiable.
        chance: That noise alone leaves so much of the difference as no payload explains.
        diagnostics: What a careful reader should know.
    """

    joint: str
    rank: int
    chance: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __get_pydantic_core_schema__ = with_properties("sigma", "identifiable", "centre")

    @property
    def centre(self) -> tuple[Array, Array] | None:
        """Centre of mass in the link's frame and its sigma, (3,) each [m].

        Not a number where not identifiable; None if the mass is not, or not by more than 5 sigma.
        """
        if not self.identifiable[0] or self.values[0] < 5 * self.sigma[0]:
            return None
        return _centre(self.values, self.covariance, self.identifiable)


def _centre(
    values: Array, covariance: Array, identifiable: ArrayLike
) -> tuple[Array, Array]:
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
    if (
        minimal.names
        != minimal_set(tree.with_gravity(without.gravity), minimal.model).names
    ):
        raise SettingsError(
            "a payload breaks the symmetry of links: estimate without known zeros"
        )
    adds = seen_of_payload(tree, minimal, joint)
    difference = loaded.values[:count] - without.values[:count]
    noise = (loaded.covariance + without.covariance)[:count, :count]
    found = payload_from(joint, adds, difference, noise)
    if without.method == "external":
        return found
    return replace(
        found, diagnostics=(*found.diagnostics, diagnose("payload.scale", joint))
    )


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
    # weights prefer the directions along which an estimated covariance happens to be small
    covariance = max(1.0, rest @ rest / freedom) * seen @ inverse @ seen.T
    identifiable = np.abs(np.linalg.norm(seen, axis=1) - 1) < SEEN
    payload = PayloadEstimate(
        names=STANDARD,
        units=UNITS,
        values=seen @ found,
        covariance=covariance,
        unidentifiable=tuple(compress(STANDARD, ~identifiable)),
        joint=joint,
        rank=len(found),
        chance=chance,
    )
    mass, sigma = float(payload.values[0]), float(payload.sigma[0])
    return replace(
        payload, diagnostics=tuple(_diagnostics(joint, chance, mass, sigma, what))
    )


def _diagnostics(
    joint: str, chance: float, mass: float, sigma: float, what: str
) -> Iterator[Diagnostic]:
    if chance < IMPOSSIBLE:
        yield diagnose("payload.unexplained", joint, chance)
    if mass < -5 * sigma:
        yield diagnose(f"{what}.negative-mass", joint, mass, sigma=sigma)
