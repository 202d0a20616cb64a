"""Friction in files for other programs: a table, and BAM's parameters."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from testbed.errors import SettingsError
from testbed.files import replacing
from testbed.identification.drives.friction_curves import DriveEstimate
from testbed.identification.drives.identify_drives import DriveFindings
from testbed.robot.friction import COULOMB, LOAD, ROTOR, STRIBECK, VISCOUS

HEADS = (
    "joint", "speed_from", "speed_to", "load_from", "load_to", "temperature_from", "temperature_to",
    "speed", "load", "temperature", "friction", "sigma", "rows", "law",
)  # fmt: skip
"""Of the table: cells of the map, and what the joint's terms make of their mean speed and load."""

BAM: Mapping[str, str] = {
    COULOMB.kind: "friction_base",
    VISCOUS.kind: "friction_viscous",
    STRIBECK: "friction_stribeck",
    LOAD.kind: "load_friction_external",
    ROTOR.kind: "armature",
}
"""Parameters of BAM's models by the term that they hold."""


def table(found: DriveFindings) -> str:
    """The maps as CSV, for a controller's feed-forward: SI, joint side, true torque.

    Args:
        found: Maps and terms of all joints.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADS)
    for cells, drive in zip(found.maps, found.estimates, strict=True):
        law = drive.friction(cells.speed, cells.load, cells.temperature)
        numbers = [
            cells.speeds, cells.loads, cells.temperatures, cells.speed, cells.load,
            cells.temperature, cells.friction, cells.sigma, cells.rows, law,
        ]  # fmt: skip
        for row in np.column_stack(numbers).tolist():
            writer.writerow([cells.joint, *row])
    return text.getvalue()


def bam_parameters(drive: DriveEstimate) -> dict[str, object]:
    """A joint's friction as BAM has it: models M1, M2 and M5 with a curvature of two.

    A gear that passes on T takes `load_friction_external` abs(T) of M5 where motion is slow, with
    `load_friction_motor` of zero; BAM's M3 and M4 would take more when driving. What has no
    parameter there stands under `left_out`, which BAM does not read. `kt` is not known: it has to
    be multiplied by `constant`.

    Source    github.com/Rhoban/bam, bam/model.py; Duclusaud et al., arXiv 2410.08650 (2024).

    Args:
        drive: The joint's terms.
    """
    found: dict[str, object] = {}
    left, fades = [], None
    for term in drive.terms:
        family, _, speed = term.law.kind.partition("@")
        if family in BAM:
            found[BAM[family]] = term.value
            fades = float(speed) if speed else fades
        else:
            left.append(term.law.kind)
    model = "m1" if fades is None else "m2"
    if BAM[LOAD.kind] in found:
        model = "m5"
        found |= {"load_friction_motor": 0.0, "load_friction_motor_stribeck": 0.0}
        found |= {"load_friction_external_stribeck": 0.0}
        found = {"friction_stribeck": 0.0} | found
    if model != "m1":
        found |= {"dtheta_stribeck": fades or 0.1, "alpha": 2.0}
    about = {"model": model, "actuator": drive.joint, "constant": drive.constant, "left_out": left}
    return found | about


def bam_file(found: DriveFindings) -> str:
    """A BAM parameter file for every joint, as one object by the joints' names.

    Args:
        found: Terms of all joints.
    """
    every = {drive.joint: bam_parameters(drive) for drive in found.estimates}
    return json.dumps(every, indent=1) + "\n"


WRITERS = {".csv": table, ".json": bam_file}
"""By the ending of the file."""


def check_friction_file(path: Path) -> None:
    """Whether friction can be written to a file.

    Args:
        path: The file.

    Raises:
        SettingsError: Its ending is none of WRITERS.
    """
    if path.suffix.lower() not in WRITERS:
        raise SettingsError(
            f"'{path}': friction is written as .csv (map and law) or .json (parameters for BAM)"
        )


def write_friction(found: DriveFindings, path: Path) -> None:
    """Write it as the ending of the file says.

    Args:
        found: Of all joints.
        path: The file.
    """
    text = WRITERS[path.suffix.lower()](found)
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
