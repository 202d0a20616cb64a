"""An estimate printed, in a notebook, as a dictionary, as a data frame: the same numbers."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from testbed.errors import TestbedError
from testbed.identification.estimate_text import number_with_sigma
from tests.helpers.refusals import refuses
from tests.scenarios.scenarios import result


def test_every_form_holds_every_parameter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Warnings too, and safely; data frames by whichever package is there."""
    found = replace(result("gantry").estimates["internal"], warnings=("<b>mind</b> this",))
    lines = str(found).splitlines()
    for name, value, sigma, unit, line in zip(
        found.names, found.values, found.sigma, found.units, lines[1:-1], strict=True
    ):
        words = (name, number_with_sigma(float(value), float(sigma)), unit)
        assert [part for part in words if part not in line] == []
    assert "<b>mind</b> this" in lines[-1]
    page = found._repr_html_()
    assert page.count("<tr>") == len(found.names)
    assert "&lt;b&gt;mind" in page
    said = found.to_dict()
    assert {name: each["value"] for name, each in said.items()} == dict(
        zip(found.names, found.values.tolist(), strict=True)
    )
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setitem(sys.modules, "polars", None)
    with refuses(TestbedError, "pandas"):
        found.to_frame()
    polars = ModuleType("polars")
    polars.DataFrame = dict  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "polars", polars)
    np.testing.assert_array_equal(found.to_frame()["sigma"], found.sigma)


def test_a_number_has_the_digits_that_its_sigma_has_to_say() -> None:
    for value, sigma, wanted, short in (
        (1.06104, 0.00094, "1.06104 +- 0.00094", "1.06104(94)"),
        (-123.456, 12.0, "-123.5 +- 12.0", "-123.5(12.0)"),
        (5.0, 1.0, "5.0 +- 1.0", "5.0(1.0)"),
        (1.0, 1e-12, "1 +- 1e-12", "1 +- 1e-12"),
        (2.5, 0.0, "2.5", "2.5"),
        (1e-17, 1e-18, "0", "0"),
    ):
        assert (number_with_sigma(value, sigma), number_with_sigma(value, sigma, True)) == (
            wanted,
            short,
        )
    assert not any(digit in number_with_sigma(3.0, np.inf) for digit in "0123456789")
