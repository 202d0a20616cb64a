"""Laws among which held-out data choose: what every joint has, and what may be added."""

from __future__ import annotations

import numpy as np

from testbed.errors import round_significant
from testbed.robot.friction import (
    ASYMMETRIC,
    COULOMB,
    OFFSET,
    QUADRATIC,
    SQUARE_ROOT,
    STRIBECK,
    VISCOUS,
    JointLaw,
    stribeck,
)

ALWAYS = (COULOMB, VISCOUS)
"""What every joint has."""

SPEEDS = tuple(round_significant(speed, 2) for speed in np.geomspace(0.02, 1.0, 14))
"""At which friction may fade out [rad/s or m/s]."""

OFFERED = (OFFSET, ASYMMETRIC, QUADRATIC, SQUARE_ROOT, *(stribeck(speed) for speed in SPEEDS))
"""What may be added."""


def rivals(one: JointLaw, other: JointLaw) -> bool:
    """Whether two laws are not to be chosen both: friction that fades out at two speeds.

    Args:
        one: A law.
        other: Another.
    """
    return all(law.kind.startswith(STRIBECK) for law in (one, other))
