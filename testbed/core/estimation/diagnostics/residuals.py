"""What residuals show: offsets, and noise of the encoders."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import few
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.noise.noise_model import NoiseModel

SMALL_CHANCE = 1e-3
"""Probability below which what is found is not taken for chance."""


def noisy(estimate: Estimate) -> bool:
    """Whether residuals are more than what the filter on positions takes from the motion.

    Args:
        estimate: Of either method.
    """
    rms = estimate.normal_equations.rms
    # part of the largest signal that the filters may leave of a perfect recording
    return bool(np.any(estimate.residual > 1e-5 * rms.max(initial=0.0)))


def noise_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """What offsets, slow noise and noise of the encoders do to an estimate.

    Args:
        estimate: With what its noise is like.
    """
    noise = estimate.noise
    if noise is None:
        return
    if noise.noise_limited:
        yield diagnose(
            "encoder.noise", few(noise.noise_limited), method=estimate.method
        )
    if noise.steps_matter:
        steps = zip(estimate.joints, noise.least_counts, strict=True)
        coarse = few(
            [f"'{name}' ({count:.3g} a step)" for name, count in steps if count]
        )
        share = min(noise.by_counts, 1.0)
        yield diagnose("encoder.resolution", coarse, share, method=estimate.method)
    hidden, verb = ", ".join(noise.hidden), "is" if len(noise.hidden) == 1 else "are"
    if noise.bias_chance <= SMALL_CHANCE:
        constants = zip(
            estimate.channels,
            estimate.channel_units,
            noise.bias,
            noise.bias_sigma,
            strict=True,
        )
        yield diagnose(
            "plate.offset",
            "the plate",
            method="external",
            constants=", ".join(
                f"{channel} {value:.3g} +- {sigma:.2g} {unit}"
                for channel, unit, value, sigma in constants
                if sigma > 0 and abs(value) > 2 * sigma
            ),
            hidden=hidden,
            verb=verb,
        )
    elif any(_slow(noise)) and noise.hidden:
        memories = zip(estimate.channels, noise.memory, _slow(noise), strict=True)
        slow = ", ".join(
            f"{channel} ({time:.2g} s)"
            for channel, time, is_slow in memories
            if is_slow
        )
        yield diagnose(
            "plate.drift",
            "the plate",
            method="external",
            channels=slow,
            hidden=hidden,
            verb=verb,
        )


def zero_unknown(noise: NoiseModel | None) -> tuple[str, ...]:
    """Parameters that are not identifiable beside the plate's zero, where that is off or drifts.

    Args:
        noise: What the residuals are like.
    """
    if noise is None:
        return ()
    known = noise.bias_chance > SMALL_CHANCE and not any(_slow(noise))
    return () if known else noise.hidden


def chance_text(chance: float) -> str:
    """A probability as a person reads it."""
    return f"chance {chance:.0e}" if chance > 1e-99 else "chance below 1e-99"


def _slow(noise: NoiseModel) -> list[bool]:
    """Of each channel, whether it wanders so slowly that its constant rests on nothing."""
    # part of a recording over which the noise of a channel is correlated, and is a drift
    return [memory > 0.5 * noise.span for memory in noise.memory]
