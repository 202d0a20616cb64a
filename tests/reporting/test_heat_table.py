"""Cells from light to dark."""

from __future__ import annotations

import re
from importlib.resources import files

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


def test_what_stands_in_the_darkest_cell_can_be_read() -> None:
    """A contrast of 4.5 to 1, in the light and in the dark [WCAG 2.1, 1.4.3]."""
    style = (files("testbed.reporting") / "page/style.css").read_text()
    light, dark = style.split("@media (prefers-color-scheme: dark)")[:2]
    for part in (light, dark):
        ink, paper, colour = (
            np.array([int(digits[k : k + len(digits) // 3].ljust(2, digits[k]), 16) / 255
                      for k in range(0, len(digits), len(digits) // 3)])
            for digits in (
                re.findall(rf"--{name}: #(\w+)", part)[0] for name in ("ink", "paper", "external")
            )
        )  # fmt: skip
        ground = DARKEST / 100 * colour + (1 - DARKEST / 100) * paper
        bright = [
            np.where(c <= 0.03928, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
            @ (0.2126, 0.7152, 0.0722)
            for c in (ink, ground)
        ]
        assert (max(bright) + 0.05) / (min(bright) + 0.05) >= 4.5
