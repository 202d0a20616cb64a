"""What a careful reader of a run should know."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from testbed.diagnostics.diagnostic import Diagnostic, diagnose, of_recording, ordered
from testbed.errors import plural
from testbed.experiment.score import Errors
from testbed.identification.diagnostics.cross_check import diagnostics_of
from testbed.identification.estimate import Estimate, Method
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree

CLOSE = 0.9
"""Correlation above which two parameters are named."""

MOST_PAIRS = 5
"""Pairs that are named."""

FAR = 5.0
"""Errors in sigmas that noise does not make."""

CAUSES: Mapping[Method, tuple[str, ...]] = {
    "internal": ("torque-constant", "friction-law", "rotor"),
    "external": ("plate-errors", "encoder_delays"),
}
"""Of errors that sigma does not count."""

EXACT = 1e-6
"""Relative error that is of no matter, however small sigma is."""


def diagnostics_of_run(
    tree: Tree,
    recording: Recording,
    estimates: Mapping[Method, Estimate],
    failures: Mapping[Method, str],
    errors: Mapping[Method, Errors],
) -> tuple[Diagnostic, ...]:
    """What to know of the model, the recording and the estimates.

    Args:
        tree: The robot.
        recording: What was measured.
        estimates: By method.
        failures: Why a method has no estimate.
        errors: Of the estimates, where the truth is known.
    """
    missing = [diagnose("estimate.missing", m, reason=reason) for m, reason in failures.items()]
    found = [*diagnostics_of(estimates.values())]
    for method in errors:
        found += systematic_errors(estimates[method], errors[method])
    for estimate in estimates.values():
        found += correlated(estimate)
    return ordered([*missing, *tree.diagnostics, *of_recording(recording.facts), *found])


def correlated(estimate: Estimate) -> Iterator[Diagnostic]:
    """Parameters of large correlation, the largest first.

    Args:
        estimate: Of one method.
    """
    scale = np.sqrt(np.maximum(np.diagonal(estimate.covariance), 1e-300))
    correlation = estimate.covariance / np.outer(scale, scale)
    pairs = np.argwhere(np.triu(np.abs(correlation) > CLOSE, 1)).tolist()
    pairs.sort(key=lambda pair: -abs(correlation[pair[0], pair[1]]))
    if not pairs:
        return
    named = [
        f"{estimate.names[a]} and {estimate.names[b]} (correlation {correlation[a, b]:.2f})"
        for a, b in pairs[:MOST_PAIRS]
    ]
    more = len(pairs) - len(named)
    yield diagnose(
        "estimate.correlated",
        f"the {estimate.method} estimate",
        correlation[pairs[0][0], pairs[0][1]],
        method=estimate.method,
        pairs=", ".join(named) + (f" and {more} more pairs" if more else ""),
    )


def systematic_errors(estimate: Estimate, errors: Errors) -> Iterator[Diagnostic]:
    """Errors that sigma does not explain.

    Args:
        estimate: Of one method.
        errors: Of its values.
    """
    gap = np.abs(estimate.values - errors.truth)
    rounding = EXACT * np.abs(errors.truth).max(initial=0.0)  # where nothing has a scale
    exact = np.where(np.isnan(errors.relative), gap < rounding, np.abs(errors.relative) < EXACT)
    off = (np.abs(errors.z) > FAR) & ~exact
    if not off.any():
        return
    far = np.where(off, np.abs(errors.z), 0.0)
    worst = int(far.argmax())
    others = int(off.sum()) - 1
    more = f" and of {plural(others, 'more parameter')}" if others else ""
    yield diagnose(
        "estimate.bias",
        f"the {estimate.method} estimate of {estimate.names[worst]}{more}",
        float(far[worst]),
        method=estimate.method,
        causes=CAUSES[estimate.method],
        limit=FAR,
    )
