"""What the plate says of the drives, as JSON takes it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from testbed.identification.drive_findings import DriveFindings
from testbed.identification.drive_laws import Choice
from testbed.identification.torque_constants import DriveEstimate


def drives_as_json(drives: DriveFindings) -> dict[str, Any]:
    """What the plate says of the drives, as JSON takes it.

    Args:
        drives: All that the plate says of them.
    """
    both = drives.combined
    return {
        "joints": _joints_as_json(drives.estimates),
        "diagnostics": [each.as_dict() for each in drives.diagnostics],
        "curves": {
            curve.joint: {
                "speed": curve.speed.tolist(),
                "torque": curve.torque.tolist(),
                "sigma": curve.sigma.tolist(),
                "unit": curve.unit,
            }
            for curve in drives.curves
        },
        "combined": {
            "names": list(both.names),
            "values": both.values.tolist(),
            "sigma": both.sigma.tolist(),
            "torque_constants": both.constants.tolist(),
            "torque_constant_sigmas": both.constant_sigma.tolist(),
            "chance": both.disagreement.chance,
            "moved": dict(zip(both.disagreement.names, both.disagreement.z.tolist(), strict=True)),
        },
    }


def _joints_as_json(drives: Sequence[DriveEstimate]) -> dict[str, Any]:
    return {
        each.joint: {
            "torque_constant": {"value": each.constant, "sigma": each.sigma},
            "terms": {
                term.law.kind: {"value": term.value, "sigma": term.sigma, "unit": term.unit}
                for term in each.terms
            },
            "residual": each.residual,
            "unit": each.unit,
            "rows": each.rows,
            "choice": None if each.choice is None else _choice_as_json(each.choice),
        }
        for each in drives
    }


def _choice_as_json(choice: Choice) -> list[dict[str, Any]]:
    steps = [*choice.steps, *([] if choice.next_best is None else [choice.next_best])]
    return [
        {
            "added": step.kind,
            "held_out_residual": step.residual,
            "standard_errors": step.gain,
            "taken": step in choice.steps,
        }
        for step in steps
    ]
