"""Tables of validations: no number is cut, at any width."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from testbed.identification.validate import Validation
from testbed.reporting.validation_tables import validation_tables

LONG = "the_third_joint_of_the_left_index_finger_of_a_humanoid"


def made(names: tuple[str, ...]) -> Validation:
    """With numbers that are as long as they can be, and with none."""
    sizes = -1.23456e-101 * np.ones(len(names))
    sizes[-1] = np.nan
    return Validation(
        method="internal",
        channels=names,
        units=tuple("N m" for _ in names),
        rows=tuple(12_345_678 for _ in names),
        signal=-sizes,
        residual=-sizes,
        mean=sizes,
        noise=-sizes,
        spread=-sizes,
    )


@pytest.mark.parametrize("width", range(60, 141, 10))
@pytest.mark.parametrize("names", [("elbow", "wrist"), (LONG, "wrist")])
def test_no_number_is_cut(width: int, names: tuple[str, ...]) -> None:
    found = made(names)
    out = Console(width=width, file=io.StringIO())
    for table in validation_tables(out, found):
        out.print(table)
    assert isinstance(out.file, io.StringIO)
    text = out.file.getvalue()
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    assert text.count("1.23e-101") == 4
    assert text.count("-1.23e-101") == 1
    assert text.count("100 %") == 1
    assert text.count("12345678") == 2
    assert "nan" not in text
    letters = "".join(text.split())
    assert all(name in letters or name[:12] in letters for name in names)


def test_what_fits_stands_in_one_table() -> None:
    assert len(validation_tables(Console(width=120), made(("Fx", "Fy")))) == 1
    assert len(validation_tables(Console(width=60), made(("Fx", "Fy")))) == 2
