"""Points: crossed factors are all there once, sampled ones fill their ranges evenly."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from testbed.campaign.points import Choice, cells_of, sampled

SPANS = [(0.5, 2.5, False), (1e-2, 1e2, True), (-3.0, -1.0, False)]


def unit(points: np.ndarray) -> np.ndarray:
    """Points back in the unit cube."""
    found = np.empty_like(points)
    for k, (low, high, log) in enumerate(SPANS):
        x, a, b = (np.log(v) if log else v for v in (points[:, k], low, high))
        found[:, k] = (x - a) / (b - a)
    return found


@pytest.mark.parametrize("method", ["random", "latin_hypercube", "sobol"])
def test_points_stay_in_their_ranges_and_a_seed_makes_the_same(method: str) -> None:
    points = sampled(method, SPANS, 64, 7)
    assert points.shape == (64, 3)
    assert ((unit(points) >= 0) & (unit(points) <= 1)).all()
    np.testing.assert_array_equal(points, sampled(method, SPANS, 64, 7))
    assert (points != sampled(method, SPANS, 64, 8)).any()


@pytest.mark.parametrize("method", ["latin_hypercube", "sobol"])
def test_every_slice_of_every_range_has_one_point(method: str) -> None:
    slices = np.floor(64 * unit(sampled(method, SPANS, 64, 3))).astype(int)
    for column in slices.T:
        assert sorted(column) == list(range(64))


def test_sobol_points_fill_every_quarter_alike() -> None:
    quarters = np.floor(4 * unit(sampled("sobol", SPANS, 64, 1))[:, :2]).astype(int)
    counts = np.zeros((4, 4))
    np.add.at(counts, (quarters[:, 0], quarters[:, 1]), 1)
    assert (counts == 4).all()


def test_crossed_factors_meet_every_point_once_in_the_order_of_the_file() -> None:
    a = [Choice(0, x, (f"a={x}",)) for x in (1.0, 2.0)]
    c = [Choice(2, x, (f"c={x}",)) for x in ("u", "v", "w")]
    points = [[Choice(1, y, (f"b={y}",)), Choice(3, -y, (f"d={-y}",))] for y in (0.1, 0.2)]
    cells = cells_of([a, c], points)
    wanted = {(x, y, z, -y) for x, z, y in product((1.0, 2.0), "uvw", (0.1, 0.2))}
    assert {cell.levels for cell in cells} == wanted
    assert len(cells) == len(wanted)
    for cell in cells:
        x, y, z, w = cell.levels
        assert cell.words == (f"a={x}", f"b={y}", f"c={z}", f"d={w}")
    assert cells_of([], []) == cells_of([], [[]])
