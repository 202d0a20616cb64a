"""How a force sensor's axes are turned in truth, by readings at rest.

A turn is fitted with all else from each of the 24 turns that take axes to axes: none is further
than 63 degrees from one of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.applications.payload.pose_readings import PoseReading
from testbed.applications.payload.static_fit import UNKNOWNS, RestFit
from testbed.core.base.arrays import Array
from testbed.core.robot.inertia import from_rpy, to_rpy

PLAIN, NEAR = np.pi / 12, 4.0
"""Steps of angles that people write [rad]; standard deviations within which they are meant."""


@dataclass(frozen=True)
class AxesTurn:
    """Axes of a force sensor that explain its readings at rest.

    Attributes:
        rpy: Roll, pitch, yaw of them in the link's frame, as people write them [rad].
        angle: From those that were said to them [rad], and its standard deviation.
    """

    rpy: tuple[float, float, float]
    angle: tuple[float, float]


def turned(said: PoseReading) -> PoseReading:
    """Reading of a table of poses with the sensor axes of the best fit.

    Args:
        said: As it was said.
    """
    starts = Rotation.create_group("O").as_matrix()
    tried = [replace(said.few, turn=start).fit for start in starts]
    best = min(tried, key=lambda fit: float(np.prod(fit.scale)))
    return replace(said, code="axes", turn=best.turn)


def axes_turn(found: RestFit, said: Array) -> AxesTurn:
    """Rotation of the sensor's axes by a fit in which it is free.

    Args:
        found: With a turn.
        said: From the sensor's axes as they were said to the link's, (3, 3).
    """
    sigma = float(np.sqrt(np.linalg.eigvalsh(found.covariance[UNKNOWNS:, UNKNOWNS:])[-1]))
    exact = said @ found.turn
    plain = from_rpy([round(angle / PLAIN) * PLAIN for angle in to_rpy(exact)])
    if Rotation.from_matrix(plain.T @ exact).magnitude() < NEAR * sigma:
        exact = plain
    return AxesTurn(to_rpy(exact), (float(Rotation.from_matrix(found.turn).magnitude()), sigma))
