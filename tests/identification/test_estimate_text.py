"""An estimate printed, in a notebook, as a dictionary, as a data frame."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

import testbed as tb
from testbed.errors import TestbedError
from testbed.identification.estimate import METHODS, Estimate, Method
from testbed.identification.estimate_text import number_with_sigma
from tests.helpers.ideal import ideal
from tests.helpers.runs import noisy, robot


def estimate_of(name: str, method: Method) -> Estimate:
    tree = robot(name)
    return tb.identify(tree, noisy(ideal(tree)), method)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry", "random"])
@pytest.mark.parametrize("method", METHODS)
def test_every_parameter_is_a_line(name: str, method: Method) -> None:
    found = replace(estimate_of(name, method), warnings=("<b>mind</b> this",))
    lines = str(found).splitlines()
    assert len(lines) == 1 + len(found.names) + 1
    for k, line in enumerate(lines[1:-1]):
        assert line.startswith(found.names[k])
        assert number_with_sigma(float(found.values[k]), float(found.sigma[k])) in line
        assert line.rstrip().endswith(found.units[k])
    assert lines[-1] == "warning: <b>mind</b> this"
    page = found._repr_html_()
    assert page.count("<tr>") == len(found.names)
    assert "&lt;b&gt;mind" in page
    assert "+-" not in page


def test_numbers_by_name() -> None:
    found = estimate_of("puma", "external")
    said = found.to_dict()
    assert list(said) == list(found.names)
    assert [each["value"] for each in said.values()] == found.values.tolist()
    assert said["mbar1"]["unit"] == "kg"


def test_a_data_frame_of_what_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither package is needed: what would be called is seen."""
    found = estimate_of("puma", "external")
    for package in ("pandas", "polars"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(TestbedError, match="pip install pandas"):
        found.to_frame()
    polars = ModuleType("polars")
    polars.DataFrame = dict  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "polars", polars)
    frame = found.to_frame()
    assert list(frame) == ["name", "value", "sigma", "unit"]
    np.testing.assert_array_equal(frame["sigma"], found.sigma)
