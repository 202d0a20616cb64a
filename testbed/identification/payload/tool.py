"""A tool by the force sensor that carries it: by a recording in motion, or by static poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed.arrays import Array
from testbed.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.errors import RecordingError, SettingsError, UnknownName, few
from testbed.identification.estimate import Estimate
from testbed.identification.payload.payload import PayloadEstimate, payload_from, seen_of_payload
from testbed.identification.payload.pose_readings import (
    StaticPoses,
    as_said,
    best_other,
    likely_reading,
    with_zero,
)
from testbed.identification.payload.sensor_axes import AxesTurn, axes_turn, turned
from testbed.identification.payload.static_fit import RestFit
from testbed.identification.payload.tool_check import checked, tilt_of
from testbed.recordings.columns import AXES
from testbed.recordings.importing.column_names import read_name
from testbed.recordings.importing.foreign_table import FORCES, MOMENTS, SLIDING, TURNING
from testbed.recordings.importing.likely_signals import (
    BY_SIZE,
    LikelySource,
    clock_of,
    likely_plates,
    likely_signals,
)
from testbed.recordings.importing.readers import open_foreign
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
    sensor = _sensor_of_tool(tree)
    adds = seen_of_payload(tree, estimate.minimal, tree.names[-1]) @ _to_body(sensor)
    count = len(adds)
    noise = estimate.covariance[:count, :count]
    return payload_from(tree.names[-1], adds, estimate.values[:count], noise)


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
    found = np.zeros((10, 10))
    lower = np.tril_indices(3)
    for k, unit in enumerate(np.eye(10)):
        tensor = np.zeros((3, 3))
        tensor[lower] = unit[4:]
        tensor.T[lower] = unit[4:]
        body = Inertia(unit[0], unit[1:4], tensor).moved(sensor.rotation, sensor.position)
        found[:, k] = [body.mass, *body.first_moment, *body.tensor[lower]]
    return found


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
    (_, _, wrench) = next(iter(likely_plates([source])), ("", source, []))
    joints = [] if signal is None else signal.group.names
    missing = [name for name in tree.names if name not in joints]
    roles = {each.role for each in wrench}
    if len(wrench) != len(AXES):
        missing += [axis for k, axis in enumerate(AXES) if divmod(k, 3) not in roles]
    if missing or signal is None:
        raise RecordingError(
            f"'{path}' has no column of numbers for {few(missing, 90)}: a pose's row has "
            f"positions of the joints and {', '.join(AXES)}; found {few(table.columns, 90)}"
        )
    order = [joints.index(name) for name in tree.names]
    by_size = signal.because == BY_SIZE
    read = table.read(x.name for x in (*signal.group.columns, *wrench))
    said = "deg" if degrees else None
    values = []
    for joint, k in zip(tree.joints, order, strict=True):
        units = (TURNING if joint.revolute else SLIDING)["position"]
        unit = signal.units[k] or (said if joint.revolute else None)
        values.append(_in_si(read, signal.group.columns[k].name, unit, units))
    for each, units in zip(wrench, [FORCES] * 3 + [MOMENTS] * 3, strict=True):
        values.append(_in_si(read, each.name, each.unit, units))
    rows = np.column_stack(values)
    whole = rows[np.isfinite(rows).all(axis=1)]
    if len(whole) < LEAST:
        raise RecordingError(
            f"'{path}' holds {len(whole)} whole rows of numbers, a row a pose; {LEAST} poses are "
            "the least, a dozen are better"
        )
    lost = len(rows) - len(whole) + table.cut
    repairs = (("tool.rows", lost),) * (lost > 0) + (("tool.by-size", 0.0),) * by_size
    return StaticPoses(whole[:, : tree.n], whole[:, tree.n :], repairs)


def _in_si(
    read: Mapping[str, Array], column: str, unit: str | None, units: Mapping[str, float]
) -> Array:
    """A column in SI; without a unit it is."""
    if unit is not None and unit not in units:
        raise UnknownName(f"unit of column '{column}'", unit, units)
    return read[column] * (units[unit] if unit else 1.0)


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
    place = _sensor_of_tool(tree)
    if not tree.gravity.any():
        raise SettingsError("without gravity there is nothing to weigh a tool by")
    said, other, zeros = as_said(tree, table), None, None
    fit = said.fit
    if not fit.weight.any():
        raise RecordingError("the force sensor shows no weight in these poses")
    if len(table.wrench) >= ENOUGH:
        zeros = with_zero(tree, table)
        other = likely_reading(said, [best_other(tree, table), turned(said), zeros])
    axes = axes_turn(said, other, sensor or place) if other and other.code == "axes" else None
    sigmas = np.sqrt(np.diagonal(fit.covariance)).reshape(4, 3)
    zero, _, zero_moment, centre = (
        tuple((float(v), float(s)) for v, s in zip(values, sigma, strict=True))
        for values, sigma in zip(fit.found.reshape(4, 3), sigmas, strict=True)
    )
    size, length = float(np.linalg.norm(tree.gravity)), float(np.linalg.norm(fit.weight))
    along = fit.weight / length
    doubt = float(np.sqrt(along @ fit.covariance[3:6, 3:6] @ along))
    repairs = [diagnose(code, value=value) for code, value in table.repairs]
    return ToolEstimate(
        mass=(length / size, doubt / size),
        centre=centre,
        force_zero=zero,
        moment_zero=zero_moment,
        gravity=(float(along[0]), float(along[1]), float(along[2])),
        tilt=tilt_of(fit, tree.gravity),
        residual=(float(fit.scale[0]), float(fit.scale[1])),
        poses=len(table.wrench),
        unidentifiable=fit.open,
        share=fit.share,
        payload=None if fit.open else _payload(tree, fit),
        axes=axes,
        diagnostics=(*repairs, *checked(tree, said, other, zeros, axes, sensor or place)),
    )


def _payload(tree: Tree, fit: RestFit) -> PayloadEstimate:
    """Mass and first moments, about the sensor's origin and along its axes."""
    size, place = float(np.linalg.norm(tree.gravity)), fit.found[9:]
    mass = float(np.linalg.norm(fit.weight)) / size
    slope = np.zeros((4, 12))
    slope[:, 3:6] = np.outer([1, *place], fit.weight / mass) / size**2
    slope[1:, 9:] = mass * np.eye(3)
    moments = mass * np.array([1, *place])
    return payload_from(tree.names[-1], np.eye(4, 10), moments, slope @ fit.covariance @ slope.T)
