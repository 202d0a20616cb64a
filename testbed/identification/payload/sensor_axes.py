"""How a force sensor's axes are turned in truth, by readings at rest.

A turn is fitted with all else from each of the 24 turns that take axes to axes: none is further
than 63 degrees from one of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.identification.payload.pose_readings import PoseReading
from testbed.identification.payload.static_fit import UNKNOWNS
from testbed.robot.force_sensor import ForceSensor
from testbed.robot.inertia import from_rpy, to_rpy
from testbed.robot.tree import Placement

PLAIN, NEAR = np.pi / 12, 4.0
"""Steps of angles that people write [rad]; standard deviations within which they are meant."""


@dataclass(frozen=True)
class AxesTurn:
    """Axes of a force sensor that explain its readings at rest.

    Attributes:
        sensor: Its name; "" for none.
        rpy: Roll, pitch, yaw of them in the link's frame [rad].
        angle: From those that were said to them [rad], and its standard deviation.
        residual: Rms of forces with them [N].
        held_out: Rms errors of forces in poses left out of the fit, as said and with them [N].
    """

    sensor: str
    rpy: tuple[float, float, float]
    angle: tuple[float, float]
    residual: float
    held_out: tuple[float, float]


def turned(said: PoseReading) -> PoseReading:
    """The reading with the sensor's axes that explain it best.

    Args:
        said: As it was said.
    """
    starts = Rotation.create_group("O").as_matrix()
    tried = [replace(said.few, turn=start).fit for start in starts]
    best = min(tried, key=lambda fit: float(np.prod(fit.scale)))
    return replace(said, code="axes", turn=best.turn)


def axes_turn(said: PoseReading, other: PoseReading, sensor: ForceSensor | Placement) -> AxesTurn:
    """The sensor's axes by a reading of `turned`, at the angles that people write.

    Args:
        said: The poses as they were said.
        other: With axes that were found.
        sensor: As it was said.
    """
    turn, doubt = other.fit.turn, other.fit.covariance[UNKNOWNS:, UNKNOWNS:]
    sigma = float(np.sqrt(np.linalg.eigvalsh(doubt)[-1]))
    exact = sensor.rotation @ turn
    plain = from_rpy([round(angle / PLAIN) * PLAIN for angle in to_rpy(exact)])
    if Rotation.from_matrix(plain.T @ exact).magnitude() < NEAR * sigma:
        exact = plain
    return AxesTurn(
        sensor=sensor.name,
        rpy=to_rpy(exact),
        angle=(float(Rotation.from_matrix(turn).magnitude()), sigma),
        residual=float(other.fit.scale[0]),
        held_out=(float(said.held_out[0]), float(other.held_out[0])),
    )
