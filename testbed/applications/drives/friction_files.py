"""Friction files for other programs: a CSV table of curves, and parameters of BAM's models."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np

from testbed.applications.drives.friction_curves import DriveEstimate
from testbed.applications.drives.identify_drives import DriveIdentification
from testbed.core.base.whole_files import write_atomically
from testbed.core.robot.friction import (
    COULOMB,
    LOAD_FRICTION,
    QUADRATIC_LOAD_FRICTION,
    ROTOR,
    STRIBECK_KIND,
    VISCOUS,
)

TABLE_COLUMNS = ("joint", "speed", "friction", "sigma", "law")
"""Columns of the table: nodes of the curve, and friction of the joint's terms without load."""

BASIC_KINDS = {COULOMB.kind, VISCOUS.kind, ROTOR.kind, STRIBECK_KIND}
"""Kinds of terms with parameters in BAM's models from M2 on."""

FORMULA_PREFIXES = ("=", "+", "-", "@", "\t", "\r", "\n")
"""Prefixes of CSV cells that spreadsheets evaluate as formulas."""


def friction_table(findings: DriveIdentification) -> str:
    """CSV table of friction curves and fitted friction laws.

    It has one row per node of each joint's curve, with the columns `TABLE_COLUMNS`, in SI units at
    the joint side; torques are corrected by the joint's torque constant. The column "law" is the
    friction of the fitted joint terms without load.

    Args:
        findings: Friction curves and terms of all joints.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(TABLE_COLUMNS)
    for curve, drive in zip(findings.curves, findings.estimates, strict=True):
        law = drive.friction(curve.speed, np.zeros_like(curve.speed))
        # an apostrophe before text that spreadsheets would evaluate
        joint = (
            f"'{curve.joint}"
            if curve.joint.startswith(FORMULA_PREFIXES)
            else curve.joint
        )
        for values in np.column_stack(
            [curve.speed, curve.torque, curve.sigma, law]
        ).tolist():
            writer.writerow([joint, *values])
    return text.getvalue()


def bam_parameters(drive: DriveEstimate) -> dict[str, object]:
    """Joint friction as parameters of the simplest sufficient BAM model, by key.

    The model is M1, M2, M5 or M6. In M6, the quadratic load friction decays with speed as Stribeck
    friction does, so M6 is used only without Stribeck friction; for a backdriven gear, this term
    depends on the motor's torque. Terms that the model lacks are listed under `left_out`, which BAM
    ignores. `kt` is not identified; the value in use must be multiplied by `constant`.

    Source    github.com/Rhoban/bam, bam/model.py; Duclusaud et al., arXiv 2410.08650 (2024).

    Args:
        drive: Estimate of the joint's terms.
    """
    terms = {term.law.kind.partition("@")[0]: term for term in drive.terms}
    values = {kind: term.value for kind, term in terms.items()}
    model_kinds, has_stribeck = set(BASIC_KINDS), STRIBECK_KIND in terms
    model = "m2" if has_stribeck else "m1"
    if LOAD_FRICTION.kind in terms:
        model, model_kinds = "m5", model_kinds | {LOAD_FRICTION.kind}
    if QUADRATIC_LOAD_FRICTION.kind in terms and not has_stribeck:
        model, model_kinds = (
            "m6",
            model_kinds | {LOAD_FRICTION.kind, QUADRATIC_LOAD_FRICTION.kind},
        )
    parameters: dict[str, object] = {
        "model": model,
        "actuator": drive.joint,
        "left_out": [
            term.law.kind for kind, term in terms.items() if kind not in model_kinds
        ],
        "constant": drive.constant,
        "armature": values.get(ROTOR.kind, 0.0),
        "friction_base": values.get(COULOMB.kind, 0.0),
        "friction_viscous": values.get(VISCOUS.kind, 0.0),
    }
    if model == "m1":
        return parameters
    parameters["friction_stribeck"] = values.get(STRIBECK_KIND, 0.0)
    parameters["alpha"] = 2.0
    parameters["dtheta_stribeck"] = LARGE_SPEED
    if has_stribeck:
        parameters["dtheta_stribeck"] = float(
            terms[STRIBECK_KIND].law.kind.partition("@")[2]
        )
    shares = (
        {"motor": 0.0, "wrench": values.get(LOAD_FRICTION.kind, 0.0)}
        if model != "m2"
        else {}
    )
    for side, share in shares.items():
        parameters |= {
            f"load_friction_{side}": share,
            f"load_friction_{side}_stribeck": 0.0,
        }
        if model == "m6":
            parameters[f"load_friction_{side}_quad"] = values[
                QUADRATIC_LOAD_FRICTION.kind
            ]
    return parameters


LARGE_SPEED = 1e9
"""Stribeck velocity of a model without Stribeck friction [rad/s or m/s]."""


def bam_file(findings: DriveIdentification) -> str:
    """JSON text with the parameters of BAM's models, keyed by joint.

    Args:
        findings: Terms of all joints.
    """
    parameters = {drive.joint: bam_parameters(drive) for drive in findings.estimates}
    return json.dumps(parameters, indent=1) + "\n"


def write_friction(findings: DriveIdentification, path: Path) -> None:
    """Write a friction table (.csv) or parameters of BAM's models (.json).

    Args:
        findings: Friction curves and terms of all joints.
        path: Path of the file; its extension selects the format.
    """
    text = (
        friction_table(findings)
        if path.suffix.lower() == ".csv"
        else bam_file(findings)
    )
    write_atomically(path, text)
