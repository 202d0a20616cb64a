"""A plate whose clock is not the encoders'."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.identification.sensor.nuisance import Nuisance, Part, always
from testbed.identification.sensor.predicted_wrench import PredictedWrench
from testbed.recordings.recording import Recording

_POINTS = 8
"""Samples that an interpolated one is made of: exact for polynomials below that degree."""


def _late(predicted: PredictedWrench) -> Array:
    return -predicted.rates(predicted.moving[..., None])


def _late_as_measured(predicted: PredictedWrench) -> Array:
    return -predicted.shown_rate[..., None]


def _earlier(recording: Recording, values: Array, time: Array) -> Recording:
    late = float(values[0]) * (len(time) - 1) / float(time[-1] - time[0])
    return replace(recording, wrench=shifted(recording.measured("wrench"), late))


def shifted(signal: Array, samples: float) -> Array:
    """A signal read so many samples later, by Lagrange's interpolation between neighbours.

    Args:
        signal: (M, k); beyond its ends it is held.
        samples: How many, of either sign; need not be whole.
    """
    whole = int(np.floor(samples))
    nodes = np.arange(_POINTS) - (_POINTS // 2 - 1)
    gaps = (samples - whole) - nodes
    weights = np.array(
        [
            np.prod(np.delete(gaps, k)) / np.prod(np.delete(node - nodes, k))
            for k, node in enumerate(nodes)
        ]
    )
    at = np.arange(len(signal))
    found = np.zeros_like(signal)
    for node, weight in zip(nodes, weights, strict=True):
        found += weight * signal[np.clip(at + whole + node, 0, len(signal) - 1)]
    return found


def reach(delay: float, rate: float) -> int:
    """Samples at either end that are not what they should be once a delay is taken back.

    Args:
        delay: [s].
        rate: Samples a second [Hz].
    """
    return int(np.ceil(abs(delay) * rate)) + _POINTS // 2 if delay else 0


def _faster(predicted: PredictedWrench) -> Array:
    return _late(predicted) * predicted.time[:, None, None]


SKEW = Nuisance(
    "skew",
    always(Part("skew", "s")),
    _late,
    _earlier,
    by_measured=_late_as_measured,
)
"""By how much the plate is late."""

CLOCK_RATE = Nuisance(
    "clock_rate",
    always(Part("clock_rate", "")),
    _faster,
)
"""By how much the plate gets later, relative to time."""
