"""How a force sensor's axes are turned in truth, by readings at rest.

A turn is fitted with all else from each of the 24 turns that take axes to axes: none is further
than 63 degrees from one of them. It is proposed if poses that were left out of the fit are far
better predicted with it, and what it leaves is small beside the tool's weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.arrays import Array
from testbed.identification.payload.static_fit import UNKNOWNS, RestFit, rest_fit
from testbed.robot.force_sensor import ForceSensor
from testbed.robot.inertia import from_rpy, to_rpy
from testbed.robot.tree import Placement

ENOUGH = 6
"""Poses from which a turn can be tried on some of them."""

FEW = 60
"""Poses by which the best start is found."""

TRIALS = 6
"""Parts of the poses that are left out, one after the other."""

BETTER = 0.5
"""Errors in poses left out with a turn over those without, below which it is proposed."""

DOUBTFUL = 0.03
"""Part of a tool's weight in the residuals above which the poses are not of this sensor."""

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
        weight: Of the tool with them, along the base's axes [N].
    """

    sensor: str
    rpy: tuple[float, float, float]
    angle: tuple[float, float]
    residual: float
    held_out: tuple[float, float]
    weight: tuple[float, float, float]


def axes_turn(back: Array, wrench: Array, said: ForceSensor | Placement) -> AxesTurn | None:
    """The turn of a sensor's axes that is proposed; None where those that were said will do.

    Args:
        back: From the base's axes to the sensor's as they were said, (P, 3, 3).
        wrench: The readings, (P, 6) [N, N m].
        said: The sensor as it was said.
    """
    if len(back) < ENOUGH:
        return None
    some = slice(None, None, -(-len(back) // FEW))
    starts = Rotation.create_group("O").as_matrix()
    tried = [rest_fit(back[some], wrench[some], start) for start in starts]
    best = rest_fit(back, wrench, min(tried, key=lambda fit: float(np.prod(fit.scale))).turn)
    turn, doubt = best.turn, best.covariance[UNKNOWNS:, UNKNOWNS:]
    before, after = _held_out(back, wrench, None), _held_out(back, wrench, turn)
    small = best.scale[0] < DOUBTFUL * np.linalg.norm(best.found[3:6])
    if best.open or not small or (after > BETTER * before).any():
        return None
    sigma = float(np.sqrt(np.linalg.eigvalsh(doubt)[-1]))
    exact = said.rotation @ turn
    plain = from_rpy([round(angle / PLAIN) * PLAIN for angle in to_rpy(exact)])
    if Rotation.from_matrix(plain.T @ exact).magnitude() < NEAR * sigma:
        exact = plain
    angle = float(Rotation.from_matrix(turn).magnitude())
    return AxesTurn(
        sensor=said.name,
        rpy=to_rpy(exact),
        angle=(angle, sigma),
        residual=float(best.scale[0]),
        held_out=(float(before[0]), float(after[0])),
        weight=tuple(best.found[3:6].tolist()),
    )


def _held_out(back: Array, wrench: Array, turn: Array | None) -> Array:
    """Rms errors of forces and of moments in poses that a fit has not used, (2,)."""
    errors = np.empty_like(wrench)
    for part in range(TRIALS):
        out = np.arange(len(back)) % TRIALS == part
        fit: RestFit = rest_fit(back[~out], wrench[~out], turn)
        errors[out] = fit.errors(back[out], wrench[out])
    return np.asarray(np.sqrt((errors.reshape(-1, 2, 3) ** 2).mean(axis=(0, 2))))
