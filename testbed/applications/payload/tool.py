"""Inertial parameters of a tool on a force sensor, from a motion or static poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.applications.payload.payload import (
    PayloadEstimate,
    payload_from_influence,
    payload_influence,
)
from testbed.applications.payload.static_fit import StaticFit, StaticPoses, fit_tool
from testbed.applications.payload.tool_check import diagnose_tool
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnosed, Diagnostic
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.pseudo_inertia import standard_parameter_transform
from testbed.core.robot.force_sensor import ForceSensor
from testbed.core.robot.tree import SensorPlacement, Tree


def tool_from_motion(tree: Tree, estimate: Estimate) -> PayloadEstimate:
    """Ten inertial parameters of the tool beyond a force sensor, in the sensor's frame.

    Args:
        tree: The robot beyond the force sensor, which is a single body.
        estimate: Estimate from the force sensor, without known zeros.

    Raises:
        SettingsError: The estimate is not from a force sensor, or joints lie beyond the sensor.
    """
    sensor = _sensor_of_tool(tree)
    influence = payload_influence(
        tree, estimate.minimal, tree.names[-1]
    ) @ standard_parameter_transform(sensor.X_BS)
    count = len(influence)
    covariance = estimate.covariance[:count, :count]
    return payload_from_influence(
        tree.names[-1], influence, estimate.values[:count], covariance, "tool"
    )


def _sensor_of_tool(tree: Tree) -> SensorPlacement:
    """Pose of the force sensor in its link's frame.

    Raises:
        SettingsError: The robot has no force sensor on a link, or joints lie beyond the sensor.
    """
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
    """Estimate of a tool from static poses: mass, centre of mass, sensor zeros.

    Attributes:
        mass: Mass with standard deviation [kg].
        centre: Centre of mass in the sensor's frame, with standard deviation, by axis [m].
        force_zero: Zero offset of the sensor's force, with standard deviation, by axis [N].
        moment_zero: Zero offset of the sensor's moment, with standard deviation, by axis [N m].
        gravity: Estimated unit direction of gravity in the robot's base frame.
        tilt: Angle between estimated gravity and the model's gravity, with standard deviation
            [rad].
        residual: Rms residual of forces [N] and of moments [N m].
        pose_count: Number of poses.
        unidentifiable: Names of unknowns that the poses do not identify; their values are those of
            the minimum-norm solution.
        relative_residual: Ratio of rms residual to the tool's weight
            (`StaticFit.relative_residual`).
        payload: Mass and first moments in the sensor's frame; None if an unknown is not
            identifiable.
        diagnostics: Warnings about the poses and the fit.
    """

    mass: tuple[float, float]
    centre: tuple[tuple[float, float], ...]
    force_zero: tuple[tuple[float, float], ...]
    moment_zero: tuple[tuple[float, float], ...]
    gravity: tuple[float, float, float]
    tilt: tuple[float, float]
    residual: tuple[float, float]
    pose_count: int
    unidentifiable: tuple[str, ...]
    relative_residual: float
    payload: PayloadEstimate | None
    diagnostics: tuple[Diagnostic, ...] = ()


MIN_SENSOR_OFFSET = 0.005
"""Smallest distance between sensor and last joint that gives the tool's direction; below it the
sensor's z axis is used [m]."""


def tool_from_static_poses(
    tree: Tree, poses: StaticPoses, sensor: ForceSensor | None = None
) -> ToolEstimate:
    """Estimate mass, centre of mass, sensor zeros and direction of gravity from static poses.

    The result has the diagnostics of the poses and of `diagnose_tool`.

    Args:
        tree: The robot from its base to the sensor, with gravity of known magnitude.
        poses: Positions of the joints between base and sensor, and sensor readings.
        sensor: Placement of the force sensor in its link's frame; default that of the tree. Its z
            axis is taken as the direction to the tool if the sensor is within `MIN_SENSOR_OFFSET`
            of the last joint.

    Raises:
        SettingsError: The robot has no force sensor, joints lie beyond the sensor, or gravity is
            zero.
        RecordingError: The readings contain no weight.
    """
    sensor_pose = _sensor_of_tool(tree)
    ahead = sensor_pose.rotation.T @ sensor_pose.position
    if np.linalg.norm(ahead) < MIN_SENSOR_OFFSET:
        ahead = (sensor or sensor_pose).rotation[2]
    gravity_size = float(np.linalg.norm(tree.gravity))
    if not gravity_size:
        raise SettingsError("without gravity there is nothing to weigh a tool by")
    fit = fit_tool(tree, poses)
    if not fit.weight.any():
        raise RecordingError("the force sensor shows no weight in these poses")
    moments, moment_covariance = _moments(fit, gravity_size)
    payload_estimate = None
    if not fit.unidentifiable:
        payload_estimate = payload_from_influence(
            tree.names[-1], np.eye(4, 10), moments, moment_covariance
        )
    values_and_sigmas = np.column_stack(
        [fit.unknowns, np.sqrt(np.diagonal(fit.covariance))]
    ).reshape(4, 3, 2)
    force_zero, _, moment_zero, centre = (
        tuple(map(tuple, each)) for each in values_and_sigmas.tolist()
    )
    return ToolEstimate(
        mass=(float(moments[0]), float(np.sqrt(moment_covariance[0, 0]))),
        centre=centre,
        force_zero=force_zero,
        moment_zero=moment_zero,
        gravity=tuple((fit.weight / np.linalg.norm(fit.weight)).tolist()),
        tilt=fit.tilt(tree.gravity),
        residual=tuple(fit.rms_residual.tolist()),
        pose_count=len(poses.wrench),
        unidentifiable=fit.unidentifiable,
        relative_residual=fit.relative_residual,
        payload=payload_estimate,
        diagnostics=(*poses.diagnostics, *diagnose_tool(tree, poses, fit, ahead)),
    )


def _moments(fit: StaticFit, gravity: float) -> tuple[Array, Array]:
    """Mass and first moments about the sensor's origin, (4,), and covariance, (4, 4) [kg, kg m].

    Args:
        fit: Fit to the static poses.
        gravity: Magnitude of gravity [m/s^2].
    """
    length = np.linalg.norm(fit.weight)
    values = length / gravity * np.array([1, *fit.centre])
    jacobian = np.zeros((4, 12))
    jacobian[:, 3:6] = np.outer(values, fit.weight / length**2)
    jacobian[1:, 9:] = values[0] * np.eye(3)
    return values, jacobian @ fit.covariance @ jacobian.T
