"""Friction in files for other programs: a table, and BAM's parameters."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np

from testbed.applications.drives.friction_curves import DriveEstimate
from testbed.applications.drives.identify_drives import DriveFindings
from testbed.core.base.whole_files import write_whole
from testbed.core.robot.friction import (
    COULOMB,
    LOAD,
    QUADRATIC_LOAD,
    ROTOR,
    STRIBECK,
    VISCOUS,
)

HEADS = ("joint", "speed", "friction", "sigma", "law")
"""Of the table: nodes of the curve, and what the joint's terms take at their speeds, unloaded."""

DRY = {COULOMB.kind, VISCOUS.kind, ROTOR.kind, STRIBECK}
"""Terms that all of BAM's models have parameters for from M2 on."""

FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""How cells of a CSV file begin that spreadsheets compute."""


def table(found: DriveFindings) -> str:
    """The curves as CSV, for a controller's feed-forward: SI, joint side, true torque.

    Args:
        found: Curves and terms of all joints.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADS)
    for curve, drive in zip(found.curves, found.estimates, strict=True):
        law = drive.friction(curve.speed, np.zeros_like(curve.speed))
        # an apostrophe before what spreadsheets would compute
        joint = f"'{curve.joint}" if curve.joint.startswith(FORMULA) else curve.joint
        for row in np.column_stack(
            [curve.speed, curve.torque, curve.sigma, law]
        ).tolist():
            writer.writerow([joint, *row])
    return text.getvalue()


def bam_parameters(drive: DriveEstimate) -> dict[str, object]:
    """A joint's friction as the simplest of BAM's models that holds it: M1, M2, M5 or M6.

    M6's squares of the load fade out as Stribeck's friction does, so they are there without it
    only; of a driven gear they are of the motor's torque. What the model does not state is listed
    under `left_out`, which BAM does not read. `kt` is not known: multiply it by `constant`.

    Source    github.com/Rhoban/bam, bam/model.py; Duclusaud et al., arXiv 2410.08650 (2024).

    Args:
        drive: The joint's terms.
    """
    terms = {term.law.kind.partition("@")[0]: term for term in drive.terms}
    value = {kind: term.value for kind, term in terms.items()}
    held, fading = set(DRY), STRIBECK in terms
    model = "m2" if fading else "m1"
    if LOAD.kind in terms:
        model, held = "m5", held | {LOAD.kind}
    if QUADRATIC_LOAD.kind in terms and not fading:
        model, held = "m6", held | {LOAD.kind, QUADRATIC_LOAD.kind}
    found: dict[str, object] = {
        "model": model,
        "actuator": drive.joint,
        "left_out": [term.law.kind for kind, term in terms.items() if kind not in held],
        "constant": drive.constant,
        "armature": value.get(ROTOR.kind, 0.0),
        "friction_base": value.get(COULOMB.kind, 0.0),
        "friction_viscous": value.get(VISCOUS.kind, 0.0),
    }
    if model == "m1":
        return found
    found["friction_stribeck"] = value.get(STRIBECK, 0.0)
    found["alpha"] = 2.0
    found["dtheta_stribeck"] = NEVER
    if fading:
        found["dtheta_stribeck"] = float(terms[STRIBECK].law.kind.partition("@")[2])
    shares = (
        {"motor": 0.0, "external": value.get(LOAD.kind, 0.0)} if model != "m2" else {}
    )
    for side, share in shares.items():
        found |= {f"load_friction_{side}": share, f"load_friction_{side}_stribeck": 0.0}
        if model == "m6":
            found[f"load_friction_{side}_quad"] = value[QUADRATIC_LOAD.kind]
    return found


NEVER = 1e9
"""Speed at which friction fades out where there is none that does [rad/s or m/s]."""


def bam_file(found: DriveFindings) -> str:
    """Parameters for BAM's models as one object, by joint.

    Args:
        found: Terms of all joints.
    """
    every = {drive.joint: bam_parameters(drive) for drive in found.estimates}
    return json.dumps(every, indent=1) + "\n"


def write_friction(found: DriveFindings, path: Path) -> None:
    """Write a table (.csv), or parameters for BAM (.json).

    Args:
        found: Of all joints.
        path: The file.
    """
    text = table(found) if path.suffix.lower() == ".csv" else bam_file(found)
    write_whole(path, text)
