"""Signals at other instants than those of their samples."""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array

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


def at_times(signal: Array, time: Array, wanted: Array) -> Array:
    """A signal at other instants; before the first and after the last sample it is held.

    Args:
        signal: (M, k).
        time: Of its samples, (M,) [s].
        wanted: (L,) [s].
    """
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(time, signal, k=min(5, len(time) - 1))
    found: Array = spline(np.clip(wanted, time[0], time[-1]))
    return found
