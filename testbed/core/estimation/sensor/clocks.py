"""Clocks of plate and encoders: delays, and rates that differ."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.sensor.estimates import Nuisance, Part, always, of_wrench
from testbed.core.estimation.sensor.predicted_wrench import PredictedWrench

_POINTS = 8
"""Samples that an interpolated one is made of: exact for polynomials below that degree."""


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


def _late(predicted: PredictedWrench) -> Array:
    return -predicted.rates(predicted.moving[..., None])


def _hurried(predicted: PredictedWrench) -> Array:
    each = [
        predicted.along(j, lambda q, qd, qdd: (0.0, qd, 2 * qdd)) for j in range(predicted.tree.n)
    ]
    return predicted.rows(-np.sum(each, axis=0)[..., None])


CLOCKS = (
    # by how much the plate is late
    Nuisance(
        "skew",
        always(Part("skew", "s")),
        _late,
        of_wrench(
            lambda wrench, values, time: shifted(
                wrench, float(values[0]) * (len(time) - 1) / float(time[-1] - time[0])
            )
        ),
        by_measured=lambda predicted: -predicted.shown_rate[..., None],
        tested=True,
    ),
    # by how much the plate gets later, relative to time
    Nuisance(
        "clock_rate",
        always(Part("clock_rate", "")),
        lambda predicted: _late(predicted) * predicted.time[:, None, None],
        tested=True,
    ),
    # by how much more time passes between samples than their stamps say, relative
    Nuisance("sampling", always(Part("sampling", "")), _hurried, of_encoders=True, tested=True),
)
"""Errors of clocks."""
