"""What noise does to an estimate that sigma cannot say alone."""

from __future__ import annotations

from testbed.errors import few
from testbed.identification.estimate import Estimate
from testbed.identification.noise.found_noise import FoundNoise

SMALL_CHANCE = 1e-3
"""Probability below which what is found is not taken for chance."""

CURE = "not identifiable, unless the total mass is known (--set identification.known.mass=20)"
"""Of a parameter that no motion tells from the plate's zero."""

DRIFT = 0.5
"""Part of a recording over which the noise of a channel holds on, and is a drift."""


def noise_warnings(estimate: Estimate) -> list[str]:
    """What constants, slow noise and noise of the encoders do to an estimate, a line each.

    Args:
        estimate: With what its noise was found to be.
    """
    noise = estimate.noise
    if noise is None:
        return []
    of_encoders = [*_drowned(noise), *_coarse(estimate, noise)]
    if noise.bias_chance > SMALL_CHANCE:
        return of_encoders + _drifting(estimate, noise)
    told = ", ".join(
        f"{channel} {value:.3g} +- {sigma:.2g} {unit}"
        for channel, unit, value, sigma in zip(
            estimate.channels, estimate.channel_units, noise.bias, noise.bias_sigma, strict=True
        )
        if sigma > 0 and abs(value) > 2 * sigma
    )
    hidden = (
        f"; {', '.join(noise.hidden)} cannot be told from a constant: {CURE}"
        if noise.hidden
        else ""
    )
    return [
        *of_encoders,
        f"the plate's zero is off, or drifts: constants were estimated with the parameters "
        f"({told}){hidden}",
    ]


def zero_unknown(noise: FoundNoise | None) -> tuple[str, ...]:
    """Parameters that no motion tells from the plate's zero, where that is off or drifts.

    Args:
        noise: What the residuals are found to be like.
    """
    if noise is None:
        return ()
    known = noise.bias_chance > SMALL_CHANCE and not any(_slow(noise))
    return () if known else noise.hidden


def _slow(noise: FoundNoise) -> list[bool]:
    """Of each channel, whether it wanders so slowly that its constant rests on nothing."""
    return [memory > DRIFT * noise.span for memory in noise.memory]


def _drifting(estimate: Estimate, noise: FoundNoise) -> list[str]:
    """Channels that wander as slowly as the recording lasts."""
    channels = zip(estimate.channels, noise.memory, _slow(noise), strict=True)
    slow = [f"{channel} ({memory:.2g} s)" for channel, memory, wanders in channels if wanders]
    if not slow or not noise.hidden:
        return []
    return [
        f"the plate's zero drifts: what is left of {', '.join(slow)} wanders as slowly as the "
        f"recording lasts; {', '.join(noise.hidden)} cannot be told from a constant: {CURE}"
    ]


def _drowned(noise: FoundNoise) -> list[str]:
    """Parameters that noise of the encoders hides."""
    if not noise.drowned:
        return []
    return [
        f"noise of the encoders is much of what these data show of {few(noise.drowned)}: sigma "
        "does not hold there; move faster, or filter lower (identification.cutoff)"
    ]


def _coarse(estimate: Estimate, noise: FoundNoise) -> list[str]:
    """Encoders whose steps are a large part of what the model leaves."""
    if not noise.steps_matter:
        return []
    steps = zip(estimate.joints, noise.least_counts, strict=True)
    told = few([f"'{name}' ({count:.3g} a step)" for name, count in steps if count])
    return [
        f"coarse encoders: {told} show whole steps and no noise between; such errors are about "
        f"{min(noise.by_counts, 1.0):.0%} of the residuals. They repeat with the motion, and a "
        "longer recording does not reduce them; sigma counts them as made ones are. Read the "
        "encoders finer, move faster, or filter lower (identification.cutoff)"
    ]
