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
    """Diagnose a tool identified in static poses: residuals, axes, signs, units, gravity.

    A residual above `MAX_RESIDUAL_SHARE` is attributed to angles in degrees or wrenches along base
    axes if the fit with that error undone has a residual below; else it gives "tool.residual", an
    error above `ERROR_RESIDUAL_SHARE`. Unidentifiable unknowns give "tool.poses". Plausibility is
    checked if the residual of forces is small.

    Args:
        tree: The robot from its base to the sensor.
        poses: Joint positions and readings.
        fit: Fit to the data as stated.
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

    Its distance exceeds `Z_THRESHOLD` standard deviations, and its angle to the tool's direction
    120 degrees.

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
    """Standard deviation of the centre of mass, root of summed variances [m]."""
    return float(np.sqrt(np.trace(fit.covariance[9:, 9:])))


def _plausibility_diagnostics(
    fit: StaticFit, gravity: Array, ahead: Array
) -> Iterator[Diagnostic]:
    """Diagnostics of implausible directions of gravity and positions of the centre of mass.

    Gravity tilted against the model: "tool.upwards" beyond 165 degrees, "tool.wall" within 5 of 90,
    "tool.level" for any other tilt beyond 3 degrees and 5 sigma. Centre of mass: "tool.behind" on
    the robot's side, "tool.reach" if too distant for the mass. Candidate causes, likeliest first.

    Args:
        fit: Fit to the data as stated.
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
    """Codes of unit systems with plausible sensor noise and centre of mass, likeliest first.

    Criterion: deviation (sum of absolute logarithms) of the ratio of moment to force residual and
    of the centre's distance from `TYPICAL_LENGTHS`, at most 1 above the smallest; the density of
    the tool must exceed `MIN_TOOL_DENSITY`. Empty if N and N m are the likeliest.

    Args:
        fit: Fit to the data as stated.
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
    """Numbers as comma-separated text, rounded to four decimals."""
    return ",".join(f"{round(float(x), 4) + 0.0:g}" for x in values)
