"""A tool by the force sensor that carries it: by a recording in motion, or by static poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed.applications.payload.payload import PayloadEstimate, payload_from, seen_of_payload
from testbed.applications.payload.pose_readings import (
    ALIKE,
    StaticPoses,
    other_readings,
    reading_of,
    with_zero,
)
from testbed.applications.payload.sensor_axes import AxesTurn, axes_turn, turned
from testbed.applications.payload.tool_check import diagnose_tool, explains
from testbed.bodies.prior import matrices, parameters
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.errors import RecordingError, SettingsError, UnknownName, few
from testbed.core.estimation.estimate import Estimate
from testbed.core.recordings.columns import AXES
from testbed.core.robot.force_sensor import ForceSensor
from testbed.core.robot.tree import Placement, Tree
from testbed.importing.column_names import Group, read_name
from testbed.importing.foreign_table import FORCES, MOMENTS, SLIDING, TURNING
from testbed.importing.likely_clock import clock_of
from testbed.importing.likely_signals import (
    BY_SIZE,
    LikelySource,
    likely_plates,
    likely_signals,
)
from testbed.importing.readers import open_foreign

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
    sensor = _sensor_of_tool(tree)
    adds = seen_of_payload(tree, estimate.minimal, tree.names[-1]) @ _to_body(sensor)
    count = len(adds)
    noise = estimate.covariance[:count, :count]
    return payload_from(tree.names[-1], adds, estimate.values[:count], noise, "tool")


def _sensor_of_tool(tree: Tree) -> Placement:
    """The sensor that carries a single body."""
    if tree.sensor is None or tree.sensor_body < 0:
        raise SettingsError("a tool is what a force sensor in the robot carries: --sensor LINK")
    if tree.children(tree.sensor_body):
        raise SettingsError(
            "joints lie beyond the force sensor, so that what it carries is no single body: hold "
            "them with --lock"
        )
    return tree.sensor


def _to_body(sensor: Placement) -> Array:
    """Standard parameters about the body's frame from those about the sensor's, (10, 10)."""
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = sensor.rotation, sensor.position
    return parameters(place @ matrices(np.eye(10)) @ place.T).T


def read_static_poses(path: Path, tree: Tree, *, degrees: bool = False) -> StaticPoses:
    """A table of poses: a row a pose, its heading read as the importer of recordings reads it.

    Args:
        path: Of any format that is imported.
        tree: What the sensor feels.
        degrees: Whether angles without a unit are in degrees.

    Raises:
        RecordingError: It is no such table.
        UnknownName: A heading has a unit of something else.
    """
    table = open_foreign(path)
    clock = clock_of(table)
    names = [read_name(each, table.unit(each)) for each in table.columns if each != clock.column]
    columns = [replace(x, kind="position") if x.kind is x.unit is None else x for x in names]
    source = LikelySource("poses", path, None, table, tuple(columns), clock)
    signal = likely_signals([source], tree.names).get("position")
    wrench = next((each for _, _, each in likely_plates([source], {})), [])
    group = signal.group if signal else Group((), ())
    numbers = () if group.matched else group.numbers
    counted = enumerate(tree.names, int(0 not in numbers))
    missing = [name for k, name in counted if name not in group.names and k not in numbers]
    if len(wrench) != len(AXES):
        roles = {each.role for each in wrench}
        missing += [axis for k, axis in enumerate(AXES) if divmod(k, 3) not in roles]
    if missing or signal is None:
        raise RecordingError(
            f"'{path}' has no column of numbers for {few(missing, 90)}: a row has positions of the "
            f"joints and {', '.join(AXES)}; found {few(table.columns, 90)}"
        )
    asked = [(each, each.unit, FORCES if k < 3 else MOMENTS) for k, each in enumerate(wrench)]
    for k, joint in enumerate(tree.joints):
        at = group.names.index(joint.name)
        unit = signal.units[at] or ("deg" if degrees and joint.revolute else None)
        units = (TURNING if joint.revolute else SLIDING)["position"]
        asked.insert(k, (group.columns[at], unit, units))
    read, values = table.read(each.name for each, _, _ in asked), []
    for each, unit, units in asked:
        if unit and unit not in units:
            raise UnknownName(f"unit of column '{each.name}'", unit, units)
        values.append(read[each.name] * (units[unit] if unit else 1.0))
    rows = np.column_stack(values)
    whole = rows[np.isfinite(rows).all(axis=1)]
    if len(whole) < LEAST:
        raise RecordingError(
            f"'{path}' holds {len(whole)} whole rows of numbers, a row a pose; {LEAST} poses are "
            "the least, a dozen are better"
        )
    lost = len(rows) - len(whole) + table.cut
    repairs = [diagnose("tool.rows", value=lost)] * (lost > 0)
    repairs += [diagnose("tool.by-size")] * (signal.because == BY_SIZE)
    return StaticPoses(whole[:, : tree.n], whole[:, tree.n :], tuple(repairs))


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
        axes: Other axes of the sensor that explain the readings; None where those said will do.
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
    axes: AxesTurn | None = None
    diagnostics: tuple[Diagnostic, ...] = ()


ENOUGH = 6
"""Poses from which other readings can be tried on some of them."""

NOTABLE = 0.005
"""Distance from the last joint from which a sensor's place shows where the tool is; else z [m]."""


