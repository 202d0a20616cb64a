"""Faults of the instrument that have left a trace in the residuals, as a person is told."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.identification.estimate import Estimate
from testbed.identification.finding import Finding
from testbed.identification.nuisances.estimates import TraceTest

FALSE_ALARMS = 1e-6
"""Nominal probability of a word about a recording without any fault, all its tests together. It is
small since noise need not be what the model of it says: of poor encoders it grows with the
robot's inertia."""

FILTERED = 1e-5
"""Part of the largest signal that the filters may leave of a perfect recording."""

NAMED = 3
"""Most causes, and most numbers of a cause, that are named."""

LACKING = "something on the plate that the model lacks"


def trace_findings(estimate: Estimate) -> Iterator[Finding]:
    """What the residuals hold that is no noise.

    Args:
        estimate: With its tests, the clearest first.
    """
    tests, rms = estimate.trace_tests, estimate.normal_equations.rms
    if not np.any(estimate.residual > FILTERED * rms.max(initial=0.0)):
        return  # no noise: what the filter on positions takes from the motion is left
    clear = [test for test in tests if test.chance * len(tests) < FALSE_ALARMS]
    if not clear:
        return
    best = clear[0]
    yield Finding(
        "the plate's residuals",
        f"hold what noise does not explain ({_chance(best)}), but {best.nuisance.said} would "
        f"({', '.join(best.largest(NAMED))}); estimating it would move {best.parameter} by "
        f"{best.shift:.2g} sigma",
        best.shift,
        (*(test.nuisance.said for test in clear[:NAMED]), LACKING),
        best.nuisance.remedy,
    )


def _chance(test: TraceTest) -> str:
    return f"chance {test.chance:.0e}" if test.chance > 1e-99 else "chance below 1e-99"
