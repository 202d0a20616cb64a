"""Faults of the instrument that have left a trace in the residuals, as a person is told."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import special

from testbed.identification.estimate import Estimate
from testbed.identification.finding import Finding
from testbed.identification.nuisances.encoder_errors import (
    ECCENTRICITY,
    ENCODER_DELAYS,
    ENCODER_GAINS,
    JOINT_ZEROS,
    SAMPLING,
)

FALSE_ALARMS = 1e-6
"""Nominal probability of a word about a recording without any fault, all its tests together. It is
small since noise need not be what the model of it says: of poor encoders it grows with the
robot's inertia."""

FILTERED = 1e-5
"""Part of the largest signal that the filters may leave of a perfect recording."""

NAMED = 3
"""Most causes, and most numbers of a cause, that are named."""

UNTESTED = ("elastic joints or structure", "cables or hoses")

OF_ENCODERS = (JOINT_ZEROS, ENCODER_GAINS, ENCODER_DELAYS, ECCENTRICITY, SAMPLING)
"""Faults that spoil what torques tell as well."""

TINY = float(np.finfo(float).tiny)
"""Least chance that has a number of sigmas."""

LEVEL = "a bedplate that is not level"
LIKE_TILT = {"crosstalk", "gains", "pose"}
"""Kinds whose traces weight that leans resembles."""

LACKING = "something on the plate that the model lacks"


def trace_findings(estimate: Estimate) -> Iterator[Finding]:
    """What the residuals hold that is no noise.

    Args:
        estimate: With its tests, the clearest first.
    """
    tests = estimate.trace_tests
    if not noisy(estimate):
        return
    clear = [test for test in tests if test.chance * len(tests) < FALSE_ALARMS]
    if not clear:
        yield from _repetition(estimate)
        return
    best = clear[0]
    named = [test.nuisance.said for test in clear[:NAMED]]
    leaning = [LEVEL] if LIKE_TILT & {test.nuisance.kind for test in clear[:NAMED]} else []
    yield Finding(
        "the plate's residuals",
        f"hold what noise does not explain ({_chance(best.chance)}), but {best.nuisance.said} "
        f"would ({', '.join(best.largest(NAMED))}); estimating it would move {best.parameter} by "
        f"{best.shift:.2g} sigma",
        best.shift,
        (*named, *leaning, LACKING),
        best.nuisance.remedy,
        code=f"fault-{best.nuisance.kind}",
        method="" if best.nuisance in OF_ENCODERS else "external",
        support=float(-special.ndtri(max(best.chance / 2, TINY))),
    )


def noisy(estimate: Estimate) -> bool:
    """Whether residuals are more than what the filter on positions takes from the motion.

    Args:
        estimate: Of either method.
    """
    rms = estimate.normal_equations.rms
    return bool(np.any(estimate.residual > FILTERED * rms.max(initial=0.0)))


def _repetition(estimate: Estimate) -> Iterator[Finding]:
    """Residuals that repeat with the motion, for a cause that was not tested for."""
    noise = estimate.noise
    found = None if noise is None else noise.repetition
    if noise is None or found is None or found.chance > FALSE_ALARMS:
        return
    first = ("steps of coarse encoders",) * noise.steps_matter
    share, channel = max(zip(found.share, estimate.channels, strict=True))
    yield Finding(
        "the plate's residuals",
        f"repeat with the motion every {found.period:.4g} s ({_chance(found.chance)}), up to "
        f"{share:.0%} of them in {channel}",
        share,
        (*first, *UNTESTED, "errors of the encoders", LACKING),
        "plot them beside the joints' motion (`testbed view`)",
        code="repetition",
        method="external",
    )


def _chance(chance: float) -> str:
    return f"chance {chance:.0e}" if chance > 1e-99 else "chance below 1e-99"
