"""A tool by the force sensor that carries it: from one recording in motion, or from static poses.

At rest the sensor shows F = F0 - R' G and M = M0 - c x R' G, with R from the sensor's axes to the
ground's, G the tool's weight on the ground, c its centre, and a zero F0, M0. All twelve unknowns
are found together by Gauss-Newton, from linear fits of the forces and then of the moments.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from testbed.arrays import Array, readonly, skew
from testbed.dynamics.newton_euler import sensor_poses
from testbed.errors import RecordingError, SettingsError
from testbed.identification.estimate import Estimate
from testbed.identification.payload.payload import PayloadEstimate, payload_from, seen_of_payload
from testbed.recordings.columns import AXES
from testbed.recordings.importing.readers.delimited_text import read_file
from testbed.robot.inertia import Inertia
from testbed.robot.tree import Placement, Tree

UNKNOWNS = 12
"""Zero of force and moment, weight, centre: three each."""

LEAST = 4
"""Poses that leave more numbers than unknowns, in forces and in moments."""

SMALLEST = 1e-6
"""Singular values below this share of the largest are rounding, or poses that are all alike."""

STEPS = 20
"""Of Gauss-Newton at most."""


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
        object.__setattr__(self, "wrench", readonly(self.wrench, (None, 6), "wrench"))
        shape = (len(self.wrench), np.shape(self.position)[-1])
        object.__setattr__(self, "position", readonly(self.position, shape, "position"))


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
class ToolEstimate:
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


def tool_at_rest(tree: Tree, table: StaticPoses) -> ToolEstimate:
    """Mass, centre, the sensor's zero and the direction of gravity by poses at rest.

    Args:
        tree: What the sensor feels, under a gravity of known size.
        table: The poses.

    Raises:
        SettingsError: There is no force sensor in the robot, or no gravity.
        RecordingError: The sensor shows no weight.
    """
    if tree.sensor_body < 0:
        raise SettingsError("a tool is what a force sensor in the robot carries: --sensor LINK")
    if not tree.gravity.any():
        raise SettingsError("without gravity there is nothing to weigh a tool by")
    turns, _ = sensor_poses(tree, table.position)
    back = np.swapaxes(turns, 1, 2)
    force, moment = table.wrench[:, :3], table.wrench[:, 3:]
    weight, zero, centre, zero_moment = _start(back, force, moment)
    found = np.concatenate([zero, weight, zero_moment, centre])
    scale = np.ones(2)
    for _ in range(STEPS):
        rows, rest = _linearised(back, force, moment, found)
        scale = _scale(rest)
        weighted = rows / np.tile(np.repeat(scale, 3), len(back))[:, None]
        left, sizes, right = _svd(weighted)
        step = right.T @ (left.T @ (rest / np.tile(np.repeat(scale, 3), len(back))) / sizes)
        found = found + step
        if np.abs(step).max() < 1e-12 * np.abs(found).max():
            break
    covariance = (right.T / sizes**2) @ right
    open_part = 1 - np.sum(right**2, axis=0)
    freedom = len(rest) - len(sizes)
    widened = float(stats.t.ppf(0.975, max(freedom, 1)) / stats.norm.ppf(0.975))
    return _estimate(tree, found, covariance * widened**2, open_part, scale, len(back))


def _start(back: Array, force: Array, moment: Array) -> tuple[Array, Array, Array, Array]:
    """Linear fits: weight and zero by the forces, centre and zero by the moments."""
    ones = np.tile(np.eye(3), (len(back), 1))
    by_force = np.hstack([ones, -back.reshape(-1, 3)])
    zero_and_weight = np.array(np.linalg.lstsq(by_force, force.ravel(), rcond=SMALLEST)[0])
    weight = zero_and_weight[3:]
    if not np.linalg.norm(weight) > 0:
        raise RecordingError("the force sensor shows no weight in these poses")
    lever = skew(back @ weight).reshape(-1, 3)
    by_moment = np.hstack([ones, lever])
    zero_and_centre = np.array(np.linalg.lstsq(by_moment, moment.ravel(), rcond=SMALLEST)[0])
    return weight, zero_and_weight[:3], zero_and_centre[3:], zero_and_centre[:3]


def _linearised(back: Array, force: Array, moment: Array, found: Array) -> tuple[Array, Array]:
    """Derivatives of all that is shown by the unknowns, (6 P, 12), and what they leave, (6 P,)."""
    zero, weight, zero_moment, centre = found.reshape(4, 3)
    pull = back @ weight
    rows = np.zeros((len(back), 6, UNKNOWNS))
    rows[:, :3, :3] = rows[:, 3:, 6:9] = np.eye(3)
    rows[:, :3, 3:6] = -back
    rows[:, 3:, 3:6] = -skew(centre) @ back
    rows[:, 3:, 9:] = skew(pull)
    shown = np.hstack([zero - pull, zero_moment - np.cross(centre, pull)])
    return rows.reshape(-1, UNKNOWNS), (np.hstack([force, moment]) - shown).ravel()


def _scale(rest: Array) -> Array:
    """Noise of forces and of moments by what is left, each with six unknowns of its own, (2,)."""
    parts = rest.reshape(-1, 2, 3)
    count = max(3 * len(parts) - UNKNOWNS // 2, 1)
    sizes = np.sqrt((parts**2).sum(axis=(0, 2)) / count)
    return np.asarray(np.maximum(sizes, 1e-9 * max(sizes.max(), 1e-9)))


def _svd(rows: Array) -> tuple[Array, Array, Array]:
    """Of what is seen only: singular values, and vectors to either side."""
    left, sizes, right = np.linalg.svd(rows, full_matrices=False)
    rank = int((sizes > SMALLEST * sizes[0]).sum())
    found: tuple[Array, Array, Array] = left[:, :rank], sizes[:rank], right[:rank]
    return found


NAMES = ("force zero", "mass and gravity", "moment zero", "centre")
"""Of the unknowns, three by three."""

OPEN = 1e-6
"""Part of an unknown that no combination of the readings holds, above which it is open."""


def _estimate(
    tree: Tree, found: Array, covariance: Array, open_part: Array, scale: Array, count: int
) -> ToolEstimate:
    """What is said of a tool, from the unknowns and their covariance."""
    zero, weight, zero_moment, centre = (
        [(float(v), float(s)) for v, s in zip(values, sigma, strict=True)]
        for values, sigma in zip(
            found.reshape(4, 3), np.sqrt(np.diagonal(covariance)).reshape(4, 3), strict=True
        )
    )
    del weight
    size, gravity = float(np.linalg.norm(tree.gravity)), tree.gravity
    pull, doubt = found[3:6], covariance[3:6, 3:6]
    length = float(np.linalg.norm(pull))
    along = pull / length
    expected = gravity / size
    across = np.eye(3) - np.outer(along, along)
    tilt = float(np.arctan2(np.linalg.norm(np.cross(along, expected)), along @ expected))
    return ToolEstimate(
        mass=(length / size, float(np.sqrt(along @ doubt @ along)) / size),
        centre=tuple(centre),
        force_zero=tuple(zero),
        moment_zero=tuple(zero_moment),
        gravity=(float(along[0]), float(along[1]), float(along[2])),
        tilt=(tilt, float(np.sqrt(np.trace(across @ doubt @ across) / 2)) / length),
        residual=(float(scale[0]), float(scale[1])),
        poses=count,
        unidentifiable=tuple(
            name
            for name, part in zip(NAMES, open_part.reshape(4, 3), strict=True)
            if part.max() > OPEN
        ),
        share=float(scale[0]) / length,
    )
