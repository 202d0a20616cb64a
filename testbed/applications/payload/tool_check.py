"""Plausibility checks of a tool's weight: axes, units, signs, mounting of the robot."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.applications.payload.static_fit import (
    BASE_AXIS_SIGNS,
    StaticFit,
    StaticPoses,
    fit_tool,
)
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, Level, make_diagnostic
from testbed.core.robot.tree import Tree

MAX_RESIDUAL_SHARE = 0.03
"""Largest rms residual of a good fit, relative to the tool's weight."""

ERROR_RESIDUAL_SHARE = 0.1
"""Relative rms residual above which the diagnostic is an error, not a warning."""

Z_THRESHOLD = 5.0
"""Smallest significant difference, in standard deviations."""

MAX_LEVEL_TILT = float(np.deg2rad(3.0))
"""Largest tilt of gravity for a level base [rad]."""

WALL_TOLERANCE, MIN_CEILING_TILT = np.deg2rad([5.0, 165.0])
"""Largest deviation from a tilt of 90 degrees for a robot on a wall; smallest tilt of a robot on
the ceiling, or of readings with opposite signs [rad]."""

MAX_REARWARD_COSINE = -0.5
"""Cosine of centre of mass to tool direction below which the centre is on the robot's side."""

MIN_TOOL_DENSITY, MIN_POSSIBLE_DENSITY = 10.0, 1.0
"""Smallest mass over the cubed distance of the centre of mass: of usual tools, applied where other
units are more likely; and of any tool [kg/m^3]."""

TYPICAL_LENGTHS = np.array([0.035, 0.1])
"""Typical ratio of moment noise to force noise, and distance of a tool's centre of mass [m]."""

UNIT_SYSTEMS = {
    "": (1.0, 1.0),
    "moments-in-mm": (1.0, 1e-3),
    "moments-in-cm": (1.0, 1e-2),
    "forces-in-kgf": (9.80665, 1 / 9.80665),
    "forces-in-lbf": (4.44822, 1 / 4.44822),
    "wrench-in-lbf-in": (4.44822, 0.0254),
    "wrench-in-lbf-ft": (4.44822, 0.3048),
    "wrench-in-kgf-cm": (9.80665, 0.01),
}
"""Unit systems of sensors by cause code, "" for N and N m: unit of force [N], of moment over
force [m]."""


def diagnose_tool(
    tree: Tree, poses: StaticPoses, fit: StaticFit, tool_direction: Array
) -> Iterator[Diagnostic]:
    """Yield diagnostics of a tool estimate: residuals, axes, signs, units, gravity.

    A residual above `MAX_RESIDUAL_SHARE` is attributed to angles in degrees or to wrenches along
    base axes if a fit with that error corrected has a residual below this limit. Otherwise the
    diagnostic is "tool.residual", of level "error" above `ERROR_RESIDUAL_SHARE`. Unidentifiable
    unknowns give "tool.poses". The plausibility of the estimate is checked if the residual of
    forces is small.

    Args:
        tree: The robot from its base to the sensor.
        poses: Joint positions and readings.
        fit: Fit to the poses without correction.
        tool_direction: Direction from the robot to the tool along the sensor axes, (3,).
    """
    if fit.relative_residual > MAX_RESIDUAL_SHARE and not fit.unidentifiable:
        corrected_fits = {
            code: fit_tool(tree, poses, code) for code in ("degrees", *BASE_AXIS_SIGNS)
        }
        good_codes = [
            code
            for code, corrected_fit in corrected_fits.items()
            if corrected_fit.relative_residual < MAX_RESIDUAL_SHARE
        ]
        if good_codes:
            code = min(
                good_codes,
                key=lambda code: _is_behind_sensor(
                    corrected_fits[code], tool_direction
                ),
            )
            corrected_fit = corrected_fits[code]
            yield make_diagnostic(
                f"tool.{code}",
                residual=fit.rms_residual,
                left=corrected_fit.rms_residual,
                mass=corrected_fit.mass(tree.gravity),
                place=_comma_separated(corrected_fit.centre),
            )
            return
        # a smaller residual may be noise
        level: Level = (
            "error" if fit.relative_residual > ERROR_RESIDUAL_SHARE else "warning"
        )
        yield make_diagnostic("tool.residual", value=fit.relative_residual, level=level)
    if fit.unidentifiable:
        yield make_diagnostic("tool.poses", ", ".join(fit.unidentifiable))
    elif fit.rms_residual[0] <= MAX_RESIDUAL_SHARE * np.linalg.norm(fit.weight):
        yield from _plausibility_diagnostics(fit, tree.gravity, tool_direction)


