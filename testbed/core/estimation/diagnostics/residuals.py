"""What residuals show: faults of the instrument, repetition, offsets, and noise of the encoders."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import special

from testbed.core.base.diagnostics import Diagnostic, diagnose, phrase
from testbed.core.base.errors import few
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.noise.noise_model import NoiseModel
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.estimation.sensor.estimates import TraceTest
from testbed.sensors.catalogue import systematic_errors
from testbed.sensors.errors.encoder_zero_error import EncoderZeroError

FALSE_ALARMS = 1e-6
"""Nominal probability of a diagnostic of a recording without any fault, all its tests together. It
is small since noise need not be what the model of it says: of poor encoders it grows with the
robot's inertia."""

NAMED = 3
"""Most causes, and most numbers of a cause, that are named."""

LIKE_TILT = {"crosstalk", "gains", "pose"}
"""Kinds whose effects the weight on a plate that is not level resembles."""

SMALL_CHANCE = 1e-3
"""Probability below which what is found is not taken for chance."""


def fault_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """What the residuals hold that is no noise.

    Args:
        estimate: With its tests, the clearest first.
    """
    tests = estimate.trace_tests
    if not noisy(estimate):
        return
    clear = [
        t for t in tests if t.chance * len(tests) < FALSE_ALARMS and not _too_far(t)
    ]
    if not clear:
        yield from _repetition(estimate)
        return
    best, terms = clear[0], [test.nuisance for test in clear[:NAMED]]
    yield diagnose(
        f"sensor.{best.nuisance}",
        "the plate's residuals",
        best.shift,
        significance=float(-special.ndtri(max(best.chance / 2, TINY))),
        method="external"
        if systematic_errors()[best.nuisance].signal == "wrench"
        else "",
        causes=[*terms, *["level"] * bool(LIKE_TILT & {*terms}), "unmodelled-load"],
        chance=chance_text(best.chance),
        cause=phrase(best.nuisance),
        kind=best.nuisance,
        size=", ".join(best.largest(NAMED)),
        parameter=best.parameter,
    )


def _too_far(test: TraceTest) -> bool:
    """Whether a wrong zero is so large that it is none: columns of it hold to first order."""
    one = test.alone if test.nuisance == EncoderZeroError.term else None
    # largest offset of an encoder to be named [rad]: noise that wanders imitates larger ones, whose
    # columns the parameters nearly make up
    return one is not None and one.unit == "rad" and abs(one.value) > 0.5


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


def _repetition(estimate: Estimate) -> Iterator[Diagnostic]:
    """Residuals that repeat with the motion, for a cause that was not tested for."""
    noise = estimate.noise
    repetition = None if noise is None else noise.repetition
    if noise is None or repetition is None or repetition.chance > FALSE_ALARMS:
        return
    share, channel = max(zip(repetition.share, estimate.channels, strict=True))
    first = ["encoder-steps"] * noise.steps_matter
    yield diagnose(
        "estimate.repetition",
        "the plate's residuals",
        share,
        method="external",
        causes=[*first, "elastic", "hoses", "encoder-errors", "unmodelled-load"],
        period=repetition.period,
        chance=chance_text(repetition.chance),
        channel=channel,
    )
