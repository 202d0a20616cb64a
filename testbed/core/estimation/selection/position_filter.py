"""The low-pass on positions, chosen by held-out data where accelerations are mostly noise.

Slow or coarse encoders, and poses that are recorded twice, make accelerations that hold little of
the motion: the filter that fits the sampling rate lets them pass.
"""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import RecordingError, few
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.estimation.regression.passes import SAMPLES
from testbed.core.estimation.regression.windows import motion_taps
from testbed.core.estimation.selection.term_choice import held_out
from testbed.core.estimation.settings import FIT

MOSTLY = 0.8
"""Part of accelerations' square beyond the slowest filter, from which they are mostly noise."""

SLOWER = (2.0, 3.0, 4.5)
"""Filters that are tried, in cutoffs of the rows; slower ones would bias the estimate."""

BETTER = 0.5
"""Part of the default filter's squares, in the geometric mean of all channels, that a filter may
leave of unseen data to be chosen."""


def with_position_filter(problem: Problem) -> tuple[Problem, tuple[Diagnostic, ...]]:
    """A problem with a slower filter on positions, where that predicts far better, and a warning.

    Args:
        problem: By either method, with all terms said.
    """
    rows = problem.settings.row_low_pass
    if (
        problem.asked.position_cutoff != FIT
        or problem.source.senses_kinematics
        or rows is None
    ):
        return problem, ()
    noise = _noise(problem, SLOWER[0] * rows)
    cutoffs = [
        times * rows for times in SLOWER if times * rows < problem.source.rate / 2
    ]
    if not np.median(noise) > MOSTLY or not cutoffs:
        return problem, ()
    slower = [problem.with_settings(position_cutoff=cutoff) for cutoff in cutoffs]
    try:
        rms = [held_out(each).residual + TINY for each in (problem, *slower)]
    except RecordingError:  # too short to be cut into parts
        return problem, ()
    default, *others = np.log(rms).mean(axis=1)
    shares = np.exp(2 * (np.array(others) - default))
    best = int(shares.argmin())
    if shares[best] >= BETTER:
        return problem, ()
    noisy = few([f"'{problem.tree.names[k]}'" for k in np.flatnonzero(noise > MOSTLY)])
    share = float(shares[best] ** 0.5)
    return slower[best], (
        diagnose("encoder.filter", noisy, cutoffs[best], share=share),
    )


def _noise(problem: Problem, cutoff: float) -> Array:
    """Part of each acceleration's square that is faster than a filter, (n,)."""
    first, last = problem.source.segments[0]
    part = problem.source.part(first, min(last, first + SAMPLES)).ordered(problem.tree)
    squares = []
    for each in (problem.settings.position_low_pass, cutoff):
        taps = motion_taps(problem.source.rate, each)[2]
        if part.samples <= len(taps):
            return np.zeros(problem.tree.n)
        signals = (np.convolve(q, taps[::-1], "valid") for q in part.position.T)
        squares.append([float(np.mean(signal**2)) for signal in signals])
    whole, slow = np.array(squares)
    return np.asarray(1 - slow / np.maximum(whole, TINY))
