"""Constants and trends of the plate's channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.identification.sensor.nuisance import Nuisance, Numbers, Part, always
from testbed.identification.sensor.predicted_wrench import PredictedWrench
from testbed.recordings.columns import AXES, PLATE_UNITS
from testbed.recordings.recording import Recording


def _constant(predicted: PredictedWrench) -> Array:
    return np.broadcast_to(np.eye(6), (len(predicted.time), 6, 6))


def _trend(predicted: PredictedWrench) -> Array:
    return np.asarray(predicted.time[:, None, None] * np.eye(6))


def _without_constant(recording: Recording, values: Array, time: Array) -> Recording:
    del time
    return replace(recording, wrench=recording.measured("wrench") - values)


def _without_trend(recording: Recording, values: Array, time: Array) -> Recording:
    return replace(recording, wrench=recording.measured("wrench") - time[:, None] * values)


def _channels(kind: str, per: str = "") -> Numbers:
    units = zip(AXES, PLATE_UNITS, strict=True)
    return always(*(Part(f"{kind}/{axis}", f"{unit}{per}") for axis, unit in units))


BIAS = Nuisance(
    "bias",
    _channels("bias"),
    _constant,
    _without_constant,
    passing=True,
    added=True,
)

SLOPE = Nuisance(
    "slope",
    _channels("slope", "/s"),
    _trend,
    _without_trend,
    passing=True,
    added=True,
)
"""From the middle of the recording."""

TARE = Nuisance("tare", _channels("tare"), _constant, _without_constant, added=True)
"""What the plate shows of the pedestal beyond the tare: to a fixed plate the same as a bias."""
