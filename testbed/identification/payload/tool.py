"""A tool by the force sensor that carries it: by a recording in motion, or by static poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.arrays import Array, freeze
from testbed.codec import with_properties
from testbed.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.dynamics.newton_euler import sensor_poses
from testbed.errors import RecordingError, SettingsError
from testbed.identification.estimate import Estimate
from testbed.identification.payload.payload import PayloadEstimate, payload_from, seen_of_payload
from testbed.identification.payload.sensor_axes import DOUBTFUL, AxesTurn, axes_turn
from testbed.identification.payload.static_fit import RestFit, rest_fit
from testbed.recordings.columns import AXES
from testbed.recordings.importing.readers.delimited_text import read_file
from testbed.robot.force_sensor import ForceSensor
from testbed.robot.inertia import Inertia
from testbed.robot.tree import Placement, Tree

LEAST = 4
"""Poses that leave more numbers than unknowns, in forces and in moments."""


def tool_of(tree: Tree, estimate: Estimate) -> PayloadEstimate:
    """What a force sensor carries, about its origin and along its axes.

    Args:
        tree: What the sensor feels.
        estimate: By the sensor, without known zeros.

    Raises:
        SettingsError: The estimate is by no force sensor, or joints lie beyond it.
    """
    if tree.sensor is None or tree.sensor_body < 0 or not estimate.minimal.of_sensor:
        raise SettingsError("a tool is what a force sensor in the robot carries: --sensor LINK")
    if tree.children(tree.sensor_body):
        raise SettingsError(
            "joints lie beyond the force sensor, so that what it carries is no single body: hold "
            "them with --lock"
        )
    adds = seen_of_payload(tree, estimate.minimal, tree.names[-1]) @ _to_body(tree.sensor)
    count = len(adds)
    noise = estimate.covariance[:count, :count]
    return payload_from(tree.names[-1], adds, estimate.values[:count], noise)


def _to_body(sensor: Placement) -> Array:
    """Standard parameters about the body's frame from those about the sensor's, (10, 10)."""
    found = np.zeros((10, 10))
    lower = np.tril_indices(3)
    for k, unit in enumerate(np.eye(10)):
        tensor = np.zeros((3, 3))
        tensor[lower] = unit[4:]
        tensor.T[lower] = unit[4:]
        body = Inertia(unit[0], unit[1:4], tensor).moved(sensor.rotation, sensor.position)
        found[:, k] = [body.mass, *body.first_moment, *body.tensor[lower]]
    return found


@dataclass(frozen=True, eq=False)
class StaticPoses:
    """Poses at rest: joint positions, and what a force sensor showed.

    Attributes:
        position: Of the joints that lead to the sensor, (P, n) [rad or m].
        wrench: (P, 6) [N, N m].
    """

    position: Array
    wrench: Array

    def __post_init__(self) -> None:
        freeze(self, wrench=(None, 6))
        shape = (len(self.wrench), np.shape(self.position)[-1])
        freeze(self, position=shape)


def read_static_poses(path: Path, tree: Tree, *, degrees: bool = False) -> StaticPoses:
    """A table of poses: a row a pose, a heading with the joints' names and Fx ... Mz.

    Args:
        path: Text, as the importer of recordings reads it.
        tree: What the sensor feels.
        degrees: Whether angles are in degrees.

    Raises:
        RecordingError: It is no such table.
    """
    found = read_file(path, None)
    if found.cut:
        raise RecordingError(f"'{path}': the last row of the table is not complete")
    known = {name.lower(): name for name in found.shapes}
    wanted = [*tree.names, *AXES]
    missing = [name for name in wanted if name.lower() not in known]
    if missing:
        raise RecordingError(
            f"'{path}' has no column '{missing[0]}': a table of poses has a heading with the "
            f"joints' names and {', '.join(AXES)}, found {', '.join(found.shapes)[:200]}"
        )
    columns = found.read(known[name.lower()] for name in wanted)
    table = np.column_stack([columns[known[name.lower()]] for name in wanted])
    if len(table) < LEAST or not np.isfinite(table).all():
        raise RecordingError(
            f"'{path}' holds {len(table)} poses; {LEAST} of finite numbers are the least"
        )
    position, wrench = table[:, : tree.n], table[:, tree.n :]
    if degrees:
        turns = [joint.revolute for joint in tree.joints]
        position = np.where(turns, np.deg2rad(position), position)
    return StaticPoses(position, wrench)


@dataclass(frozen=True)
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
        share: Rms residual of forces over the tool's weight.
        axes: Other axes of the sensor that explain the readings; None where those said will do.
        upwards: Whether the tool would be pulled against the model's gravity, by these axes.
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
    axes: AxesTurn | None = None
    upwards: bool = False

    __get_pydantic_core_schema__ = with_properties("diagnostics")

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Axes other than those said, large residuals, poses that are missing."""
        said: list[Diagnostic] = []
        if self.axes is not None:
            angle, sigma = np.rad2deg(self.axes.angle).tolist()
            said.append(
                diagnose(
                    "tool.axes", value=angle, sigma=sigma, residual=self.residual[0],
                    left=self.axes.residual, before=self.axes.held_out[0],
                    after=self.axes.held_out[1], sensor=self.axes.sensor or "NAME",
                    rpy=",".join(f"{round(x, 4) + 0.0:g}" for x in self.axes.rpy),
                )
            )  # fmt: skip
        elif self.share > DOUBTFUL:
            said.append(diagnose("tool.residual", value=self.share))
        if self.upwards and (self.axes is not None or self.share <= DOUBTFUL):
            said.append(diagnose("tool.upwards"))
        if self.unidentifiable:
            said.append(diagnose("tool.poses", ", ".join(self.unidentifiable)))
        return tuple(said)


