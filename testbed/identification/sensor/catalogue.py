"""All nuisances: those that can be estimated, and those that are only tested for."""

from __future__ import annotations

from testbed.identification.sensor.clock import CLOCK_RATE, SKEW
from testbed.identification.sensor.encoders import (
    ECCENTRICITY,
    ENCODER_DELAYS,
    ENCODER_GAINS,
    JOINT_ZEROS,
    SAMPLING,
)
from testbed.identification.sensor.nuisance import Nuisance
from testbed.identification.sensor.plate import (
    BIAS,
    CROSSTALK,
    GAINS,
    HEIGHT,
    MATRIX,
    POSE,
    SLOPE,
    TARE,
)

NUISANCES: tuple[Nuisance, ...] = (SKEW, BIAS, TARE, SLOPE, MATRIX, POSE, HEIGHT, JOINT_ZEROS)
"""Those that can be estimated, in the order in which they are taken back: last made, first."""

TESTED: tuple[Nuisance, ...] = (
    SKEW,
    CLOCK_RATE,
    SAMPLING,
    POSE,
    GAINS,
    CROSSTALK,
    JOINT_ZEROS,
    ENCODER_GAINS,
    ENCODER_DELAYS,
    ECCENTRICITY,
)
"""Those whose traces are looked for in every estimate. A drift is not: slow noise looks alike."""
