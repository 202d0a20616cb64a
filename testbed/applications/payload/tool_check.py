"""What to doubt of a tool by its weight: axes, units, signs, how the robot is mounted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.applications.payload.pose_readings import ALIKE, BASES, LEVEL, PoseReading
from testbed.applications.payload.sensor_axes import AxesTurn
from testbed.applications.payload.static_fit import RestFit
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, Level, diagnose

BETTER = 0.25
"""Errors in poses left out over those as said, below which a reading is proposed."""

DOUBTFUL = 0.03
"""Part of a tool's weight in the residuals above which a reading does not explain the poses."""

GROSS = 0.1
"""The same part above which what was found is in doubt, and not only uncertain."""

WEIGHTLESS = 0.5
"""The same part above which the sensor shows no weight: what shows one need not be better."""

CLEAR = 5.0
"""Standard deviations from which on a difference is no noise."""

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


def explains(other: PoseReading, said: PoseReading) -> bool:
    """Whether a reading fits the poses, also those left out of the fit.

    Args:
        other: The reading.
        said: The table as it was said.
    """
    few, most = other.few.fit, BETTER if said.fit.share < WEIGHTLESS else ALIKE
    return few.share < DOUBTFUL and not few.open and other.held_out < most * said.held_out


def diagnose_tool(
    said: PoseReading, best: PoseReading, zero: PoseReading | None, gravity: Array,
    axes: AxesTurn | None, ahead: Array, sensor: str,
) -> Iterator[Diagnostic]:  # fmt: skip
    """Diagnose a tool identified at rest: residuals, signs, units, gravity.

    Args:
        said: The poses as they were said.
        best: The reading that explains them best.
        zero: With another zero of a joint, if that was tried.
        gravity: The model's, (3,) [m/s^2].
        axes: Of the sensor, if `best` has turned them.
        ahead: From the robot to the tool, along the sensor's axes, (3,).
        sensor: Its name.
    """
    fit, code = best.fit, best.code
    place, doubt = fit.found[9:12], float(np.sqrt(np.trace(fit.covariance[9:12, 9:12])))
    arm, size = float(np.linalg.norm(place)), float(np.linalg.norm(gravity))
    mass = float(np.linalg.norm(fit.weight)) / size
    sure = fit.share <= DOUBTFUL and not fit.open
    behind = (
        sure
        and arm > CLEAR * doubt
        and fit.turn @ place @ ahead < BEHIND * arm * np.linalg.norm(ahead)
    )
    if behind and code in BASES and best.subject != "forces":  # a sensor without zero shows both
        (code,) = BASES.keys() - {code}
        place, behind = -place, False
    if code:
        angle, sigma = np.rad2deg(axes.angle if axes else (0.0, 0.0)).tolist()
        yield diagnose(
            f"tool.{code}", best.subject, value=angle, sigma=sigma, residual=said.fit.scale,
            left=fit.scale, mass=mass, place=_listed(place), sensor=sensor or "NAME",
            rpy=_listed(axes.rpy) if axes else "",
        )  # fmt: skip
    elif not (sure or fit.open):
        how: Level = "error" if fit.share > GROSS else "warning"  # below, noise will do it
        yield diagnose("tool.unexplained" if zero else "tool.residual", value=fit.share, level=how)
    if fit.open:
        yield diagnose("tool.poses", ", ".join(fit.open))
    if fit.open or fit.scale[0] > DOUBTFUL * mass * size:
        return
    tilt, sigma = fit.tilt(gravity)
    found, causes = "", ["not-level", "cable"] if sure else ["cable", "not-level"]
    if tilt > CEILING:
        found, causes = "upwards", ["forces-opposite" if behind else "opposite-signs", "hangs"]
    elif abs(tilt - np.pi / 2) < WALL:
        found, causes = "wall", []
    elif tilt > max(LEVEL, CLEAR * sigma):
        found = "level"
        if zero and zero.fit.tilt(gravity)[0] < LEVEL and zero.held_out < ALIKE * said.held_out:
            causes.append("joint-zero")
    if behind and found != "upwards":
        yield diagnose("tool.behind", value=arm)
    if found:
        pull = _listed(size * fit.weight / np.linalg.norm(fit.weight))
        value, sigma = np.rad2deg([tilt, sigma]).tolist()
        yield diagnose(f"tool.{found}", value=value, sigma=sigma, causes=causes, gravity=pull)
    near = arm - CLEAR * doubt
    causes = _unit_systems(fit, mass, arm)
    if sure and mass < (THINNEST if causes else AIR) * near**3:
        yield diagnose("tool.reach", value=arm, mass=mass, causes=causes or ["no-unit"])


def _unit_systems(fit: RestFit, mass: float, arm: float) -> list[str]:
    """Unit systems with plausible sensor noise and centre of mass, the likeliest first."""
    shown = np.array([fit.scale[1] / fit.scale[0], arm])
    odd = sorted(
        (float(np.abs(np.log(shown * by / USUAL)).sum()), code)
        for code, (force, by) in SYSTEMS.items()
        if mass * force > THINNEST * (arm * by) ** 3 or not code
    )
    return [code for each, code in odd if each < odd[0][0] + 1 and odd[0][1] and code]


def _listed(values: Array | tuple[float, ...]) -> str:
    return ",".join(f"{round(float(x), 4) + 0.0:g}" for x in values)