def tool_at_rest(tree: Tree, table: StaticPoses, sensor: ForceSensor | None = None) -> ToolEstimate:
    """Mass, centre, the sensor's zero and the direction of gravity by poses at rest.

    Args:
        tree: What the sensor feels, under a gravity of known size.
        table: The poses.
        sensor: As it was said; default with the axes that it has in the tree.

    Raises:
        SettingsError: There is no force sensor in the robot, joints lie beyond it, or no gravity.
        RecordingError: The sensor shows no weight.
    """
    carrier = _sensor_of_tool(tree)
    place, ahead = sensor or carrier, carrier.rotation.T @ carrier.position
    if np.linalg.norm(ahead) < NOTABLE:
        ahead = place.rotation[2]
    size = float(np.linalg.norm(tree.gravity))
    if not size:
        raise SettingsError("without gravity there is nothing to weigh a tool by")
    said, zero = reading_of(tree, table.position, table.wrench), None
    best, fit = said, said.fit
    if not fit.weight.any():
        raise RecordingError("the force sensor shows no weight in these poses")
    if len(table.wrench) >= ENOUGH:
        zero = with_zero(tree, table)
        others = (*other_readings(tree, table), turned(said), zero)
        tried = [each for each in others if explains(each, said)]
        least = min((x.held_out for x in tried), default=0.0)
        best = next((x for x in tried if x.held_out < ALIKE * least), said)
    axes = axes_turn(best.fit, place.rotation) if best.code == "axes" else None
    pull = fit.weight / np.linalg.norm(fit.weight)
    mass = float(pull @ fit.weight) / size
    moments = np.array([1, *fit.found[9:12]])
    slope = np.zeros((4, 12))
    slope[:, 3:6] = np.outer(moments, pull / size)
    slope[1:, 9:] = mass * np.eye(3)
    noise = slope @ fit.covariance @ slope.T
    sigma = np.sqrt(np.diagonal(fit.covariance))
    force_zero, _, moment_zero, centre = (
        tuple(zip(values.tolist(), sigmas.tolist(), strict=True))
        for values, sigmas in zip(fit.found.reshape(4, 3), sigma.reshape(4, 3), strict=True)
    )
    return ToolEstimate(
        mass=(mass, float(np.sqrt(noise[0, 0]))),
        centre=centre,
        force_zero=force_zero,
        moment_zero=moment_zero,
        gravity=(float(pull[0]), float(pull[1]), float(pull[2])),
        tilt=fit.tilt(tree.gravity),
        residual=(float(fit.scale[0]), float(fit.scale[1])),
        poses=len(table.wrench),
        unidentifiable=fit.open,
        share=fit.share,
        payload=None
        if fit.open
        else payload_from(tree.names[-1], np.eye(4, 10), mass * moments, noise),
        axes=axes,
        diagnostics=(
            *table.diagnostics,
            *diagnose_tool(said, best, zero, tree.gravity, axes, ahead, place.name),
        ),
    )
