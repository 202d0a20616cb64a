"""Physical consistency of rigid-body inertias, and the nearest consistent inertia."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.robot.inertia import Inertia

POINT_MASS_TOLERANCE = 1e-9
"""Largest ratio of central to total second moments that is attributed to rounding.

Total second moments are those about the origin of the body's frame. A body with a smaller ratio is
treated as a point mass."""


POINT_MASS_RADIUS_RATIO = 0.1
"""Radius of gyration assigned to a point mass, relative to its distance or the robot's length."""


def nearest_consistent_inertia(
    body: Inertia, min_moment_ratio: float, mass: float, reach: float
) -> Inertia:
    """Nearest physically consistent inertia.

    Mass, mass centre and principal axes are left unchanged if possible.

    The central second-moment matrix is projected, in the Frobenius norm, onto the matrices whose
    eigenvalues are at least `min_moment_ratio` times the largest eigenvalue. A point mass becomes a
    ball around its mass centre, with radius of gyration POINT_MASS_RADIUS_RATIO times its distance
    from the frame's origin. A massless body gets the mass `mass` at the origin of its frame.

    Source    [WKS18] for the condition; the ratios are our own choice.

    Args:
        body: Inertia as read from a file, relative to the body's frame.
        min_moment_ratio: Smallest ratio of a principal second moment to the largest principal
            second moment.
        mass: Mass assigned to a massless body [kg].
        reach: Length of the robot [m], which replaces the distance of a point mass that lies at the
            origin of its frame.
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
    """Reason why a link's mass and inertia are physically inconsistent; None if consistent.

    An inertia is consistent if the mass and the principal moments are positive and the moments
    satisfy the triangle inequality with a relative slack of 1e-9. A link with zero mass and zero
    inertia is accepted, as files use massless links as frames.

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
