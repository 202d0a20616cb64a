"""Physical consistency of rigid-body inertias, and the nearest consistent inertia."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.robot.inertia import Inertia

POINT_MASS_TOLERANCE = 1e-9
"""Share of a body's second moments about the frame below which central moments are rounding.

A body with smaller central moments is a point mass."""


POINT_MASS_RADIUS_RATIO = 0.1
"""Radius of gyration given to a point mass, relative to its distance or to the robot's length."""


def nearest_consistent_inertia(
    body: Inertia, min_moment_ratio: float, mass: float, reach: float
) -> Inertia:
    """Nearest physically consistent inertia; mass, mass centre and principal axes stay if possible.

    The central second-moment matrix is projected, in the Frobenius norm, onto matrices whose
    eigenvalues are at least a share of the largest. A point mass becomes a ball around its mass
    centre, with radius of gyration POINT_MASS_RADIUS_RATIO times its distance from the frame's
    origin. A massless body gets a mass at its frame's origin.

    Source    [WKS18] for the condition; the shares are our own choice.

    Args:
        body: Inertia as read from a file, about and along the body's frame.
        min_moment_ratio: Least ratio of a principal second moment to the greatest.
        mass: Mass for a massless body [kg].
        reach: Length of the robot, in place of the distance of a point mass at its frame's origin
            [m].
    """
    if body.mass <= 0:
        body = Inertia(mass, np.zeros(3), body.tensor)
    centre, matrix = body.com, np.array(body.pseudo)
    offset = body.mass * np.outer(centre, centre)
    moments, axes = np.linalg.eigh(matrix[:3, :3] - offset)
    if moments[-1] <= POINT_MASS_TOLERANCE * np.abs(matrix[:3, :3]).max():
        radius = POINT_MASS_RADIUS_RATIO * (float(np.linalg.norm(centre)) or reach)
        moments = np.full(3, body.mass * radius**2 / 3)
    raised_moments = np.maximum(moments, min_moment_ratio * moments[-1])
    matrix[:3, :3] = axes * raised_moments @ axes.T + offset
    return Inertia.of_pseudo(matrix)


def inertia_flaw(link: str, mass: float, central: ArrayLike) -> str | None:
    """Reason why no rigid body has a link's mass and inertia; None if physically consistent.

    Consistent are a mass and moments above zero that satisfy the triangle inequality (slack 1e-9).
    A link with zero mass and inertia is accepted: files use such links as frames.

    Args:
        link: Link name, for the message.
        mass: Mass [kg].
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
    # relative slack of the triangle inequality: rounding of a thin plate's exact equality
    if moments[0] + moments[1] < moments[2] * (1 - 1e-9):
        return (
            f"link '{link}' has principal moments of inertia ({listed}) kg m^2, where the largest "
            "exceeds the sum of the others"
        )
    return None
