"""A plate's channels against what parameters of the robot can make of them, for a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.sanity.explanation import Explanation
from testbed.sanity.instants import directions


@dataclass(frozen=True, eq=False)
class ExplainedWrench:
    """A plate's channels at T instants.

    Attributes:
        time: (T,) [s].
        wrench: As it is read, (T, 6) [N, N m].
        fit: The nearest that base parameters and constants make, (T, 6) [N, N m].
        left: Part of each channel's variance that is not explained, (6,).
    """

    time: Array
    wrench: Array
    fit: Array
    left: Array


def explained_wrench(read: Explanation) -> ExplainedWrench | None:
    """The channels as a mapping reads them; None without a plate.

    Args:
        read: What the recording is without mistakes, or as it is.
    """
    reading, taken = read.reading, read.reading.taken
    if taken.wrench is None:
        return None
    count = len(taken.wrench)
    size = np.maximum(taken.wrench.std(axis=0), 1e-12)
    rows = reading.base @ reading.prior.told / size[:, None]
    columns = np.concatenate([rows, np.broadcast_to(np.eye(6), (count, 6, 6))], axis=2)
    basis = directions(columns.reshape(6 * count, -1))
    scaled = (taken.wrench / size).ravel()
    fit = (basis @ (basis.T @ scaled)).reshape(count, 6) * size
    left = ((taken.wrench - fit) ** 2).mean(axis=0) / size**2
    time = taken.spacing * np.arange(count, dtype=np.float64)
    return ExplainedWrench(time, taken.wrench, fit, left)
