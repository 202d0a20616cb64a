"""Signals filtered and thinned out."""

from __future__ import annotations

from testbed.arrays import Array


def thinned(signal: Array, weights: Array, reach: int, step: int) -> Array:
    """A signal filtered, without `reach` samples at either end, every so many samples.

    Args:
        signal: (M, k).
        weights: Of the filter, reversed in time, (2 L + 1,), L at most `reach`.
        reach: Samples lost at either end.
        step: Samples from one to the next that is kept.
    """
    from scipy.signal import oaconvolve

    spare = reach - len(weights) // 2
    found = oaconvolve(signal, weights[:, None], mode="valid", axes=0)
    kept: Array = found[spare : len(found) - spare or None : step]
    return kept
