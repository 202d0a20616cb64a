"""Low-pass on positions, chosen by cross-validation where accelerations are mostly noise.

With slow or coarse encoders, or with poses recorded twice, the computed accelerations contain
little of the motion, since the default filter for the sampling rate passes too much noise.
"""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import RecordingError, shortened_list
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE
from testbed.core.estimation.regression.passes import SURVEY_SAMPLES
from testbed.core.estimation.regression.windows import motion_taps
from testbed.core.estimation.selection.term_choice import cross_validate
from testbed.core.estimation.settings import FIT_TO_SAMPLING_RATE

NOISE_SHARE_LIMIT = 0.8
"""Share of accelerations' squares above the slowest filter's cutoff that indicates mostly noise."""

CUTOFF_RATIOS = (2.0, 3.0, 4.5)
"""Cutoffs of the candidate filters, relative to the cutoff on rows; lower ratios bias the
estimate."""

MAX_SQUARES_RATIO = 0.5
"""Largest ratio of squared test residuals to the default filter's, in the geometric mean of all
channels, for a filter to be chosen."""


def with_position_filter(problem: Problem) -> tuple[Problem, tuple[Diagnostic, ...]]:
    """Problem with the best low-pass on positions, and a diagnostic if it was changed.

    Candidate cutoffs are CUTOFF_RATIOS times the cutoff on rows. They are tried if, for half of the
    joints, more than 80 % of the squared acceleration lies above the lowest of these cutoffs. The
    filter is changed only if the best candidate halves the squared test residuals (geometric mean
    over the channels) and no cutoff was stated.

    Args:
        problem: Problem of either method with all terms stated.
    """
    row_cutoff = problem.settings.row_low_pass
    if (
        problem.requested_settings.position_cutoff != FIT_TO_SAMPLING_RATE
        or problem.source.senses_kinematics
        or row_cutoff is None
    ):
        return problem, ()
    fast_shares = _fast_shares(problem, CUTOFF_RATIOS[0] * row_cutoff)
    cutoffs = [
        ratio * row_cutoff
        for ratio in CUTOFF_RATIOS
        if ratio * row_cutoff < problem.source.rate / 2
    ]
    if not np.median(fast_shares) > NOISE_SHARE_LIMIT or not cutoffs:
        return problem, ()
    filtered = [problem.with_settings(position_cutoff=cutoff) for cutoff in cutoffs]
    try:
        rms = [
            cross_validate(each).residual + SMALLEST_POSITIVE
            for each in (problem, *filtered)
        ]
    except RecordingError:  # too short for cross-validation
        return problem, ()
    default, *others = np.log(rms).mean(axis=1)
    ratios = np.exp(2 * (np.array(others) - default))
    best = int(ratios.argmin())
    if ratios[best] >= MAX_SQUARES_RATIO:
        return problem, ()
    joints = shortened_list(
        [
            f"'{problem.tree.names[k]}'"
            for k in np.flatnonzero(fast_shares > NOISE_SHARE_LIMIT)
        ]
    )
    rms_ratio = float(ratios[best] ** 0.5)
    return filtered[best], (
        make_diagnostic("encoder.filter", joints, cutoffs[best], share=rms_ratio),
    )


def _fast_shares(problem: Problem, cutoff: float) -> Array:
    """Fraction of each squared acceleration that a slower filter removes, (n,).

    The fractions are zero for recordings shorter than the filters.

    Args:
        problem: Problem with the default filter.
        cutoff: Cutoff of the slower filter [Hz].
    """
    first, last = problem.source.segments[0]
    part = problem.source.part(first, min(last, first + SURVEY_SAMPLES)).ordered(
        problem.tree
    )
    squares = []
    for cutoff_frequency in (problem.settings.position_low_pass, cutoff):
        taps = motion_taps(problem.source.rate, cutoff_frequency)[2]
        if part.samples <= len(taps):
            return np.zeros(problem.tree.n)
        signals = (np.convolve(q, taps[::-1], "valid") for q in part.position.T)
        squares.append([float(np.mean(signal**2)) for signal in signals])
    squares_default, squares_slow = np.array(squares)
    return np.asarray(1 - squares_slow / np.maximum(squares_default, SMALLEST_POSITIVE))
