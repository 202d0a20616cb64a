"""Channels of the plate on wrong scales, or that show some of the others' loads."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.identification.sensor.nuisance import Nuisance, Part, always
from testbed.identification.sensor.predicted_wrench import PredictedWrench
from testbed.recordings.columns import AXES

_PAIRS = [(shown, felt) for shown in range(6) for felt in range(6) if shown != felt]


_of_channels = always(*(Part(f"gains/{axis}", "") for axis in AXES))

_of_pairs = always(*(Part(f"crosstalk/{AXES[s]}/{AXES[f]}", "") for s, f in _PAIRS))


def _own(predicted: PredictedWrench) -> Array:
    return predicted.rows(predicted.wrench[:, :, None] * np.eye(6))


def _others(predicted: PredictedWrench) -> Array:
    filtered = predicted.rows(predicted.wrench[:, :, None])[..., 0]
    found = np.zeros((len(filtered), 6, len(_PAIRS)))
    for k, (shown, felt) in enumerate(_PAIRS):
        found[:, shown, k] = filtered[:, felt]
    return found


GAINS = Nuisance("gains", _of_channels, _own)
"""Relative."""

CROSSTALK = Nuisance(
    "crosstalk",
    _of_pairs,
    _others,
    covers=("pose",),
)
"""What a channel shows of another's load; a plate that is turned or shifted does that, too."""
