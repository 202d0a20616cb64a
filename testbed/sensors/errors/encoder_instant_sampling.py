"""Encoders that are sampled instantaneously instead of averaged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class EncoderInstantSampling(SensorError):
    """Positions at the first instant of each sample; other signals are means.

    The counter of a controller latches positions in this way. Compared with an averaging plate,
    positions are half a sampling time early. The computation is exact for smooth motions
    (`values_at_first_instants`).

    Source    Operating principle of counters; the error has no size.
    """

    kind: ClassVar[str] = "encoder_instant_sampling"
    signal: ClassVar[Signal] = "position"
    stage: ClassVar[StageOrder] = StageOrder.CLOCK

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Positions at the first instants, (M, n) [rad or m], from means over the samples."""
        del rng
        return values_at_first_instants(signal, time)


def values_at_first_instants(means: Array, time: Array) -> Array:
    """Signal at the first instant of each sample, from its means over the samples.

    The cumulative sum of the means is the exact integral of the signal at the boundaries of the
    samples. A spline through this sum is differentiated.

    Args:
        means: Means over the samples, (M, k).
        time: First instants of the samples, uniform, (M,) [s].
    """
    from scipy.interpolate import make_interp_spline

    step = (time[-1] - time[0]) / (len(time) - 1)
    mean = means.mean(axis=0)
    edges = np.append(time, time[-1] + step)
    sums = np.cumsum(np.vstack([np.zeros_like(mean), means - mean]), axis=0) * step
    spline = make_interp_spline(edges, sums, k=min(5, len(time)))
    result: Array = spline.derivative()(time) + mean
    return result
