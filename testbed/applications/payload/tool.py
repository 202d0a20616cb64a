"""A tool by the force sensor that carries it: by a recording in motion, or by static poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.applications.payload.payload import (
    PayloadEstimate,
    payload_from,
    seen_of_payload,
)
from testbed.applications.payload.static_fit import RestFit, StaticPoses, fit_tool
from testbed.applications.payload.tool_check import diagnose_tool
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnosed, Diagnostic
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.pseudo_inertia import inertia_matrix
from testbed.core.robot.force_sensor import ForceSensor
from testbed.core.robot.tree import Placement, Tree


def tool_of(tree: Tree, estimate: Estimate) -> PayloadEstimate:
    """What a force sensor carries, about its origin and along its axes.

    Args:
        tree: What the sensor feels.
        estimate: By the sensor, without known zeros.

    Raises:
        SettingsError: The estimate is by no force sensor, or joints lie beyond it.
    """
    sensor = _sensor_of_tool(tree)
    adds = seen_of_payload(tree, estimate.minimal, tree.names[-1]) @ inertia_matrix(
        sensor.X_BS
    )
    count = len(adds)
    noise = estimate.covariance[:count, :count]
    return payload_from(tree.names[-1], adds, estimate.values[:count], noise, "tool")


def _sensor_of_tool(tree: Tree) -> Placement:
    """The sensor that carries a single body."""
    if tree.sensor is None or tree.sensor_body < 0:
        raise SettingsError(
            "a tool is what a force sensor in the robot carries: --sensor LINK"
        )
    if tree.children(tree.sensor_body):
        raise SettingsError(
            "joints lie beyond the force sensor, so that what it carries is no single body: hold "
            "them with --lock"
        )
    return tree.sensor


@dataclass(frozen=True, eq=False)
class ToolEstimate(Diagnosed):
    """A tool by its weight.

    Attributes:
        mass: [kg], and its standard deviation.
        centre: Of mass, in the sensor's frame [m], and standard deviations.
        force_zero: Of the sensor [N], and standard deviations.
        moment_zero: Of the sensor [N m], and standard deviations.
        gravity: Its unit direction in the robot's base frame.
        tilt: Between that and the model's gravity [rad], and its standard deviation.
        residual: Rms of forces [N] and of moments [N m].
        poses: How many there were.
        unidentifiable: What these poses leave open; its numbers are one choice among many.
        share: Rms residual over the tool's weight, of moments by the centre's lever.
        payload: Mass and first moments, about the sensor and along its axes; None where open.
        diagnostics: What a careful reader should know.
    """

    mass: tuple[float, float]
    centre: tuple[tuple[float, float], ...]
    force_zero: tuple[tuple[float, float], ...]
    moment_zero: tuple[tuple[float, float], ...]
    gravity: tuple[float, float, float]
    tilt: tuple[float, float]
    residual: tuple[float, float]
    poses: int
    unidentifiable: tuple[str, ...]
    share: float
    payload: PayloadEstimate | None
    diagnostics: tuple[Diagnostic, ...] = ()


NOTABLE = 0.005
"""Distance from the last joint from which a sensor's place shows where the tool is; else z [m]."""


def tool_at_rest(
    tree: Tree, poses: StaticPoses, sensor: ForceSensor | None = None
) -> ToolEstimate:
    """Mass, centre, the sensor's zero and the direction of gravity by poses at rest.

    Args:
        tree: What the sensor feels, under a gravity of known size.
        poses: Positions of the joints that lead to the sensor, and its readings.
        sensor: In its link's frame; default with the axes that it has in the tree.

    Raises:
        SettingsError: There is no force sensor in the robot, joints lie beyond it, or no gravity.
        RecordingError: The sensor shows no weight.
    """
    carrier = _sensor_of_tool(tree)
    ahead = carrier.rotation.T @ carrier.position
    if np.linalg.norm(ahead) < NOTABLE:
        ahead = (sensor or carrier).rotation[2]
    size = float(np.linalg.norm(tree.gravity))
    if not size:
        raise SettingsError("without gravity there is nothing to weigh a tool by")
    fit = fit_tool(tree, poses)
    if not fit.weight.any():
        raise RecordingError("the force sensor shows no weight in these poses")
    moments, noise = _moments(fit, size)
    body = None
    if not fit.open:
        body = payload_from(tree.names[-1], np.eye(4, 10), moments, noise)
    pairs = np.column_stack([fit.found, np.sqrt(np.diagonal(fit.covariance))]).reshape(
        4, 3, 2
    )
    force_zero, _, moment_zero, centre = (
        tuple(map(tuple, each)) for each in pairs.tolist()
    )
    return ToolEstimate(
        mass=(float(moments[0]), float(np.sqrt(noise[0, 0]))),
        centre=centre,
        force_zero=force_zero,
        moment_zero=moment_zero,
        gravity=tuple((fit.weight / np.linalg.norm(fit.weight)).tolist()),
        tilt=fit.tilt(tree.gravity),
        residual=tuple(fit.scale.tolist()),
        poses=len(poses.wrench),
        unidentifiable=fit.open,
        share=fit.share,
        payload=body,
        diagnostics=(*poses.diagnostics, *diagnose_tool(tree, poses, fit, ahead)),
    )


def _moments(fit: RestFit, gravity: float) -> tuple[Array, Array]:
    """Mass and first moments about the sensor, (4,) [kg, kg m], and their covariance, (4, 4)."""
    length = np.linalg.norm(fit.weight)
    values = length / gravity * np.array([1, *fit.centre])
    slope = np.zeros((4, 12))
    slope[:, 3:6] = np.outer(values, fit.weight / length**2)
    slope[1:, 9:] = values[0] * np.eye(3)
    return values, slope @ fit.covariance @ slope.T
