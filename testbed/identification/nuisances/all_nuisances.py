"""All nuisances: those that can be estimated, and those that are only tested for."""

from __future__ import annotations

from testbed.identification.nuisances.clock import CLOCK_RATE, SKEW
from testbed.identification.nuisances.encoder_errors import (
    ECCENTRICITY,
    ENCODER_DELAYS,
    ENCODER_GAINS,
    JOINT_ZEROS,
    SAMPLING,
)
from testbed.identification.nuisances.matrix import MATRIX
from testbed.identification.nuisances.nuisance import Nuisance
from testbed.identification.nuisances.offsets import BIAS, SLOPE, TARE
from testbed.identification.nuisances.pose import HEIGHT, POSE
from testbed.identification.nuisances.sensitivities import CROSSTALK, GAINS

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
