"""Encoders that are sampled at instants."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import SensorError, Signal, StageOrder


@dataclass(frozen=True)
class EncoderInstantSampling(SensorError):
    """Positions at the first instant of each sample, while all else is the mean over it.

    What a controller's counter does: it latches. Against a plate that averages, positions are
    half a sampling time early. Exact for smooth motions (`first_instants`).

    Source    How counters work; no size.
    """

    kind: ClassVar[str] = "encoder_instant_sampling"
    signal: ClassVar[Signal] = "position"
    stage: ClassVar[StageOrder] = StageOrder.CLOCK

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Positions at instants, (M, n) [rad or m], of means over samples."""
        del rng
        return first_instants(signal, time)


def first_instants(means: Array, time: Array) -> Array:
    """A signal at the first instant of each sample, from its means over the samples.

    The means' sum is the signal's integral at the samples' edges, exactly; the spline through
    it is differentiated there.

    Args:
        means: (M, k).
        time: Of the samples' first instants, uniform, (M,) [s].
    """
    from scipy.interpolate import make_interp_spline

    step = (time[-1] - time[0]) / (len(time) - 1)
    middle = means.mean(axis=0)
    edges = np.append(time, time[-1] + step)
    sums = np.cumsum(np.vstack([np.zeros_like(middle), means - middle]), axis=0) * step
    spline = make_interp_spline(edges, sums, k=min(5, len(time)))
    found: Array = spline.derivative()(time) + middle
    return found
