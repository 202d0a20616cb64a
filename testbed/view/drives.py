"""Drives compared with the force plate: torque constants, terms, friction in the torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from testbed.applications.drives.friction_curves import FrictionCurve
from testbed.applications.drives.identify_drives import DriveFindings
from testbed.core.base.arrays import Array
from testbed.core.base.errors import printable
from testbed.core.base.summary_table import number_with_sigma
from testbed.view.figures import named_panels
from testbed.view.section import Section, Table

if TYPE_CHECKING:
    from testbed.applications.drives.friction_curves import Choice, DriveEstimate
    from testbed.importing.check.time_offset import TimeOffset

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
    return Table(
        ["joint", *heads], rows, TITLE, parts=[[k] for k in range(1, 1 + len(heads))]
    )


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
    listed = ", ".join(
        f"{joint} {own:.3g} ({other:.3g})" for joint, own, other in pairs
    )
    return [
        f"rms error of the unseen motion, driven open-loop (model file's): {listed}"
    ]


def delay_line(found: TimeOffset) -> str:
    """How late drives deliver what they are commanded.

    Args:
        found: Of the commands beside the motion.
    """
    return (
        f"delay of the drives: {-1e3 * found.delay:.3g} +- {1e3 * found.sigma:.2g} ms"
    )


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
    text = " and ".join(
        law.kind for law in choice.laws[: len(choice.laws) - len(added)]
    )
    text += f", then {', '.join(added)}" if added else ", nothing else"
    if choice.next_best is not None:
        text += (
            f"; next would be {choice.next_best.kind}, by {choice.next_best.gain:.1f}"
        )
    return text


def drive_section(drives: DriveFindings) -> Section:
    """Torque constants with error bars, and the joints' own terms.

    Args:
        drives: What the plate says of the drives.
    """
    off = np.array([100 * (each.constant - 1) for each in drives.estimates])
    sigma = np.array([100 * each.sigma for each in drives.estimates])
    return Section(
        id="drives",
        title=TITLE,
        says=(
            "The force plate's estimate gives the rigid-body torque. The ratio of the reported "
            "torque to it is the torque constant (1 if the data sheet is right); the rest is "
            "friction."
        ),
        panels=named_panels(
            "torque constants",
            [each.joint for each in drives.estimates],
            {"external": off},
            "reported over true, less one [%]",
            bars={"external": (off - BAND * sigma, off + BAND * sigma)},
            line=0.0,
        ),
        caption=(
            f"Bars are {BAND:g} standard deviations to either side. In the table, digits in "
            "brackets are the standard deviation of the last places."
        ),
        table=replace(drive_table(drives.estimates), title=""),
    )


def curve_lines(curve: FrictionCurve) -> tuple[Array, Array, Array]:
    """Nodes, torque and sigma, with a gap where the direction changes.

    Args:
        curve: Of one joint.
    """
    split = int(np.searchsorted(curve.speed, 0.0))
    parts = (curve.speed, curve.torque, curve.sigma)
    speed, torque, sigma = (np.insert(each, split, np.nan) for each in parts)
    return speed, torque, sigma
