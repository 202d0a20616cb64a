"""What an estimate's residuals are like."""

from __future__ import annotations

from dataclasses import dataclass

from testbed.arrays import Array
from testbed.identification.noise.repetition import Repetition


@dataclass(frozen=True, eq=False)
class FoundNoise:
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
        drowned: Parameters whose columns are in large part noise of the encoders, alone or
            together: sigma does not hold for them.
        repetition: Whether the residuals repeat with the motion; None where that cannot be told.
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
    drowned: tuple[str, ...] = ()
    repetition: Repetition | None = None
