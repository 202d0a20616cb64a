"""Mains hum in the plate's channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import RANDOM_PHASE, PerAxis, PerChannel
from testbed.sensors.sensor_error import AddedWrench


@dataclass(frozen=True)
class PlateHum(AddedWrench):
    """Mains hum: a sine wave in every channel, with different phases.

    Source    50 Hz is the mains frequency in Europe and most of Asia and Africa (60 Hz in
        America); the amplitude is equal to the bias.

    Attributes:
        force: Amplitude of the forces [N].
        moment: Amplitude of the moments [N m].
        frequency: Frequency of the mains [Hz].
        phase: Phase at time 0; drawn at random if omitted [rad].
    """

    kind: ClassVar[str] = "plate_hum"
    force: PerAxis = 2.0
    moment: PerAxis = 0.5
    frequency: Annotated[float, Gt(0)] = 50.0
    phase: Annotated[PerChannel | None, RANDOM_PHASE] = None

    def pattern(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Sine wave of unit amplitude at the mains frequency, (M, 6)."""
        del signal, rng
        angle = 2 * np.pi * self.frequency * time[:, None] + np.asarray(
            self.phase or 0.0
        )
        return np.asarray(np.sin(angle))
