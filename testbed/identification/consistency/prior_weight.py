"""How far a model file's bodies are to be trusted: chosen by data that the fit has not seen.

Each half of a recording is foretold by consistent bodies made of the other one, with one prior
error after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from testbed.errors import RecordingError, SettingsError, UnseenParameters
from testbed.identification.consistency.consistent import Consistent, consistent
from testbed.identification.consistency.options import ConsistencyOptions
from testbed.identification.estimate import Estimate, Method
from testbed.parameters.prior import Prior
from testbed.recordings.source import Source, Stretch
from testbed.robot.tree import Tree

OFFERED = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Prior errors that are tried."""

Identified = Callable[[Source, Method], Estimate]


def consistent_by_held_out(
    tree: Tree,
    estimates: Sequence[Estimate],
    prior: Prior,
    options: ConsistencyOptions,
    source: Source,
    identified: Identified,
) -> Consistent:
    """Consistent bodies, the prior's error chosen by held-out data where that is asked.

    Args:
        tree: The robot.
        estimates: Of the whole recording.
        prior: The bodies before the data.
        options: What is asked besides.
        source: The recording.
        identified: Makes an estimate of a source, as those of the whole were made.

    Raises:
        SettingsError: Half the recording is too little for an estimate; or as `consistent`.
    """
    if options.prior_error != "chosen":
        return consistent(tree, estimates, prior, options)
    halves = _halves(source, [each.method for each in estimates], identified)
    tried = {error: _left(tree, halves, prior, options, error) for error in OFFERED}
    best = min(tried, key=lambda error: tried[error])
    return consistent(tree, estimates, prior, replace(options, prior_error=best), tried=tried)


def _halves(
    source: Source, methods: Sequence[Method], identified: Identified
) -> tuple[list[Estimate], list[Estimate]]:
    """Estimates of either half, by all methods."""
    middle = source.samples // 2
    halves = Stretch(source, 0, middle), Stretch(source, middle, source.samples)
    try:
        first, second = ([identified(half, method) for method in methods] for half in halves)
    except (RecordingError, UnseenParameters) as error:
        raise SettingsError(
            f'prior_error = "chosen" needs an estimate of each half of the recording: {error}; '
            "give a number, such as 0.5"
        ) from None
    return first, second


def _left(
    tree: Tree,
    halves: tuple[list[Estimate], list[Estimate]],
    prior: Prior,
    options: ConsistencyOptions,
    error: float,
) -> float:
    """Rms of what is foretold wrongly of either half, in sigmas of its noise."""
    squares = []
    for known, unseen in (halves, halves[::-1]):
        found = consistent(tree, known, prior, replace(options, prior_error=error))
        by_method = {each.method: each for each in unseen}
        for own in found.bent:
            other = by_method[own.method]
            equations = other.normal_equations
            left = np.diagonal(equations.residual(own.values)) / np.maximum(equations.used, 1.0)
            noise = np.maximum(other.residual, np.finfo(float).tiny)
            squares.append(float(np.mean((left / noise**2)[equations.used > 0])))
    return float(np.sqrt(np.mean(squares)))
