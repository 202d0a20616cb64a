"""What is looked at of a recording does not depend on the windows in which it comes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from testbed.arrays import Array
from testbed.identification.survey import SAMPLES, Surveyor
from testbed.kernel.records import Signals


def given(position: Array, measured: Array) -> Signals:
    """With nothing but what is looked at."""
    none = np.zeros(0)
    return Signals(position, none, none, measured, none, none, 0.0, 0, 0, 1, len(position))


def test_samples_are_evenly_spread_whatever_the_windows() -> None:
    """Every third, fourth, seventh of all, where windows begin at no multiple of these."""
    rng = np.random.default_rng(5)
    for stride in (1, 3, 4, 7):
        samples = stride * SAMPLES + stride - 1
        position, measured = rng.standard_normal((samples, 2)), rng.standard_normal((samples, 3))
        cuts = [0, *np.sort(rng.choice(np.arange(1, samples), 12, replace=False)).tolist(), samples]
        surveyor = Surveyor(samples)
        for first, last in pairwise(cuts):
            seen = slice(first, min(last + 20, samples))  # windows overlap
            surveyor.look(given(position[seen], measured[seen]), first, last - first)
        found = surveyor.survey()
        np.testing.assert_array_equal(found.position, position[::stride])
        np.testing.assert_array_equal(found.measured, measured[::stride])