def _is_behind_sensor(fit: StaticFit, ahead: Array) -> bool:
    """Test whether the centre of mass is significantly on the robot's side of the sensor.

    This is the case if its distance exceeds `Z_THRESHOLD` standard deviations and its angle to the
    direction of the tool exceeds 120 degrees.

    Args:
        fit: Fit to static poses.
        ahead: Direction from the robot to the tool along the sensor axes, (3,).
    """
    if fit.arm <= Z_THRESHOLD * _centre_sigma(fit):
        return False
    return bool(
        fit.centre @ ahead < MAX_REARWARD_COSINE * fit.arm * np.linalg.norm(ahead)
    )


def _centre_sigma(fit: StaticFit) -> float:
    """Standard deviation of the centre of mass: root of the summed variances [m]."""
    return float(np.sqrt(np.trace(fit.covariance[9:, 9:])))


def _plausibility_diagnostics(
    fit: StaticFit, gravity: Array, ahead: Array
) -> Iterator[Diagnostic]:
    """Yield diagnostics of implausible directions of gravity and centres of mass.

    The tilt is the angle between estimated gravity and the model's. A tilt above 165 degrees gives
    "tool.upwards", a tilt within 5 degrees of 90 "tool.wall", and any other tilt above 3 degrees
    and 5 sigma "tool.level". A centre of mass on the robot's side gives "tool.behind", and one too
    far away for the mass "tool.reach". Possible causes are listed with the most likely first.

    Args:
        fit: Fit to the poses without correction.
        gravity: Gravity of the model, (3,) [m/s^2].
        ahead: Direction from the robot to the tool along the sensor axes, (3,).
    """
    fits_well, gravity_size = (
        fit.relative_residual <= MAX_RESIDUAL_SHARE,
        float(np.linalg.norm(gravity)),
    )
    is_behind = fits_well and _is_behind_sensor(fit, ahead)
    tilt, sigma = fit.tilt(gravity)
    code, causes = "", ["not-level", "cable"] if fits_well else ["cable", "not-level"]
    if tilt > MIN_CEILING_TILT:
        code, causes = (
            "upwards",
            ["forces-opposite" if is_behind else "opposite-signs", "hangs"],
        )
    elif abs(tilt - np.pi / 2) < WALL_TOLERANCE:
        code, causes = "wall", []
    elif tilt > max(MAX_LEVEL_TILT, Z_THRESHOLD * sigma):
        code = "level"
    if is_behind and code != "upwards":
        yield make_diagnostic("tool.behind", value=fit.arm)
    if code:
        gravity_estimate = _comma_separated(
            gravity_size * fit.weight / np.linalg.norm(fit.weight)
        )
        angle, angle_sigma = np.rad2deg([tilt, sigma]).tolist()
        yield make_diagnostic(
            f"tool.{code}",
            value=angle,
            sigma=angle_sigma,
            causes=causes,
            gravity=gravity_estimate,
        )
    mass = fit.mass(gravity)
    unit_codes = _unit_systems(fit, mass)
    min_distance = fit.arm - Z_THRESHOLD * _centre_sigma(fit)
    if (
        fits_well
        and mass
        < (MIN_TOOL_DENSITY if unit_codes else MIN_POSSIBLE_DENSITY) * min_distance**3
    ):
        yield make_diagnostic(
            "tool.reach", value=fit.arm, mass=mass, causes=unit_codes or ["no-unit"]
        )


def _unit_systems(fit: StaticFit, mass: float) -> list[str]:
    """Codes of plausible unit systems for the readings, most likely first.

    Each unit system gives two lengths: the ratio of moment to force residual, and the distance of
    the centre of mass. Its deviation is the sum of the absolute logarithms of their ratios to
    `TYPICAL_LENGTHS`. Plausible systems have a deviation at most 1 above the smallest, and a tool
    density above `MIN_TOOL_DENSITY`. The result is empty if N and N m are most likely.

    Args:
        fit: Fit to the poses without correction.
        mass: Mass of the tool if forces are in N [kg].
    """
    lengths = np.array([fit.rms_residual[1] / fit.rms_residual[0], fit.arm])
    ranking = sorted(
        (float(np.abs(np.log(lengths * length_unit / TYPICAL_LENGTHS)).sum()), code)
        for code, (force_unit, length_unit) in UNIT_SYSTEMS.items()
        if mass * force_unit > MIN_TOOL_DENSITY * (fit.arm * length_unit) ** 3
        or not code
    )
    return [
        code
        for deviation, code in ranking
        if deviation < ranking[0][0] + 1 and ranking[0][1] and code
    ]


def _comma_separated(values: Array) -> str:
    """Comma-separated text of numbers, rounded to four decimals."""
    return ",".join(f"{round(float(x), 4) + 0.0:g}" for x in values)
