"""Friction in files for other programs: a table, and BAM's parameters."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from testbed.applications.drives.friction_curves import DriveEstimate
from testbed.applications.drives.identify_drives import DriveFindings
from testbed.core.base.errors import formula_free
from testbed.core.base.files import replacing
from testbed.core.robot.friction import COULOMB, LOAD, QUADRATIC_LOAD, ROTOR, STRIBECK, VISCOUS

HEADS = (
    "joint", "speed_from", "speed_to", "load_from", "load_to", "temperature_from", "temperature_to",
    "speed", "load", "temperature", "friction", "sigma", "rows", "law",
)  # fmt: skip
"""Of the table: cells of the map, and what the joint's terms make of their mean speed and load."""

_DRY = (COULOMB.kind, VISCOUS.kind, ROTOR.kind)
BAM: Mapping[str, tuple[str, ...]] = {
    "m1": _DRY,
    "m2": (*_DRY, STRIBECK),
    "m3": (*_DRY, LOAD.kind),
    "m4": (*_DRY, STRIBECK, LOAD.kind),
    "m5": (*_DRY, STRIBECK, LOAD.kind),
    "m6": (*_DRY, STRIBECK, LOAD.kind, QUADRATIC_LOAD.kind),
}
"""Terms that each of BAM's models has parameters for."""

NEVER = "", "", "1e9"
"""For a speed at which friction fades out where there is none."""


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
            writer.writerow([formula_free(cells.joint), *row])
    return text.getvalue()


def bam_parameters(drive: DriveEstimate, model: str) -> dict[str, object]:
    """A joint's friction as one of BAM's models states it, where motion is slow.

    M5 and M6 have the load's friction as it is. M3 and M4 multiply the difference of motor and
    external torque, which is 2 abs(T) and the friction: a gear of the same efficiency when driving
    and driven, with another torque constant. That is the same in the load, and half its coefficient
    more of dry and viscous friction when driving, less when driven. M6's squares of the load fade
    out as Stribeck's friction does, so they are there without it only; of a driven gear they are of
    the motor's torque. What a model does not state is listed under `left_out`, which BAM does not
    read. `kt` is not known: it has to be multiplied by `constant`.

    Source    github.com/Rhoban/bam, bam/model.py; Duclusaud et al., arXiv 2410.08650 (2024).

    Args:
        drive: The joint's terms.
        model: One of BAM.
    """
    terms = {term.law.kind.partition("@")[0]: term for term in drive.terms}
    held = {*BAM[model]} - ({QUADRATIC_LOAD.kind} if STRIBECK in terms else set())
    value = {kind: terms[kind].value if kind in terms else 0.0 for kind in held}
    left = [t.law.kind for kind, t in terms.items() if kind not in held]
    found: dict[str, object] = {"model": model, "actuator": drive.joint, "left_out": left}
    loss, base, constant = value.get(LOAD.kind, 0.0), 0.0, drive.constant
    if model in ("m3", "m4"):
        base = loss / (1 + math.sqrt(max(1 - loss**2, 0.0)))
        constant *= (1 - base**2) / (1 + base**2)
        found["load_friction_base"] = base
    more = 1 + base**2
    found |= {"constant": constant, "armature": value[ROTOR.kind] * drive.constant / constant}
    found["friction_base"] = more * value[COULOMB.kind]
    found["friction_viscous"] = more * value[VISCOUS.kind]
    if STRIBECK in held:
        _, _, speed = terms[STRIBECK].law.kind.partition("@") if STRIBECK in terms else NEVER
        found |= {"dtheta_stribeck": float(speed), "alpha": 2.0}
        found["friction_stribeck"] = more * value[STRIBECK]
    if model == "m4":
        found["load_friction_stribeck"] = 0.0
    for side, share in (("motor", 0.0), ("external", loss)) if model in ("m5", "m6") else ():
        found |= {f"load_friction_{side}": share, f"load_friction_{side}_stribeck": 0.0}
        if model == "m6":
            found[f"load_friction_{side}_quad"] = value.get(QUADRATIC_LOAD.kind, 0.0)
    return found


def bam_file(found: DriveFindings) -> str:
    """Parameters for BAM's models as one object: by joint, then by model.

    Args:
        found: Terms of all joints.
    """
    every = {
        drive.joint: {model: bam_parameters(drive, model) for model in BAM}
        for drive in found.estimates
    }
    return json.dumps(every, indent=1) + "\n"


WRITERS = {".csv": table, ".json": bam_file}
"""By the ending of the file."""


def write_friction(found: DriveFindings, path: Path) -> None:
    """Write it as the ending of the file says.

    Args:
        found: Of all joints.
        path: The file.
    """
    text = WRITERS[path.suffix.lower()](found)
    with replacing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
