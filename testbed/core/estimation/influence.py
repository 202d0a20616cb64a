"""Influence of each parameter on the measured signals, used to sort the parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE


def influence(estimate: Estimate, truths: Mapping[str, float]) -> Array:
    """Rms contribution of each parameter, relative to the rms of the signals, (p,).

    A contribution is the parameter's value times its column. Channels in N and in N m are compared
    separately, and the larger ratio is returned.

    Args:
        estimate: Estimate by one method.
        truths: True values by name, used in place of the estimated values.
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
    relative_sizes = []
    for unit in dict.fromkeys(estimate.channel_units):
        in_unit = units == unit
        signal_square = max(float(equations.squares[in_unit].sum()), SMALLEST_POSITIVE)
        # rounding makes the square of a zero column negative
        column_squares = np.maximum(squares[in_unit].sum(axis=0), 0.0)
        relative_sizes.append(np.sqrt(column_squares / signal_square))
    return np.asarray(np.abs(values) * np.max(relative_sizes, axis=0))


def names_by_influence(
    estimates: Iterable[Estimate], truths: Mapping[str, float]
) -> list[str]:
    """Names of all parameters, sorted by decreasing influence on the signals.

    The influence of a parameter in several estimates is the largest of its influences.

    Args:
        estimates: Estimates of one robot, one per method.
        truths: True values by name; {} if unknown.
    """
    largest: dict[str, float] = {}
    for estimate in estimates:
        for name, share in zip(
            estimate.names, influence(estimate, truths).tolist(), strict=True
        ):
            largest[name] = max(share, largest.get(name, 0.0))
    return sorted(largest, key=lambda name: -largest[name])
