"""What to doubt of a tool by its weight: axes, units, signs, how the robot is mounted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.arrays import Array
from testbed.diagnostics import Diagnostic, diagnose
from testbed.identification.payload.pose_readings import ALIKE, DOUBTFUL, LEVEL, PoseReading
from testbed.identification.payload.sensor_axes import AxesTurn
from testbed.identification.payload.static_fit import RestFit
from testbed.recordings.importing.foreign_table import FORCES, MOMENTS
from testbed.robot.force_sensor import ForceSensor
from testbed.robot.tree import Placement, Tree

CLEAR = 5.0
"""Standard deviations from which on a difference is no noise."""

WALL, CEILING = np.deg2rad(5.0), np.deg2rad(165.0)
"""From 90 degrees, a robot on a wall; from here on one that hangs, or opposite signs [rad]."""

THINNEST = 10.0
"""Mass of a tool over its centre's distance cubed; below, it were as thin as air [kg/m^3]."""

USUAL_NOISE, USUAL_CENTRE = 0.035, 0.1
"""Noise of sensors' moments over that of forces, and where tools have their centre [m]."""

NOTABLE = 0.005
"""Distance from which a sensor's place on its body shows where the tool is [m]."""

SYSTEMS = {
    "moments-in-mm": ("N", "N mm"),
    "moments-in-cm": ("N", "N cm"),
    "forces-in-kgf": ("kgf", "N m"),
    "forces-in-lbf": ("lbf", "N m"),
    "wrench-in-lbf-in": ("lbf", "lbf in"),
    "wrench-in-lbf-ft": ("lbf", "lbf ft"),
    "wrench-in-kgf-cm": ("kgf", "kgf cm"),
}
"""Units of sensors that may be taken for N and N m, by their code as a cause."""


def checked(
    tree: Tree, said: PoseReading, other: PoseReading | None, zeros: PoseReading | None,
    axes: AxesTurn | None, sensor: ForceSensor | Placement,
) -> Iterator[Diagnostic]:  # fmt: skip
    """What a careful reader should know of a tool at rest.

    Args:
        tree: What the sensor feels.
        said: The poses as they were said.
        other: The reading that explains them better, if any.
        zeros: With other zeros of joints, if that was tried.
        axes: Of the sensor, if `other` has turned them.
        sensor: As it was said.
    """
    fit = (other or said).fit
    place, mass = fit.found[9:], float(np.linalg.norm(fit.weight) / np.linalg.norm(tree.gravity))
    behind = _behind(tree, fit, sensor)
    if axes is not None:
        angle, sigma = np.rad2deg(axes.angle).tolist()
        yield diagnose(
            "tool.axes", value=angle, sigma=sigma, residual=said.fit.scale[0], axes=axes,
            sensor=axes.sensor or "NAME",
            rpy=",".join(f"{round(x, 4) + 0.0:g}" for x in axes.rpy),
        )  # fmt: skip
    elif other is not None:
        code = other.code
        if behind and code == "base-axes" and other.subject != "forces":
            code, place, behind = "turned-base", -place, False
        yield diagnose(
            f"poses.{code}", other.subject, residual=said.fit.scale, left=fit.scale, mass=mass,
            place=", ".join(f"{x:.3f}" for x in place),
        )  # fmt: skip
    elif fit.share > DOUBTFUL:
        code = "tool.residual" if zeros is None else "tool.unexplained"
        yield diagnose(code, value=fit.share)
    if fit.scale[0] <= DOUBTFUL * np.linalg.norm(fit.weight) and not fit.open:
        yield from _of_gravity(tree, fit, said, zeros, behind=behind)
    if fit.share <= DOUBTFUL and not fit.open:
        yield from _of_reach(fit, mass)
    if fit.open:
        yield diagnose("tool.poses", ", ".join(fit.open))


