"""Lines beside the tables of results."""

from __future__ import annotations

from dataclasses import replace

import pytest

import testbed as tb
from testbed.identification.estimate import METHODS
from testbed.reporting.tables import quality_lines
from tests.helpers.measured import measured


@pytest.mark.slow
def test_a_line_says_what_the_noise_is_like(puma: tb.Tree) -> None:
    recording = measured(puma)
    estimates = [tb.identify(puma, recording, method) for method in METHODS]
    external, internal = quality_lines(estimates)
    assert external.startswith("external: 20 unknowns, condition ")
    assert "residual rms Fx 0." in external
    assert "residual rms waist 0." in internal
    for line, estimate in zip((external, internal), estimates, strict=True):
        assert estimate.noise is not None
        assert f"(sigma x {estimate.noise.factor:.2f} by bootstrap" in line
        assert f"noise of {max(estimate.noise.memory):.2g} s" in line


@pytest.mark.slow
def test_constants_that_were_estimated_are_said_and_white_noise_is_not(puma: tb.Tree) -> None:
    clean = measured(puma)
    off = replace(clean, wrench=clean.measured("wrench") + 1.0)
    (line,) = quality_lines([tb.identify(puma, off)])
    assert "constants estimated" in line
    (line,) = quality_lines([tb.identify(puma, clean, settings=tb.Settings(noise="white"))])
    assert "noise" not in line
