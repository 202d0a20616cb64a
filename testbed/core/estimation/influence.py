"""How much each parameter adds to the signals: the order in which parameters are shown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import TINY


def influence(estimate: Estimate, truths: Mapping[str, float]) -> Array:
    """Rms of each column times its value over the rms of the signals, (p,); of units the largest.

    Args:
        estimate: Of one method.
        truths: True values by name, which count in place of the estimate's.
    """
    equations, units = estimate.normal_equations, np.array(estimate.channel_units)
    squares = np.array(
        [np.diagonal(equations.of_channel(c)[0]) for c in range(len(units))]
    )
    values = np.array(
        [
            truths.get(n, v)
            for n, v in zip(estimate.names, estimate.values.tolist(), strict=True)
        ]
    )
    shares = []
    for unit in dict.fromkeys(estimate.channel_units):
        same = units == unit
        size = max(float(equations.squares[same].sum()), TINY)
        # of a column of zeros by rounding
        square = np.maximum(squares[same].sum(axis=0), 0.0)
        shares.append(np.sqrt(square / size))
    return np.asarray(np.abs(values) * np.max(shares, axis=0))


def by_influence(
    estimates: Iterable[Estimate], truths: Mapping[str, float]
) -> list[str]:
    """Names of all parameters, that which adds most to any signal first.

    Args:
        estimates: Of one robot, one a method.
        truths: True values by name; {} where they are not known.
    """
    most: dict[str, float] = {}
    for estimate in estimates:
        for name, share in zip(
            estimate.names, influence(estimate, truths).tolist(), strict=True
        ):
            most[name] = max(share, most.get(name, 0.0))
    return sorted(most, key=lambda name: -most[name])
