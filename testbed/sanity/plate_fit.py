"""A plate's frame, clock and ratio of gains, refined, each with its standard deviation.

With a mapping that is right but for little, w = Y delta + b - sum x_e S_e w - late dw/dt + noise:
the turn, the shift of the moments' point, the ratio of moments to forces (S_e, `plate_map`) and the
delay enter linearly. Parameters and constants are projected out, channels weighed by what is left
of them, and w on the right-hand side is what the last step predicts, so that its noise biases
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.sanity.explanation import Explanation
from testbed.sanity.instants import directions
from testbed.sanity.plate_map import RATIO, SHIFT, SLOPES, TURN

WIDE = np.repeat([1.0, 0.2, 1.0], [3, 3, 2])
"""Standard deviations before the data: of the turn [rad], of the frame's place [m], of the ratio
and of the delay [s]."""

STEPS = 4
"""Of Gauss and Newton."""

PLACES = [*TURN, *SHIFT, RATIO]


@dataclass(frozen=True, eq=False)
class PlateFit:
    """What a mapping's plate must be moved by.

    Attributes:
        turn: Rotation vector, bedplate frame, (3,) [rad].
        shift: After it, (3,) [m].
        ratio: Moments are so much larger beside the forces, relative.
        late: The wrench is so late [s].
        turn_sigma: (3,) [rad].
        shift_sigma: (3,) [m].
        ratio_sigma: Of the ratio.
        late_sigma: Of the delay [s].
        covariance: Of the turn, (3, 3) [rad^2].
    """

    turn: Array
    shift: Array
    ratio: float
    late: float
    turn_sigma: Array
    shift_sigma: Array
    ratio_sigma: float
    late_sigma: float
    covariance: Array


def plate_fit(best: Explanation, place: Array) -> PlateFit:
    """What is left to correct of a plate's frame and gains.

    Args:
        best: What explains the recording, with a wrench and no mistakes about the plate.
        place: Where the mapping has the frame, (3,) [m]; a direction that the data do not tell goes
            to zero.
    """
    reading, taken = best.reading, best.reading.taken
    assert taken.wrench is not None
    assert taken.wrench_rate is not None
    wrench, rows, count = taken.wrench, reading.base @ reading.prior.told, len(taken.wrench)
    fixed = np.concatenate([rows, np.broadcast_to(np.eye(6), (count, 6, 6))], axis=2)
    before = np.zeros(len(WIDE))
    before[3:6] = -place  # where the prior has its mean
    weight = 1 / np.sqrt(np.maximum(best.left[-6:] * wrench.var(axis=0), 1e-30))
    predicted = wrench
    for _ in range(STEPS):
        own = directions((fixed * weight[:, None]).reshape(6 * count, -1))
        slopes = np.einsum("ecd,td->tce", SLOPES[PLACES], predicted)
        slopes = -np.concatenate([slopes, taken.wrench_rate[..., None]], axis=2) * weight[:, None]
        columns, target = slopes.reshape(6 * count, -1), (wrench * weight).ravel()
        columns, target = (each - own @ (own.T @ each) for each in (columns, target))
        normal = columns.T @ columns + np.diag(1 / WIDE**2)
        found = np.linalg.solve(normal, columns.T @ target + before / WIDE**2)
        left = (target - columns @ found).reshape(count, 6) / weight
        predicted = wrench - left
        free = count - (own.shape[1] + len(WIDE)) / 6
        weight = 1 / np.maximum(np.sqrt((left**2).sum(axis=0) / free), 1e-12)
    covariance = np.linalg.inv(normal)
    sigma = np.sqrt(np.diagonal(covariance))
    return PlateFit(
        found[:3], found[3:6], float(found[6]), float(found[7]), sigma[:3], sigma[3:6],
        float(sigma[6]), float(sigma[7]), covariance[:3, :3],
    )  # fmt: skip
