"""Diagnostics of noise in the residuals: offset, drift, encoder noise and resolution."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import shortened_list
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.noise.noise_model import NoiseModel

SIGNIFICANCE_LEVEL = 1e-3
"""Probability below which an offset is not taken for chance."""


def has_residual_noise(estimate: Estimate) -> bool:
    """True if residuals exceed the effect of the low-pass filters on a noise-free motion.

    The limit is 1e-5 of the largest rms signal of all channels.

    Args:
        estimate: Estimate by either method.
    """
    rms = estimate.normal_equations.rms
    # part of the largest signal that the filters may leave of a perfect recording
    return bool(np.any(estimate.residual > 1e-5 * rms.max(initial=0.0)))


def noise_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Diagnostics of encoder noise, encoder resolution, and offset or drift of the plate.

    Args:
        estimate: Estimate with its noise model.
    """
    if estimate.noise is not None:
        yield from _encoder_diagnostics(estimate, estimate.noise)
        yield from _plate_diagnostics(estimate, estimate.noise)


def _encoder_diagnostics(estimate: Estimate, noise: NoiseModel) -> Iterator[Diagnostic]:
    """Diagnostics of encoder noise and encoder resolution.

    Encoder noise is reported if it makes up a large part of the columns of some parameters. Encoder
    resolution is reported if quantisation causes more than 5 % of the whitened residuals' sum of
    squares.
    """
    if noise.noise_limited:
        yield make_diagnostic(
            "encoder.noise", shortened_list(noise.noise_limited), method=estimate.method
        )
    if noise.quantization_matters:
        steps = zip(estimate.joints, noise.least_counts, strict=True)
        coarse = shortened_list(
            [f"'{name}' ({count:.3g} a step)" for name, count in steps if count]
        )
        share = min(noise.by_counts, 1.0)
        yield make_diagnostic(
            "encoder.resolution", coarse, share, method=estimate.method
        )


def _plate_diagnostics(estimate: Estimate, noise: NoiseModel) -> Iterator[Diagnostic]:
    """Diagnostic of a significant offset of the plate, else of a drift that hides parameters.

    An offset is significant if the constants of the channels have a p-value up to 1e-3. A drift is
    noise of a channel that is correlated over half of the recording; it hides parameters that are
    collinear with a constant.
    """
    hidden, verb = ", ".join(noise.hidden), "is" if len(noise.hidden) == 1 else "are"
    if noise.bias_chance <= SIGNIFICANCE_LEVEL:
        constants = zip(
            estimate.channels,
            estimate.channel_units,
            noise.bias,
            noise.bias_sigma,
            strict=True,
        )
        yield make_diagnostic(
            "plate.offset",
            "the plate",
            method="wrench",
            constants=", ".join(
                f"{channel} {value:.3g} +- {sigma:.2g} {unit}"
                for channel, unit, value, sigma in constants
                if sigma > 0 and abs(value) > 2 * sigma
            ),
            hidden=hidden,
            verb=verb,
        )
    elif any(_drifting_channels(noise)) and noise.hidden:
        memories = zip(
            estimate.channels, noise.memory, _drifting_channels(noise), strict=True
        )
        drifting = ", ".join(
            f"{channel} ({time:.2g} s)"
            for channel, time, is_drifting in memories
            if is_drifting
        )
        yield make_diagnostic(
            "plate.drift",
            "the plate",
            method="wrench",
            channels=drifting,
            hidden=hidden,
            verb=verb,
        )


def unidentifiable_beside_bias(noise: NoiseModel | None) -> tuple[str, ...]:
    """Parameters that cannot be separated from a significant offset or drift of the plate.

    The result is empty if there is neither an offset (p-value up to 1e-3) nor a drift (noise
    correlated over half the recording).

    Args:
        noise: Noise model of the residuals; None for white noise.
    """
    if noise is None:
        return ()
    known = noise.bias_chance > SIGNIFICANCE_LEVEL and not any(
        _drifting_channels(noise)
    )
    return () if known else noise.hidden


def p_value_text(p_value: float) -> str:
    """Text of a p-value, such as "p-value 1e-05"."""
    return f"p-value {p_value:.0e}" if p_value > 1e-99 else "p-value below 1e-99"


def _drifting_channels(noise: NoiseModel) -> list[bool]:
    """True for each channel whose noise is correlated over half of the recording.

    The slowest mode of such noise takes longer than half of the recording to decay to 1/e.
    """
    # correlation time relative to the recording, above which noise is a drift
    return [memory > 0.5 * noise.span for memory in noise.memory]
