"""Points of a campaign: levels of its factors, crossed and sampled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from testbed.arrays import Array


@dataclass(frozen=True)
class Choice:
    """One level of one factor.

    Attributes:
        factor: Its number.
        level: A number, or a name.
        words: What it changes, as `--set` takes it.
    """

    factor: int
    level: float | str
    words: tuple[str, ...]


@dataclass(frozen=True)
class Cell:
    """One combination of levels.

    Attributes:
        levels: Of every factor, in the order of the file.
        words: What they change, as `--set` takes it.
    """

    levels: tuple[float | str, ...]
    words: tuple[str, ...]


def cells_of(
    crossed: Sequence[Sequence[Choice]], points: Sequence[Sequence[Choice]]
) -> tuple[Cell, ...]:
    """All combinations of the crossed factors, each with every point of the sampled ones.

    Args:
        crossed: Levels of each factor that has all of them.
        points: Levels of all sampled factors together, by point; [] for none.
    """
    found = []
    for chosen in product(*crossed):
        for point in points or [()]:
            every = sorted((*chosen, *point), key=lambda choice: choice.factor)
            words = tuple(word for choice in every for word in choice.words)
            found.append(Cell(tuple(choice.level for choice in every), words))
    return tuple(found)


def sampled(
    method: str, spans: Sequence[tuple[float, float, bool]], points: int, seed: int
) -> Array:
    """Points in a box, (points, factors).

    Args:
        method: "random", "latin_hypercube" or "sobol".
        spans: Least and greatest level of each factor, and whether even in the logarithm.
        points: How many.
        seed: Of the points.
    """
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    if method == "random":
        unit = rng.random((points, len(spans)))
    elif method == "latin_hypercube":
        unit = qmc.LatinHypercube(len(spans), rng=rng).random(points)
    else:
        power = max(points - 1, 0).bit_length()  # whole powers of two keep the balance
        unit = qmc.Sobol(len(spans), rng=rng).random_base2(power)[:points]
    found = np.empty_like(unit)
    for k, (low, high, log) in enumerate(spans):
        part = unit[:, k]
        found[:, k] = low * (high / low) ** part if log else low + (high - low) * part
    return found
