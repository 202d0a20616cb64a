"""Tables and sentences of drives compared with the plate: constants, joint terms, friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from testbed.applications.drives.friction_curves import FrictionCurve
from testbed.applications.drives.identify_drives import DriveIdentification
from testbed.core.base.arrays import Array
from testbed.core.base.errors import printable_line
from testbed.core.base.summary_table import number_with_sigma
from testbed.view.figures import named_panels
from testbed.view.section import Section, Table

if TYPE_CHECKING:
    from testbed.applications.drives.friction_curves import (
        DriveEstimate,
        JointTermChoice,
    )
    from testbed.importing.check.time_offset import TimeOffset

BAND_SIGMAS = 2.0
"""Half width of bands and error bars about a curve in standard deviations."""

DRIVES_TITLE = "Drives compared with the force plate"
"""Title of tables and sections on drives."""


def drive_table(drives: Sequence[DriveEstimate]) -> Table:
    """Table of torque constant, joint terms with sigma, and rms residual of each joint.

    Args:
        drives: Estimate of each joint's drive.
    """
    kinds = dict.fromkeys(term.law.kind for each in drives for term in each.terms)
    heads = ["torque constant", *kinds, "residual"]
    rows = [
        [each.joint, *(_drive_cell(each, head) for head in heads)] for each in drives
    ]
    return Table(
        ["joint", *heads],
        rows,
        DRIVES_TITLE,
        parts=[[k] for k in range(1, 1 + len(heads))],
    )


def _drive_cell(drive: DriveEstimate, head: str) -> str:
    """Text of one cell in the table of drives; "" for a missing term.

    Args:
        drive: Estimate of the drive.
        head: Column head: "torque constant", "residual", or the kind of a joint term.
    """
    if head == "torque constant":
        return number_with_sigma(drive.constant, drive.sigma, short=True)
    if head == "residual":
        return f"{drive.residual:.3g} {drive.unit}"
    term = next((term for term in drive.terms if term.law.kind == head), None)
    if term is None:
        return ""
    return f"{number_with_sigma(term.value, term.sigma, short=True)} {term.unit}"


def replay_error_lines(
    joints: Sequence[str], file_errors: Array, written_errors: Array
) -> list[str]:
    """Sentence with the rms position errors of two models in open-loop simulation.

    Both models are driven by the recorded torques of a held-out motion.

    Args:
        joints: Names of the joints.
        file_errors: Position errors of the original model file, (M, n) [rad or m].
        written_errors: Position errors of the written model file, (M, n) [rad or m].
    """
    sizes = (
        np.sqrt((each**2).mean(axis=0)).tolist()
        for each in (written_errors, file_errors)
    )
    pairs = zip(joints, *sizes, strict=True)
    listed = ", ".join(
        f"{joint} {written_error:.3g} ({file_error:.3g})"
        for joint, written_error, file_error in pairs
    )
    return [
        f"rms error of the unseen motion, driven open-loop (model file's): {listed}"
    ]


def drive_delay_line(offset: TimeOffset) -> str:
    """Sentence with the delay of the drives relative to their commands, and its sigma [ms].

    Args:
        offset: Time offset of the commands relative to the motion; negative if commands are early.
    """
    return (
        f"delay of the drives: {-1e3 * offset.delay:.3g} +- {1e3 * offset.sigma:.2g} ms"
    )


def drive_lines(drives: DriveIdentification) -> list[str]:
    """Sentences on the selection of joint terms, and on the agreement of plate and torques.

    Joints whose terms were not selected by cross-validation are left out. The agreement, with the
    p-value of the test, is stated only if there are no diagnostics.

    Args:
        drives: Drives compared with the plate.
    """
    lines = []
    for each in drives.estimates:
        if each.choice is not None:
            lines.append(f"{printable_line(each.joint)}: {_choice_text(each.choice)}")
    disagreement = drives.combined.disagreement
    if not drives.diagnostics:
        lines.append(
            f"Plate and joint torques agree (chance {disagreement.p_value:.2g})."
        )
    return lines


def _choice_text(choice: JointTermChoice) -> str:
    """Text of a joint's laws in the order of selection, with their gains.

    The laws that every joint has come first, and the best rejected law comes last. Gains are in
    standard errors. For example: Coulomb and viscous, then stribeck@0.08 (better by 5.1 standard
    errors); next would be ..., by 0.4.
    """
    gain_text = "better by {:.1f} standard errors"
    added_terms = [
        f"{step.kind} ({gain_text.format(step.gain)})" for step in choice.steps[1:]
    ]
    text = " and ".join(
        law.kind for law in choice.laws[: len(choice.laws) - len(added_terms)]
    )
    text += f", then {', '.join(added_terms)}" if added_terms else ", nothing else"
    if choice.next_best is not None:
        text += (
            f"; next would be {choice.next_best.kind}, by {choice.next_best.gain:.1f}"
        )
    return text


def drive_section(drives: DriveIdentification) -> Section:
    """Section with the relative deviations of torque constants, and the table of drives.

    The panel shows `constant - 1` [%], with error bars of `BAND_SIGMAS` standard deviations on
    either side.

    Args:
        drives: Drives compared with the plate.
    """
    deviation = np.array([100 * (each.constant - 1) for each in drives.estimates])
    sigma = np.array([100 * each.sigma for each in drives.estimates])
    return Section(
        id="drives",
        title=DRIVES_TITLE,
        explanation=(
            "The force plate's estimate gives the rigid-body torque. The ratio of the reported "
            "torque to it is the torque constant (1 if the data sheet is right); the rest is "
            "friction."
        ),
        panels=named_panels(
            "torque constants",
            [each.joint for each in drives.estimates],
            {"wrench": deviation},
            "reported over true, less one [%]",
            bars={
                "wrench": (
                    deviation - BAND_SIGMAS * sigma,
                    deviation + BAND_SIGMAS * sigma,
                )
            },
            line=0.0,
        ),
        caption=(
            f"Bars are {BAND_SIGMAS:g} standard deviations to either side. In the table, digits in "
            "brackets are the standard deviation of the last places."
        ),
        table=replace(drive_table(drives.estimates), title=""),
    )


def curve_lines(curve: FrictionCurve) -> tuple[Array, Array, Array]:
    """Speeds, torques and sigmas of a friction curve, interrupted by nan at zero speed.

    A plotted line thus has a gap where friction jumps at zero velocity.

    Args:
        curve: Friction curve of one joint, with m nodes.

    Returns:
        Three arrays, (m + 1,) each: speeds [rad/s or m/s], torques and sigmas [N m or N].
    """
    split = int(np.searchsorted(curve.speed, 0.0))
    parts = (curve.speed, curve.torque, curve.sigma)
    speed, torque, sigma = (np.insert(each, split, np.nan) for each in parts)
    return speed, torque, sigma
