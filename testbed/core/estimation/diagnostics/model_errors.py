"""Diagnostics of model errors detected in the residuals of an estimate."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.estimation.diagnostics.residuals import p_value_text
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.model_errors.estimates import ModelErrorEstimate

MAX_COEFFICIENTS = 3
"""Largest number of coefficients listed in a text."""

RESIDUAL_SUBJECTS = {
    "wrench": "the plate's residuals",
    "torque": "the torques' residuals",
}
"""Subject of diagnostics of the residuals, by method."""


def model_error_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Diagnostic of each detected model error: share of the residuals, treatment, remedy.

    The share is given for the channel in which it is largest.

    Args:
        estimate: Estimate with its model errors.
    """
    for error in estimate.model_errors:
        largest_channel = int(np.argmax(np.nan_to_num(error.share)))
        yield make_diagnostic(
            f"model-error.{treatment(error)}",
            RESIDUAL_SUBJECTS[estimate.method],
            min(float(error.share[largest_channel]), 1.0),
            significance=float(np.sqrt(2 * error.gain)),
            method=estimate.method,
            causes=[error.meaning] if error.physical else [],
            label=error.label,
            channel=estimate.label(largest_channel),
            effect=error.effect[largest_channel],
            unit=estimate.channel_units[largest_channel],
            gain=error.gain,
            numbers=coefficient_text(error),
            advice=error.remedy,
        )


MAX_CHANCE = 1e-6
"""Probability of a repetition by chance above which it is not reported."""


def repetition_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Diagnostic of residuals that repeat with the motion.

    It is reported if the p-value of the repetition is at most MAX_CHANCE (1e-6) and encoder noise
    does not limit the estimate, since errors due to this noise also repeat with the motion.

    Args:
        estimate: Estimate with the repeatable part of its residuals.
    """
    repeatable, noise = estimate.repeatable, estimate.noise
    if repeatable is None or repeatable.chance > MAX_CHANCE:
        return
    # errors of the parameters by encoder noise repeat with the motion, too
    if noise is None or noise.noise_limited:
        return
    largest_channel = int(np.argmax(repeatable.share))
    yield make_diagnostic(
        "estimate.repetition",
        RESIDUAL_SUBJECTS[estimate.method],
        float(repeatable.share[largest_channel]),
        method=estimate.method,
        level="warning" if estimate.model_errors else None,
        causes=["encoder-steps"] * noise.quantization_matters,
        again=repeatable.repetition_text,
        chance=p_value_text(repeatable.chance),
        channel=estimate.label(largest_channel),
        rms=repeatable.rms[largest_channel],
        unit=estimate.channel_units[largest_channel],
    )


def treatment(error: ModelErrorEstimate) -> str:
    """Treatment of a model error: "corrected", "named", "suspected" or "unexplained".

    An error without a physical law is "unexplained". Other errors are "corrected" if they were
    subtracted from the measurements, "named" if they are significant enough to be reported as the
    cause, and "suspected" otherwise.

    Args:
        error: Model error of one family.
    """
    if not error.physical:
        return "unexplained"
    if error.corrected:
        return "corrected"
    return "named" if error.named else "suspected"


def coefficient_text(error: ModelErrorEstimate) -> str:
    """Text of the most significant coefficients, with sigmas and units; "" without coefficients.

    Args:
        error: Model error of one family.
    """
    return ", ".join(
        f"{each.name} {each.value:.3g} +- {each.sigma:.2g} {each.unit}".rstrip()
        for each in error.coefficients[:MAX_COEFFICIENTS]
    )
