"""Diagnostics of model errors that the residuals of an estimate show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.estimation.diagnostics.residuals import chance_text
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.model_errors.estimates import ModelErrorEstimate

NAMED = 3
"""Most coefficients that are written."""

RESIDUALS = {"external": "the plate's residuals", "internal": "the torques' residuals"}


def model_error_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Families of model errors, what they make up of the residuals, and what is done about them.

    Args:
        estimate: With its model errors.
    """
    for error in estimate.model_errors:
        most = int(np.argmax(np.nan_to_num(error.share)))
        yield diagnose(
            f"model-error.{treatment(error)}",
            RESIDUALS[estimate.method],
            float(error.share[most]),
            significance=float(np.sqrt(2 * error.gain)),
            method=estimate.method,
            causes=[error.meaning] if error.physical else [],
            label=error.label,
            channel=estimate.label(most),
            effect=error.effect[most],
            unit=estimate.channel_units[most],
            gain=error.gain,
            numbers=numbers(error),
            advice=error.remedy,
        )


FALSE_ALARMS = 1e-6
"""Probability of a repetition by chance below which it is said."""


def repetition(estimate: Estimate) -> Iterator[Diagnostic]:
    """Residuals that repeat with the motion.

    Args:
        estimate: With what of them is repeatable.
    """
    found, noise = estimate.repeatable, estimate.noise
    if found is None or found.chance > FALSE_ALARMS:
        return
    # what noise of the encoders does to parameters repeats, too
    if noise is None or noise.noise_limited:
        return
    most = int(np.argmax(found.share))
    yield diagnose(
        "estimate.repetition",
        RESIDUALS[estimate.method],
        float(found.share[most]),
        method=estimate.method,
        level="warning" if estimate.model_errors else None,
        causes=["encoder-steps"] * noise.steps_matter,
        again=found.again,
        chance=chance_text(found.chance),
        channel=estimate.label(most),
        rms=found.rms[most],
        unit=estimate.channel_units[most],
    )


def treatment(error: ModelErrorEstimate) -> str:
    """What was done: "corrected", "named", "suspected" or "unexplained".

    Args:
        error: Of one family.
    """
    if not error.physical:
        return "unexplained"
    if error.corrected:
        return "corrected"
    return "named" if error.named else "suspected"


def numbers(error: ModelErrorEstimate) -> str:
    """The clearest coefficients in words; "" where there are none.

    Args:
        error: Of one family.
    """
    return ", ".join(
        f"{each.name} {each.value:.3g} +- {each.sigma:.2g} {each.unit}".rstrip()
        for each in error.coefficients[:NAMED]
    )
