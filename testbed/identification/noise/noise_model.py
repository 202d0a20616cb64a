"""What an estimate's residuals are like."""

from __future__ import annotations

from dataclasses import dataclass

from testbed.arrays import Array
from testbed.identification.noise.period import PeriodicResidual
from testbed.identification.noise.time_delay import TimeDelay

COARSE = 0.05
"""Part of the whitened residuals that steps of the encoders may be without a word."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """The noise that an estimate was made under.

    Attributes:
        order: Of each channel's autoregression; 0 where noise is taken as white.
        memory: Time in which the slowest part of each channel's noise fades to 1/e, (C,) [s].
        factor: By which sigma is larger than the formula's, found by a bootstrap.
        bias: Constants of the channels, with their weight, (C,) [N, N m]; zero if not looked for.
        bias_sigma: Their standard deviations, (C,).
        bias_chance: Probability of constants as large as these where there are none.
        bias_weight: Of the answer with constants, 0 to 1; the one without has the rest.
        span: How long the recording is [s].
        hidden: Parameters that no motion can tell from a constant of a channel.
        noise_limited: Parameters whose columns are in large part noise of the encoders, alone or
            together: sigma does not hold for them.
        least_counts: Of encoders that show whole counts and no noise between, zero for others,
            (n,) [rad or m]; empty if there are none.
        by_counts: Part of the whitened residuals that such counts account for.
        repetition: Whether the residuals repeat with the motion; None where that cannot be told.
        lateness: Of joint torques against the encoders; None of a plate.
    """

    order: int
    memory: tuple[float, ...]
    factor: float
    bias: Array
    bias_sigma: Array
    bias_chance: float
    bias_weight: float
    span: float
    hidden: tuple[str, ...]
    noise_limited: tuple[str, ...] = ()
    least_counts: tuple[float, ...] = ()
    by_counts: float = 0.0
    repetition: PeriodicResidual | None = None
    lateness: TimeDelay | None = None

    @property
    def steps_matter(self) -> bool:
        """Whether steps of the encoders are much of what the model leaves."""
        return self.by_counts > COARSE
