"""Verdict on estimates of a recording: faults sorted by severity, or prediction errors.

The verdict is based on prediction errors of held-out parts if there are any, otherwise on
residuals.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace

import numpy as np

from testbed.bodies.posterior import Posterior
from testbed.bodies.prediction_errors import POSTERIOR
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import (
    Diagnostic,
    cause_phrase,
    make_diagnostic,
    message_table,
    ordered_diagnostics,
)
from testbed.core.estimation.diagnostics.diagnosis import THRESHOLDS
from testbed.core.estimation.diagnostics.torques import diagnostics_of_estimates
from testbed.core.estimation.estimate import (
    Estimate,
    channel_label,
    non_negligible_residuals,
)
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE

MAX_PRIOR_ERROR = 1.0
"""Relative error of the model file's bodies above which the file is reported as uninformative."""

MIN_EPISODE_RATIO, MAX_EPISODE_PARTS, MIN_EPISODE_SIGNAL = 4.0, 2, 0.05
"""An episode of large residuals, which a model error does not explain: smallest ratio to the median
residual of the parts; largest number of parts; smallest ratio to the channel's signal."""

RECORDING_CODES = {
    "recording.unexplained",
    "torque.gains",
    "torque.size",
    "position.step",
    "position.still",
    "mapping.unlikely",
}
"""Codes of recording diagnostics that invalidate every estimate."""

MODEL_ERROR_PREFIX = "model-error."
"""Prefix of the codes of model errors, which standard deviations include."""

WELL_CODE = "verdict.well"
"""Code of the diagnostic of a verdict without reservations."""


def verdict_of(
    estimates: Iterable[Estimate],
    posteriors: Collection[Posterior] = (),
    reported: str = POSTERIOR,
    doubts: Iterable[Diagnostic] = (),
) -> tuple[Diagnostic, ...]:
    """Verdict on estimates: diagnostics sorted by severity, or prediction errors per method.

    The diagnostics of the recording are those with a code in `RECORDING_CODES`, raised to level
    "error"; the diagnostics of the posteriors concern poor predictions (`_reservations`); the
    diagnostics of least squares have level "error" or concern model errors. Mere symptoms of least
    squares are left out if the posterior is reported.

    Args:
        estimates: Least-squares estimates from one recording.
        posteriors: Estimates with the model file as prior, from an imported recording.
        reported: Name of the reported estimate of a posterior: "posterior" or "plain".
        doubts: Diagnostics of the robot and the recording.

    Returns:
        These diagnostics. If there are none, one diagnostic for each posterior with its errors on
        held-out parts or, without posteriors, one for each estimate with its relative residuals.
    """
    estimate_list = list(estimates)
    recording_errors = [
        replace(each, level="error") for each in doubts if each.code in RECORDING_CODES
    ]
    reservations = [
        diagnostic
        for each in posteriors
        for diagnostic in _reservations(each, reported)
    ]
    posterior_methods = {
        each.method for each in posteriors if each.used and reported == POSTERIOR
    }
    reservations += [
        diagnostic
        for diagnostic in diagnostics_of_estimates(estimate_list)
        if diagnostic.level == "error"
        # symptoms of least squares, which is not reported
        and not (
            diagnostic.method in posterior_methods
            and message_table()[diagnostic.code].symptom
        )
    ]
    reservations += [
        diagnostic
        for each in estimate_list
        for diagnostic in each.diagnostics
        if diagnostic.code.startswith(MODEL_ERROR_PREFIX)
    ]
    if recording_errors or reservations:
        return ordered_diagnostics([*recording_errors, *reservations])
    if not posteriors:
        return tuple(
            _prediction_line(each.instrument, each.relative_residual, "fitted")
            for each in estimate_list
        )
    held_out = [(each.instrument, each.errors[0]) for each in posteriors]
    return tuple(
        _prediction_line(name, each.share(reported), each.of) for name, each in held_out
    )


def _prediction_line(instrument: str, share: Array, of: str) -> Diagnostic:
    """Diagnostic with the range of relative prediction errors over the channels.

    Args:
        instrument: Name of the instrument.
        share: Ratios of prediction errors to signals, (C,), for C channels.
        of: Kind of the predicted data (`PredictionErrors.of`), or "fitted".
    """
    least, most = 100 * np.nanmin(share), 100 * np.nanmax(share)
    return make_diagnostic(
        "verdict.well", instrument, float(most), least=least, of=cause_phrase(of)
    )


def _reservations(estimate: Posterior, reported: str) -> Iterator[Diagnostic]:
    """Diagnostics of better rivals, poor predictions, residual episodes and an uninformative file.

    A prediction is poor if its held-out error exceeds 0.2 times the signal of the channel; the
    diagnostic has level "error" if the held-out error also exceeds 0.2 times the largest signal
    with the same unit. Channels with too few rows are reported. The file is uninformative if its
    relative error exceeds `MAX_PRIOR_ERROR` (1).

    Args:
        estimate: Posterior of one method.
        reported: Name of the reported estimate: "posterior" or "plain".
    """
    yield from estimate.worse_channels(reported)
    method, held_out = estimate.method, estimate.errors[0]
    residual, signal, units = (
        held_out.residual[reported],
        held_out.signal,
        held_out.units,
    )
    is_grave = non_negligible_residuals(
        residual, signal, units, THRESHOLDS.relative_residual
    )
    for c, share in enumerate(held_out.share(reported).tolist()):
        label = channel_label(method, held_out.channels[c])
        if np.isnan(signal[c]):
            yield make_diagnostic(
                "verdict.few-rows", label, held_out.rows[c], method=method
            )
        elif share > THRESHOLDS.relative_residual:
            yield make_diagnostic(
                "verdict.residual",
                label,
                share,
                method=method,
                level="error" if is_grave[c] else None,
                residual=residual[c],
                signal=signal[c],
                unit=units[c],
                small=not is_grave[c],
            )
    yield from _episodes(estimate)
    if (
        reported == POSTERIOR
        and estimate.used
        and estimate.prior_error > MAX_PRIOR_ERROR
    ):
        yield make_diagnostic(
            "verdict.file", "the model file", estimate.prior_error, method=method
        )


def _episodes(estimate: Posterior) -> Iterator[Diagnostic]:
    """Diagnostics of channels with large residuals in one or two consecutive parts.

    A residual is large if it exceeds both four times the median over the parts and 0.05 times the
    signal of the channel.
    """
    median = np.median(estimate.by_part, axis=0)
    is_large = (estimate.by_part > MIN_EPISODE_RATIO * median) & (median > 0)
    bounds = np.linspace(0.0, estimate.duration, len(estimate.by_part) + 1)
    for c in np.flatnonzero(
        (is_large.sum(axis=0) > 0) & (is_large.sum(axis=0) <= MAX_EPISODE_PARTS)
    ).tolist():
        parts = np.flatnonzero(is_large[:, c])
        residual = float(estimate.by_part[parts, c].max())
        if (
            parts[-1] - parts[0] >= MAX_EPISODE_PARTS
            or not residual > MIN_EPISODE_SIGNAL * estimate.errors[0].signal[c]
        ):
            continue
        yield make_diagnostic(
            "verdict.episode",
            channel_label(estimate.method, estimate.errors[0].channels[c]),
            residual / max(float(median[c]), SMALLEST_POSITIVE),
            method=estimate.method,
            begin=bounds[parts[0]],
            end=bounds[parts[-1] + 1],
            residual=residual,
            unit=estimate.errors[0].units[c],
        )
