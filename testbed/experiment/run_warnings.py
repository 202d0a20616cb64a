"""What a careful reader of a run should know: findings, and other things in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from testbed.errors import plural
from testbed.experiment.score import Errors
from testbed.identification.cross_check import findings_of
from testbed.identification.estimate import Estimate, Method
from testbed.identification.finding import Finding
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree

CLOSE = 0.9
"""Correlation above which two parameters are told apart poorly."""

MOST_PAIRS = 5
"""Pairs that are named."""

FAR = 5.0
"""Errors in sigmas that noise does not make."""

CAUSES: Mapping[Method, tuple[str, ...]] = {
    "internal": ("a wrong torque constant", "friction of another law", "an unmodelled rotor"),
    "external": ("a plate that is turned, late or off in its scales", "encoders that are"),
}
"""Of errors that sigma does not tell."""

EXACT = 1e-6
"""Relative error that is of no matter, however small sigma is."""


def findings_of_run(
    estimates: Mapping[Method, Estimate], errors: Mapping[Method, Errors]
) -> tuple[Finding, ...]:
    """What is wrong with a recording or its estimates.

    Args:
        estimates: By method.
        errors: Of the estimates, where the truth is known.
    """
    judged = [each for m in errors for each in systematic_errors(estimates[m], errors[m])]
    return (*findings_of(estimates.values()), *judged)


def notes_of(
    tree: Tree,
    recording: Recording,
    estimates: Mapping[Method, Estimate],
    failures: Mapping[Method, str],
) -> tuple[str, ...]:
    """What else to know of the model, the recording and the estimates, a line each, none twice.

    Args:
        tree: The robot.
        recording: What was measured.
        estimates: By method.
        failures: Why a method has no estimate.
    """
    lines = [f"no {method} estimate: {reason}" for method, reason in failures.items()]
    lines += [*tree.warnings, *recording.facts.get("warnings", ())]
    for estimate in estimates.values():
        lines += [*estimate.notes, *close_pairs(estimate)]
    return tuple(dict.fromkeys(lines))


def close_pairs(estimate: Estimate) -> Iterator[str]:
    """Parameters that the data tell apart poorly, worst first.

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
    yield (
        f"the {estimate.method} estimate tells apart poorly: {', '.join(named)}"
        f"{f' and {more} more pairs' if more else ''}"
    )


def systematic_errors(estimate: Estimate, errors: Errors) -> Iterator[Finding]:
    """Errors that no sigma explains.

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
    yield Finding(
        f"the {estimate.method} estimate of {estimate.names[worst]}{more}",
        f"is off by more than {FAR:g} sigma (up to {far[worst]:.0f}): its errors are systematic, "
        "and sigma does not tell them",
        float(far[worst]),
        CAUSES[estimate.method],
        "look at what the instrument was given (`testbed faults`)",
        code="systematic-error",
        method=estimate.method,
    )
