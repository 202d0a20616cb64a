"""Signals at other instants than their samples', by splines of fifth degree.

For content of frequency f sampled at a rate r the error is about (f / r)^6: rounding, for all
that a robot's motion holds at a thousand samples a second.
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array

_DEGREE = 5


def at_times(signal: Array, time: Array, wanted: Array) -> Array:
    """A signal at other instants; before the first and after the last sample it is held.

    Args:
        signal: (M, k).
        time: Of its samples, (M,) [s].
        wanted: (L,) [s].
    """
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(time, signal, k=min(_DEGREE, len(time) - 1))
    found: Array = spline(np.clip(wanted, time[0], time[-1]))
    return found


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
    spline = make_interp_spline(edges, sums, k=min(_DEGREE, len(time)))
    found: Array = spline.derivative()(time) + middle
    return found
