"""Bodies that rigid matter can make: what keeps a link from being one, and the nearest one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.robot.inertia import Inertia

ROUNDING = 1e-9
"""Part of a body's second moments about its frame that is rounding: a point has no others."""


SMALL = 0.1
"""Radius of gyration of what was a point, in parts of its distance or of the robot's lengths."""


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
    # relative slack of the triangle inequality: rounding of a thin plate's exact equality
    if moments[0] + moments[1] < moments[2] * (1 - 1e-9):
        return (
            f"link '{link}' has principal moments of inertia ({listed}) kg m^2, where the largest "
            "exceeds the sum of the others"
        )
    return None
