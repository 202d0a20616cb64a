"""What is written down as the tare: the pedestal's known weight, or what the plate shows of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.arrays import Array
from testbed.errors import SettingsError
from testbed.instruments.fault import Fault, Place, Signal
from testbed.keys import key

_MOST_SAMPLES = 1e6
"""Of a tare: they are held in memory."""


@dataclass(frozen=True)
class MeasuredTare(Fault):
    """A tare that is measured, not known: the mean of the plate at rest without the robot.

    The plate has the faults that it has in the recording (the same bias, the same crosstalk)
    and other noise. Its zero drifts and wanders in between.

    Source    Practice: five seconds, a minute before the robot is mounted and moves.

    Attributes:
        seconds: How long it is measured [s].
        before: How long before the recording that ends [s].
    """

    kind: ClassVar[str] = "measured_tare"
    signal: ClassVar[Signal] = "tare"
    place: ClassVar[Place] = Place.LINE
    seconds: float = key(5.0, positive=True)
    before: float = key(60.0, least=0)

    def check_rate(self, rate: float) -> None:
        """Whether its samples have room."""
        if self.seconds * rate > _MOST_SAMPLES:
            raise SettingsError(
                f"{self.kind}: {self.seconds:g} s at {rate:g} Hz are more than {_MOST_SAMPLES:.0e} "
                "samples; measure for a shorter time"
            )

    def instants(self, rate: float) -> Array:
        """When it is measured, with the recording's first sample at 0 [s].

        Args:
            rate: Samples a second [Hz].
        """
        samples = max(2, round(self.seconds * rate))
        return (np.arange(samples) - samples) / rate - self.before

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The mean, in every row, of what the plate shows at rest, (M, 6) [N, N m]."""
        del time, rng
        mean: Array = np.broadcast_to(signal.mean(axis=0), signal.shape)
        return mean


FAULTS: tuple[type[Fault], ...] = (MeasuredTare,)
"""All of the tare."""
