"""What to doubt of a tool by its weight: axes, units, signs, how the robot is mounted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.applications.payload.static_fit import (
    BASES,
    RestFit,
    StaticPoses,
    fit_tool,
)
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, Level, diagnose
from testbed.core.robot.tree import Tree

DOUBTFUL = 0.03
"""Part of a tool's weight in the residuals above which the poses are not explained."""

GROSS = 0.1
"""The same part above which what was found is in doubt, and not only uncertain."""

CLEAR = 5.0
"""Standard deviations from which on a difference is no noise."""

LEVEL = float(np.deg2rad(3.0))
"""Tilt of gravity up to which a base is called level [rad]."""

WALL, CEILING = np.deg2rad([5.0, 165.0])
"""From 90 degrees, a robot on a wall; from here on one that hangs, or opposite signs [rad]."""

BEHIND = -0.5
"""Cosine of a centre's direction to the tool's side below which it is on the robot's."""

THINNEST, AIR = 10.0, 1.0
"""Mass over the centre's distance cubed of which tools have more, where other units are likelier;
and of which all have more [kg/m^3]."""

USUAL = np.array([0.035, 0.1])
"""Noise of sensors' moments over that of forces, and where tools have their centre [m]."""

SYSTEMS = {
    "": (1.0, 1.0),
    "moments-in-mm": (1.0, 1e-3),
    "moments-in-cm": (1.0, 1e-2),
    "forces-in-kgf": (9.80665, 1 / 9.80665),
    "forces-in-lbf": (4.44822, 1 / 4.44822),
    "wrench-in-lbf-in": (4.44822, 0.0254),
    "wrench-in-lbf-ft": (4.44822, 0.3048),
    "wrench-in-kgf-cm": (9.80665, 0.01),
}
"""Units of sensors by their code as a cause, "" for N and N m: force [N], moment over it [m]."""


def diagnose_tool(
    tree: Tree, poses: StaticPoses, fit: RestFit, ahead: Array
) -> Iterator[Diagnostic]:
    """Diagnose a tool identified at rest: residuals, signs, units, gravity.

    Args:
        tree: The robot from its base to the sensor.
        poses: The table.
        fit: Of the table as it is stated.
        ahead: From the robot to the tool, along the sensor's axes, (3,).
    """
    if fit.share > DOUBTFUL and not fit.open:
        others = {code: fit_tool(tree, poses, code) for code in ("degrees", *BASES)}
        fitting = [code for code, other in others.items() if other.share < DOUBTFUL]
        if fitting:
            code = min(fitting, key=lambda each: _is_behind(others[each], ahead))
            other = others[code]
            yield diagnose(
                f"tool.{code}",
                residual=fit.scale,
                left=other.scale,
                mass=other.mass(tree.gravity),
                place=_listed(other.centre),
            )
            return
        # below, noise will do it
        level: Level = "error" if fit.share > GROSS else "warning"
        yield diagnose("tool.residual", value=fit.share, level=level)
    if fit.open:
        yield diagnose("tool.poses", ", ".join(fit.open))
    elif fit.scale[0] <= DOUBTFUL * np.linalg.norm(fit.weight):
        yield from _implausible(fit, tree.gravity, ahead)


def _is_behind(fit: RestFit, ahead: Array) -> bool:
    """Whether a centre of mass is on the robot's side of the sensor."""
    if fit.arm <= CLEAR * _centre_sigma(fit):
        return False
    return bool(fit.centre @ ahead < BEHIND * fit.arm * np.linalg.norm(ahead))


def _centre_sigma(fit: RestFit) -> float:
    return float(np.sqrt(np.trace(fit.covariance[9:, 9:])))


def _implausible(fit: RestFit, gravity: Array, ahead: Array) -> Iterator[Diagnostic]:
    """Diagnose directions of gravity and places of the centre that tools do not have."""
    sure, size = fit.share <= DOUBTFUL, float(np.linalg.norm(gravity))
    behind = sure and _is_behind(fit, ahead)
    tilt, sigma = fit.tilt(gravity)
    code, causes = "", ["not-level", "cable"] if sure else ["cable", "not-level"]
    if tilt > CEILING:
        code, causes = (
            "upwards",
            ["forces-opposite" if behind else "opposite-signs", "hangs"],
        )
    elif abs(tilt - np.pi / 2) < WALL:
        code, causes = "wall", []
    elif tilt > max(LEVEL, CLEAR * sigma):
        code = "level"
    if behind and code != "upwards":
        yield diagnose("tool.behind", value=fit.arm)
    if code:
        pull = _listed(size * fit.weight / np.linalg.norm(fit.weight))
        angle, doubt = np.rad2deg([tilt, sigma]).tolist()
        yield diagnose(
            f"tool.{code}", value=angle, sigma=doubt, causes=causes, gravity=pull
        )
    mass = fit.mass(gravity)
    units = _unit_systems(fit, mass)
    near = fit.arm - CLEAR * _centre_sigma(fit)
    if sure and mass < (THINNEST if units else AIR) * near**3:
        yield diagnose(
            "tool.reach", value=fit.arm, mass=mass, causes=units or ["no-unit"]
        )


def _unit_systems(fit: RestFit, mass: float) -> list[str]:
    """Unit systems with plausible sensor noise and centre of mass, the likeliest first."""
    shown = np.array([fit.scale[1] / fit.scale[0], fit.arm])
    odd = sorted(
        (float(np.abs(np.log(shown * by / USUAL)).sum()), code)
        for code, (force, by) in SYSTEMS.items()
        if mass * force > THINNEST * (fit.arm * by) ** 3 or not code
    )
    return [code for each, code in odd if each < odd[0][0] + 1 and odd[0][1] and code]


def _listed(values: Array) -> str:
    return ",".join(f"{round(float(x), 4) + 0.0:g}" for x in values)
