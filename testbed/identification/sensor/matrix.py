"""All 36 sensitivities of the plate: what each channel shows of each component of the wrench.

The plate shows C w of the wrench w of robot and pedestal. A plate that is turned or shifted
is one such C, too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.identification.sensor.nuisance import Nuisance, Part, always
from testbed.identification.sensor.predicted_wrench import PredictedWrench
from testbed.recordings.columns import AXES
from testbed.recordings.recording import Recording

_UNITS = {("F", "M"): "1/m", ("M", "F"): "m"}


def _part(shown: str, felt: str) -> Part:
    if shown == felt:
        return Part(f"gain/{shown}", "", 1.0)
    return Part(f"crosstalk/{shown}/{felt}", _UNITS.get((shown[0], felt[0]), ""))


SENSITIVITIES = tuple(_part(shown, felt) for shown in AXES for felt in AXES)
"""Row by row: `gain/Fz` is what the plate shows of a force Fz there, `crosstalk/Fx/Fz` what Fx
shows of it."""


def _columns(predicted: PredictedWrench) -> Array:
    filtered = predicted.rows(predicted.wrench[:, :, None])[..., 0]
    found = np.zeros((len(filtered), 6, 36))
    for shown in range(6):
        found[:, shown, 6 * shown : 6 * shown + 6] = filtered
    return found


def _felt(recording: Recording, values: Array, time: Array) -> Recording:
    del time
    return replace(recording, wrench=recording.measured("wrench") @ _unmixed(values).T)


def _unmixed(values: Array) -> Array:
    return np.asarray(np.linalg.inv(values.reshape(6, 6)))


MATRIX = Nuisance(
    "matrix",
    always(*SENSITIVITIES),
    _columns,
    _felt,
    covers=("gains", "crosstalk", "pose", "height"),
    whole=True,
    added=True,
    unmixed=_unmixed,
)
