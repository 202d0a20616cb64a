"""A designed motion and its proof, as JSON values."""

from __future__ import annotations

import math
from typing import Any

from testbed.excitation.prediction import Prediction
from testbed.excitation.proof import Proof
from testbed.experiment.excite import Excitation

BINDING = 0.01
"""A limit with less than this share of it left is one that binds."""
BINDING_DISTANCE = 0.01
"""Likewise for distances beyond the clearance [m]."""


def excitation_as_json(found: Excitation) -> dict[str, Any]:
    """What was designed, what it promises, what a random motion would.

    Args:
        found: The design.
    """
    design, motion = found.design, found.design.motion
    return {
        "fundamental": motion.fundamental,
        "harmonics": motion.harmonics,
        "criterion": found.experiment.excitation.criterion,
        "value": design.value,
        "complete": design.complete,
        "searches": [vars(search) for search in design.searches],
        "predicted": prediction_as_json(found.predicted),
        "random": None
        if found.random_predicted is None
        else prediction_as_json(found.random_predicted),
        "gain": found.gain,
        "diagnostics": [each.as_dict() for each in found.diagnostics],
        "proof": proof_as_json(design.proof),
    }


def prediction_as_json(predicted: Prediction) -> dict[str, Any]:
    """Predicted sigma; infinite ones as None."""

    def number(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    return {
        "rms_relative_sigma": number(predicted.rms),
        "condition": number(predicted.condition),
        "names": list(predicted.names),
        "sigma": [number(value) for value in predicted.sigma],
        "relative_sigma": [number(value) for value in predicted.relative],
    }


def proof_as_json(proof: Proof) -> dict[str, Any]:
    """What is left of each limit."""
    return {
        "holds": proof.holds,
        "instants": proof.instants,
        "postures": proof.postures,
        "binding": binding(proof),
        "margins": [vars(margin) for margin in proof.margins],
    }


def binding(proof: Proof) -> list[str]:
    """Limits that a motion comes up to."""
    return [
        margin.label
        for margin in proof.margins
        if margin.left < (BINDING_DISTANCE if margin.unit else BINDING)
    ]
