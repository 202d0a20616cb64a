"""What the plate says of the drives, as figures: torque constants, friction in the torque."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.experiment.predictions import Predictions
from testbed.identification.drive_findings import DriveFindings
from testbed.identification.friction_curves import FrictionCurve
from testbed.reporting.figures import Panel, thinned
from testbed.reporting.named_panels import named_panels

BAND = 2.0
"""Sigmas to either side of a curve."""


def drive_section(
    found: Predictions, drives: DriveFindings, cutoff: float, seconds: float
) -> dict[str, Any]:
    """Torque constants with error bars, and over time what of each torque friction is.

    Args:
        found: Predictions for the recording that is drawn, through a low-pass.
        drives: What the plate says of the drives.
        cutoff: Of the low-pass [Hz].
        seconds: How much of the recording is drawn.
    """
    return {
        "id": "drives",
        "title": "Drives, held against the plate",
        "says": "The plate tells what torque the bodies need. What a drive reports over that is "
        "its torque constant, 1 where the data sheet is right; what is left is friction. Grey, "
        "the torque that was measured; in colour, what of it is friction at that instant, by the "
        "friction curve.",
        "legend": {"measured": "torque, as it is", "external": "constant; friction"},
        "panels": [*_constants(drives), *_torques(found, drives, seconds)],
        "shown": 3,
        "caption": f"Bars and bands are {BAND:g} sigma to either side. Torques over "
        f"{seconds:.3g} s, through one low-pass of {cutoff:g} Hz, divided by the constants.",
        "heads": ["joint", "torque constant", "sigma", "terms", "left over"],
        "rows": [_row(drives, k) for k in range(len(drives.estimates))],
    }


def _constants(drives: DriveFindings) -> list[Panel]:
    off = np.array([100 * (each.constant - 1) for each in drives.estimates])
    sigma = np.array([100 * each.sigma for each in drives.estimates])
    return named_panels(
        "torque constants",
        [each.joint for each in drives.estimates],
        {"external": off},
        "reported over true, less one [%]",
        bars={"external": (off - BAND * sigma, off + BAND * sigma)},
        line=0.0,
    )


def _torques(found: Predictions, drives: DriveFindings, seconds: float) -> Iterator[Panel]:
    """Each joint's torque over time, and its friction."""
    shown = found.motion.t <= found.motion.t[0] + seconds
    time = found.motion.t[shown]
    torque = next(signal for signal in found.signals if signal.kind == "torque")
    for j, curve in enumerate(drives.curves):
        own = torque.measured[shown, j] / drives.estimates[j].constant
        rubbed = curve.at(found.motion.qd[shown, j])
        lines = {"measured": thinned(time, own), "external": thinned(time, rubbed)}
        yield Panel(f"{curve.joint}: torque, friction in it [{curve.unit}]", lines, "time [s]")


def curve_lines(curve: FrictionCurve) -> tuple[Array, Array, Array]:
    """Nodes, torque and sigma, with a gap where the direction changes.

    Args:
        curve: Of one joint.
    """
    split = int(np.searchsorted(curve.speed, 0.0))
    parts = (curve.speed, curve.torque, curve.sigma)
    speed, torque, sigma = (np.insert(each, split, np.nan) for each in parts)
    return speed, torque, sigma


def _row(drives: DriveFindings, k: int) -> list[str]:
    each = drives.estimates[k]
    terms = "; ".join(f"{t.law.kind} {t.value:.4g} +- {t.sigma:.2g} {t.unit}" for t in each.terms)
    left = f"{each.residual:.3g} {each.unit}"
    return [each.joint, f"{each.constant:.6g}", f"{each.sigma:.2g}", terms, left]
