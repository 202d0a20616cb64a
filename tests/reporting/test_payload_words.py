"""What is told of a payload, in words, whether all of it is or some."""

from __future__ import annotations

import numpy as np

from testbed.identification.payload import PayloadEstimate
from testbed.reporting.payload_table import payload_lines, payload_table

NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def payload(told: int) -> PayloadEstimate:
    """Of which the first so many are told."""
    known = np.arange(10) < told
    sigma = np.where(known, 0.01, np.inf)
    return PayloadEstimate(
        "elbow", NAMES, ("kg",) * 10, tuple(known.tolist()), np.arange(1.0, 11.0), sigma,
        np.eye(10), told + 1, 0.5,
    )  # fmt: skip


def test_what_is_told_is_counted() -> None:
    assert payload_lines(payload(10))[0] == "All ten are told."
    assert payload_lines(payload(3))[0] == "3 are told alone, and 4 combinations in all."


def test_what_is_not_told_has_no_number() -> None:
    cells = list(payload_table(payload(3)).columns[1].cells)
    assert [cell == "not told alone" for cell in cells] == 3 * [False] + 7 * [True]


def test_every_parameter_has_its_unit() -> None:
    columns = payload_table(payload(10)).columns
    assert [str(column.header) for column in columns] == ["", "value", "unit"]
    assert list(columns[0].cells) == list(NAMES)
    assert set(columns[2].cells) == {"kg"}
