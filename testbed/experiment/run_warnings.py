"""What a careful reader of a run should know, in words: one line each, like things together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from testbed.experiment.score import Errors
from testbed.identification.cross_check import warnings_between
from testbed.identification.estimate import Estimate, Method
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree

CLOSE = 0.9
"""Correlation above which two parameters are told apart poorly."""

MOST_PAIRS = 5
"""Pairs that are named."""

FAR = 5.0
"""Errors in sigmas that noise does not make."""

CAUSES: Mapping[Method, str] = {
    "internal": "a wrong torque constant, friction of another law or an unmodelled rotor",
    "external": "a plate that is turned, late or off in its scales, or encoders that are",
}
"""Of errors that sigma does not tell."""

EXACT = 1e-6
"""Relative error that is of no matter, however small sigma is."""


def warnings_of(
    tree: Tree,
    recording: Recording,
    estimates: Mapping[Method, Estimate],
    failures: Mapping[Method, str],
    errors: Mapping[Method, Errors],
) -> tuple[str, ...]:
    """Of the model, the recording and the estimates, none twice.

    Args:
        tree: The robot.
        recording: What was measured.
        estimates: By method.
        failures: Why a method has no estimate.
        errors: Of the estimates, where the truth is known.
    """
    lines = [*tree.warnings, *recording.facts.get("warnings", ())]
    lines += [f"no {method} estimate: {reason}" for method, reason in failures.items()]
    for method, estimate in estimates.items():
        lines += [*estimate.warnings, *close_pairs(estimate)]
        if method in errors:
            lines += systematic_errors(estimate, errors[method])
    lines += warnings_between(estimates.values())
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


def systematic_errors(estimate: Estimate, errors: Errors) -> Iterator[str]:
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
    more = f" and of {others} more parameter{'s' * (others > 1)}" if others else ""
    yield (
        f"the {estimate.method} estimate of {estimate.names[worst]}{more} is off by more than "
        f"{FAR:g} sigma (up to {far[worst]:.0f}): its errors are systematic, such as "
        f"{CAUSES[estimate.method]}, and sigma does not tell them"
    )