def tool_at_rest(tree: Tree, table: StaticPoses, sensor: ForceSensor | None = None) -> ToolEstimate:
    """Mass, centre, the sensor's zero and the direction of gravity by poses at rest.

    Args:
        tree: What the sensor feels, under a gravity of known size.
        table: The poses.
        sensor: As it was said; default with the axes that it has in the tree.

    Raises:
        SettingsError: There is no force sensor in the robot, or no gravity.
        RecordingError: The sensor shows no weight.
    """
    if tree.sensor is None or tree.sensor_body < 0:
        raise SettingsError("a tool is what a force sensor in the robot carries: --sensor LINK")
    if not tree.gravity.any():
        raise SettingsError("without gravity there is nothing to weigh a tool by")
    back = np.swapaxes(sensor_poses(tree, table.position)[0], 1, 2)
    fit = rest_fit(back, table.wrench)
    axes = axes_turn(back, table.wrench, sensor or tree.sensor)
    return _estimate(tree.gravity, fit, axes, len(back))


def _estimate(gravity: Array, fit: RestFit, axes: AxesTurn | None, poses: int) -> ToolEstimate:
    """What is said of a tool, from the unknowns and their covariance."""
    sigmas = np.sqrt(np.diagonal(fit.covariance)).reshape(4, 3)
    zero, _, zero_moment, centre = (
        tuple((float(v), float(s)) for v, s in zip(values, sigma, strict=True))
        for values, sigma in zip(fit.found.reshape(4, 3), sigmas, strict=True)
    )
    size, pull, doubt = float(np.linalg.norm(gravity)), fit.found[3:6], fit.covariance[3:6, 3:6]
    length = float(np.linalg.norm(pull))
    along, expected = pull / length, gravity / size
    across = np.eye(3) - np.outer(along, along)
    tilt = float(np.arctan2(np.linalg.norm(np.cross(along, expected)), along @ expected))
    return ToolEstimate(
        mass=(length / size, float(np.sqrt(along @ doubt @ along)) / size),
        centre=centre,
        force_zero=zero,
        moment_zero=zero_moment,
        gravity=(float(along[0]), float(along[1]), float(along[2])),
        tilt=(tilt, float(np.sqrt(np.trace(across @ doubt @ across) / 2)) / length),
        residual=(float(fit.scale[0]), float(fit.scale[1])),
        poses=poses,
        unidentifiable=fit.open,
        share=float(fit.scale[0]) / length,
        axes=axes,
        upwards=bool((pull if axes is None else np.array(axes.weight)) @ gravity < 0),
    )
