"""Cells from light to dark."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.reporting.heat_table import DARKEST, heat_table


def shares(values: list[float], least: float, most: float) -> list[int]:
    table = heat_table("", ["row"], [str(k) for k in range(len(values))], [values], least, most)
    ((_, cells),) = table["rows"]
    return [cell["share"] for cell in cells]


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e4])
def test_darkness_goes_with_the_logarithm_between_its_ends(scale: float) -> None:
    values = scale * np.array([0.01, 0.1, 1.0, 10.0, 100.0, 1e6, 1e-9])
    wanted = [0, DARKEST / 4, DARKEST / 2, 3 * DARKEST / 4, DARKEST, DARKEST, 0]
    found = shares(values.tolist(), values[0], values[4])
    assert found == [round(part) for part in wanted]


def test_what_is_not_there_has_neither_text_nor_colour() -> None:
    table = heat_table("all", ["a"], ["b", "c"], [[float("nan"), 0.0123]], 0.01, 0.02)
    assert table["caption"] == "all"
    ((name, (nothing, something)),) = table["rows"]
    assert (name, nothing) == ("a", {"text": "", "share": 0})
    assert something["text"] == "1.2"