def tilt_of(fit: RestFit, gravity: Array) -> tuple[float, float]:
    """Between the tool's weight and the model's gravity, and its standard deviation [rad]."""
    length = float(np.linalg.norm(fit.weight))
    along, level = fit.weight / length, gravity / np.linalg.norm(gravity)
    across = np.eye(3) - np.outer(along, along)
    tilt = float(np.arctan2(np.linalg.norm(np.cross(along, level)), along @ level))
    return tilt, float(np.sqrt(np.trace(across @ fit.covariance[3:6, 3:6] @ across) / 2)) / length


def _of_gravity(
    tree: Tree, fit: RestFit, said: PoseReading, zeros: PoseReading | None, *, behind: bool
) -> Iterator[Diagnostic]:
    """Gravity that is not the model's, a centre behind the sensor."""
    tilt, sigma = tilt_of(fit, tree.gravity)
    degrees, exact = np.rad2deg(tilt), np.rad2deg(sigma)
    gravity = np.linalg.norm(tree.gravity) * fit.weight / np.linalg.norm(fit.weight)
    words = ",".join(f"{x:.3f}" for x in gravity)
    if tilt > CEILING:
        signs = "forces-opposite" if behind else "opposite-signs"
        yield diagnose(
            "tool.upwards", value=degrees, causes=[signs, "hangs"], sigma=exact, gravity=words
        )
    elif behind:
        yield diagnose("tool.behind", value=float(np.linalg.norm(fit.found[9:])))
    if abs(tilt - np.pi / 2) < WALL:
        yield diagnose("tool.wall", value=degrees, sigma=exact, gravity=words)
    elif max(LEVEL, CLEAR * sigma) < tilt <= CEILING:
        alike = (
            zeros is not None
            and tilt_of(zeros.fit, tree.gravity)[0] < LEVEL
            and np.prod(zeros.held_out) < ALIKE * np.prod(said.held_out)
        )
        shifted = zeros.subject if zeros is not None and alike else ""
        causes = ["not-level", "cable"] if fit.share <= DOUBTFUL else ["cable", "not-level"]
        yield diagnose(
            "tool.level", value=degrees, causes=causes, zeros=shifted, sigma=exact, gravity=words
        )


def _of_reach(fit: RestFit, mass: float) -> Iterator[Diagnostic]:
    """A centre that no tool of this mass has, and the units in which one would have it."""
    arm = float(np.linalg.norm(fit.found[9:]))
    if mass > THINNEST * (arm - CLEAR * float(np.sqrt(np.trace(fit.covariance[9:12, 9:12])))) ** 3:
        return
    noise = float(fit.scale[1] / fit.scale[0])
    fits = []
    for code, (force, moment) in SYSTEMS.items():
        by = MOMENTS[moment] / FORCES[force]
        heavy, near = mass * FORCES[force], arm * by
        if heavy > THINNEST * near**3:
            odd = abs(np.log(noise * by / USUAL_NOISE)) + abs(np.log(near / USUAL_CENTRE))
            fits.append((float(odd), code, f"{heavy:.3g} kg at {near:.3g} m"))
    fits.sort()
    likely = [each for each in fits if each[0] < fits[0][0] + 1]
    causes = [code for _, code, _ in likely] or ["no-unit"]
    so = likely[0][2] if likely else ""
    yield diagnose("tool.reach", value=arm, mass=mass, causes=causes, so=so)


def _behind(tree: Tree, fit: RestFit, sensor: ForceSensor | Placement) -> bool:
    """Whether the centre is on the robot's side of the sensor.

    The tool's side is that away from the joint, or along the link's z where the two coincide.
    """
    own = tree.sensor or sensor
    ahead = own.rotation.T @ own.position
    ahead = ahead if np.linalg.norm(ahead) > NOTABLE else sensor.rotation[2]
    place, doubt = fit.found[9:12], np.sqrt(np.trace(fit.covariance[9:12, 9:12]))
    size = float(np.linalg.norm(place))
    return bool(size > CLEAR * doubt and place @ ahead < -0.5 * size * np.linalg.norm(ahead))
