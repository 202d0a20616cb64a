"""Drives compared with the force plate: torque constants, terms, friction in the torque."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from testbed.applications.drives.friction_curves import FrictionCurve
from testbed.applications.drives.identify_drives import DriveFindings
from testbed.core.base.arrays import Array
from testbed.core.base.errors import printable
from testbed.core.base.summary_table import number_with_sigma
from testbed.view.figures import Panel, named_panels, thinned
from testbed.view.section import Section, Table

if TYPE_CHECKING:
    from testbed.applications.drives.friction_curves import Choice, DriveEstimate
    from testbed.importing.check.time_offset import TimeOffset
    from testbed.lab.experiment.predict import Predictions

BAND = 2.0
"""Sigmas to either side of a curve."""

TITLE = "Drives compared with the force plate"


def drive_table(drives: Sequence[DriveEstimate]) -> Table:
    """Torque constants and the joints' own terms.

    Args:
        drives: One a joint.
    """
    kinds = dict.fromkeys(term.law.kind for each in drives for term in each.terms)
    heads = ["torque constant", *kinds, "residual"]
    rows = [[each.joint, *(_cell(each, head) for head in heads)] for each in drives]
    return Table(["joint", *heads], rows, TITLE, parts=[[k] for k in range(1, 1 + len(heads))])


def _cell(drive: DriveEstimate, head: str) -> str:
    if head == "torque constant":
        return number_with_sigma(drive.constant, drive.sigma, short=True)
    if head == "residual":
        return f"{drive.residual:.3g} {drive.unit}"
    term = next((term for term in drive.terms if term.law.kind == head), None)
    if term is None:
        return ""
    return f"{number_with_sigma(term.value, term.sigma, short=True)} {term.unit}"


def replay_lines(joints: Sequence[str], file: Array, written: Array) -> list[str]:
    """How far model files are from an unseen motion, driven by its torques.

    Args:
        joints: Their names.
        file: Distances of the model file, (M, n) [rad or m].
        written: Of the one that was written, (M, n).
    """
    sizes = (np.sqrt((each**2).mean(axis=0)).tolist() for each in (written, file))
    pairs = zip(joints, *sizes, strict=True)
    listed = ", ".join(f"{joint} {own:.3g} ({other:.3g})" for joint, own, other in pairs)
    return [f"rms error of the unseen motion, driven open-loop (model file's): {listed}"]


def delay_line(found: TimeOffset) -> str:
    """How late drives deliver what they are commanded.

    Args:
        found: Of the commands beside the motion.
    """
    return f"delay of the drives: {-1e3 * found.delay:.3g} +- {1e3 * found.sigma:.2g} ms"


def drive_lines(drives: DriveFindings) -> list[str]:
    """Which terms were chosen, and whether plate and torques agree, a sentence each.

    Args:
        drives: All that the plate says of them.
    """
    lines = []
    for each in drives.estimates:
        if each.choice is not None:
            lines.append(f"{printable(each.joint)}: {_chosen(each.choice)}")
    said = drives.combined.disagreement
    if not drives.diagnostics:
        lines.append(f"Plate and joint torques agree (chance {said.chance:.2g}).")
    return lines


def _chosen(choice: Choice) -> str:
    """Coulomb and viscous, then stribeck@0.08 (better by 5.1 standard errors); next ..., 0.4."""
    better = "better by {:.1f} standard errors"
    added = [f"{step.kind} ({better.format(step.gain)})" for step in choice.steps[1:]]
    text = " and ".join(law.kind for law in choice.laws[: len(choice.laws) - len(added)])
    text += f", then {', '.join(added)}" if added else ", nothing else"
    if choice.next_best is not None:
        text += f"; next would be {choice.next_best.kind}, by {choice.next_best.gain:.1f}"
    return text


def drive_section(
    found: Predictions, drives: DriveFindings, cutoff: float, seconds: float
) -> Section:
    """Torque constants with error bars, and over time what of each torque friction is.

    Args:
        found: Predictions for the recording that is drawn, through a low-pass.
        drives: What the plate says of the drives.
        cutoff: Of the low-pass [Hz].
        seconds: How much of the recording is drawn.
    """
    return Section(
        id="drives",
        title=TITLE,
        says=(
            "The force plate's estimate gives the rigid-body torque. The ratio of the reported "
            "torque to it is the torque constant (1 if the data sheet is right); the rest is "
            "friction. Grey: measured torque; in colour: friction by the friction curve."
        ),
        legend={"measured": "measured torque", "external": "constant; friction"},
        panels=[*_constants(drives), *_torques(found, drives, seconds)],
        shown=3,
        caption=(
            f"Bars and bands are {BAND:g} standard deviations to either side. Torques over "
            f"{seconds:.3g} s, low-pass {cutoff:g} Hz, divided by the constants. "
            "In the table, digits in brackets are the standard deviation of the last places."
        ),
        table=replace(drive_table(drives.estimates), title=""),
    )


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
