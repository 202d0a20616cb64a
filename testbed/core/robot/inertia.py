"""The ten inertial parameters of one rigid body, and whether a rigid body can have them.

Kept about the body frame's origin, where every wrench is linear in them; files speak of
the mass centre, so the passage from there is here too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array, freeze, readonly, skew

_X, _Y, _Z = np.eye(3)

LEVEL = 1e-9
"""Cosine of the pitch below which it is a right angle."""


def about(axis: Array, angle: float) -> Array:
    """The turn about a unit vector by an angle [rad], (3, 3): Rodrigues' formula."""
    cross = skew(axis)
    turn: Array = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return turn


def align_z(direction: Array) -> Array:
    """Rotation that takes z to a direction, (3, 3).

    Args:
        direction: (3,), of any length but zero.
    """
    z = direction / np.linalg.norm(direction)
    other = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(other, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def from_vector(rotation: Array) -> Array:
    """The turn by a rotation vector [rad], (3,), as a matrix, (3, 3)."""
    angle = float(np.linalg.norm(rotation))
    return about(rotation / angle, angle) if angle else np.eye(3)


def from_rpy(rpy: Sequence[float]) -> Array:
    """Turns about the fixed axes x, y, z in this order by three angles [rad], (3, 3)."""
    roll, pitch, yaw = rpy
    turn: Array = about(_Z, yaw) @ about(_Y, pitch) @ about(_X, roll)
    return turn


def to_rpy(turn: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation [rad].

    Roll first, then the others from what it leaves, so that they belong together; where the pitch
    is a right angle, and only roll and yaw together count, the roll is zero.
    """
    level = np.hypot(turn[2, 1], turn[2, 2]) > LEVEL
    roll = float(np.arctan2(turn[2, 1], turn[2, 2])) if level else 0.0
    rest = turn @ about(_X, -roll)
    yaw = float(np.arctan2(-rest[0, 1], rest[1, 1]))
    along = np.cos(yaw) * rest[0, 0] + np.sin(yaw) * rest[1, 0]
    return roll, float(np.arctan2(-rest[2, 0], along)), yaw


HEAVIEST = 1e12
"""Masses, first moments and inertias beyond this are a mistake [kg, kg m, kg m^2]."""

TRIANGLE_TOLERANCE = 1e-9
"""Relative slack of the triangle inequality: rounding of a thin plate's exact equality."""

ROUNDING = 1e-9
"""Part of a body's second moments about its frame that is rounding: a point has no others."""

SMALL = 0.1
"""Radius of gyration of what was a point, in parts of its distance or of the robot's lengths."""


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass, first moment and inertia of one rigid body, about and along its body frame.

    Attributes:
        mass: [kg].
        first_moment: Mass times the mass centre, (3,) [kg m].
        tensor: Inertia about the frame's origin, (3, 3), symmetric [kg m^2]; products of
            inertia carry their minus sign, I_yz = -integral y z dm.
    """

    mass: float
    first_moment: Array
    tensor: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", float(self.mass))
        freeze(self, first_moment=(3,), tensor=(3, 3))

    @staticmethod
    def about_centre(mass: float, com: ArrayLike, central: ArrayLike) -> Inertia:
        """From mass [kg], mass centre (3,) [m] and inertia about it (3, 3) [kg m^2]."""
        c = np.asarray(com, dtype=np.float64)
        return Inertia(mass, mass * c, np.asarray(central) - mass * skew(c) @ skew(c))

    @property
    def com(self) -> Array:
        """Mass centre in the body frame, (3,) [m]; zero for a massless body."""
        centre: Array = self.first_moment / self.mass if self.mass else np.zeros(3)
        return centre

    @property
    def radius(self) -> float:
        """Radius of gyration about the frame's origin, by the sum of second moments [m]."""
        return math.sqrt(max(np.trace(self.tensor) / 2 / self.mass, 0.0)) if self.mass > 0 else 0.0

    @cached_property
    def central(self) -> Array:
        """Inertia about the mass centre, (3, 3) [kg m^2]."""
        lever = skew(self.com)
        return readonly(self.tensor + self.mass * lever @ lever, (3, 3), "central")

    @property
    def within_limits(self) -> bool:
        """Whether all are numbers, and none is beyond HEAVIEST."""
        ten = np.concatenate([[self.mass], self.first_moment, self.tensor.ravel()])
        return bool((np.abs(ten) <= HEAVIEST).all())  # NaN fails too

    @property
    def pseudo(self) -> Array:
        """Second moments, first moments and mass as one matrix, [[S, h], [h', m]], (4, 4).

        [WKS18]: positive semidefinite if and only if the body is of rigid matter.
        """
        found = np.empty((4, 4))
        found[:3, :3] = np.trace(self.tensor) / 2 * np.eye(3) - self.tensor
        found[:3, 3] = found[3, :3] = self.first_moment
        found[3, 3] = self.mass
        return found

    @staticmethod
    def of_pseudo(matrix: Array) -> Inertia:
        """From such a matrix, (4, 4)."""
        second = matrix[:3, :3]
        return Inertia(matrix[3, 3], matrix[:3, 3], np.trace(second) * np.eye(3) - second)

    def moved(self, rotation: Array, position: Array) -> Inertia:
        """The same body seen from another frame.

        Args:
            rotation: From the body frame to the new one, (3, 3).
            position: Origin of the body frame in the new one, (3,) [m].
        """
        h = rotation @ self.first_moment
        lever, offset = skew(h), skew(position)
        turned = rotation @ self.tensor @ rotation.T
        shift = offset @ lever + lever @ offset + self.mass * offset @ offset
        return Inertia(self.mass, h + self.mass * position, turned - shift)

    def __add__(self, other: Inertia) -> Inertia:
        """Two bodies welded together, both about the same frame."""
        return Inertia(
            self.mass + other.mass,
            self.first_moment + other.first_moment,
            self.tensor + other.tensor,
        )


NOTHING = Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
"""A body without matter."""


def upper_root(matrix: Array) -> Array:
    """U with U U' the pseudo-inertia, upper triangular: an affine map, and a root of the mass.

    Args:
        matrix: (4, 4), positive definite.

    Raises:
        LinAlgError: It is not.
    """
    return np.asarray(np.linalg.cholesky(matrix[::-1, ::-1])[::-1, ::-1])


def nearest_body(body: Inertia, thinnest: float, mass: float, reach: float) -> Inertia:
    """The nearest body of rigid matter: mass, mass centre and axes stay wherever they can.

    Second moments about the mass centre are the nearest, by the sum of squares of their matrix,
    of which none is below a least share of the greatest. A body without extent becomes a ball
    around its mass centre. One without a mass gets one, about its frame's origin.

    Source    [WKS18] for the condition; the shares are our own choice.

    Args:
        body: Such as a file may have it.
        thinnest: Least principal second moment, as a share of the greatest.
        mass: Of a body that has none [kg].
        reach: A length of the robot, for a point at its frame's origin [m].
    """
    if body.mass <= 0:
        body = Inertia(mass, np.zeros(3), body.tensor)
    centre, matrix = body.com, np.array(body.pseudo)
    offset = body.mass * np.outer(centre, centre)
    size, axes = np.linalg.eigh(matrix[:3, :3] - offset)
    if size[-1] <= ROUNDING * np.abs(matrix[:3, :3]).max():
        radius = SMALL * (float(np.linalg.norm(centre)) or reach)
        size = np.full(3, body.mass * radius**2 / 3)
    raised = np.maximum(size, thinnest * size[-1])
    matrix[:3, :3] = axes * raised @ axes.T + offset
    return Inertia.of_pseudo(matrix)


def inertia_flaw(link: str, mass: float, central: ArrayLike) -> str | None:
    """What keeps a link from being a rigid body, in one line; None if nothing does.

    A link without any matter (all ten parameters zero) is no flaw: files use such links
    as frames.

    Args:
        link: The link's name, for the message.
        mass: [kg].
        central: Inertia about the mass centre, (3, 3) [kg m^2].
    """
    tensor = np.asarray(central, dtype=np.float64)
    if not (np.isfinite(mass) and np.isfinite(tensor).all()):
        return f"link '{link}' has a mass or inertia that is not a number"
    if mass < 0:
        return f"link '{link}' has negative mass {mass:g} kg"
    if mass == 0 and not tensor.any():
        return None
    moments = np.linalg.eigvalsh(tensor)
    listed = ", ".join(f"{m:.6g}" for m in moments)
    if mass == 0 or moments[0] <= 0:
        return (
            f"link '{link}' has mass {mass:g} kg and principal moments of inertia ({listed}) "
            "kg m^2, which are not all positive"
        )
    if moments[0] + moments[1] < moments[2] * (1 - TRIANGLE_TOLERANCE):
        return (
            f"link '{link}' has principal moments of inertia ({listed}) kg m^2, where the largest "
            "exceeds the sum of the others"
        )
    return None
