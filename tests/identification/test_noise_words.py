"""Encoders that are named as coarse are those that show whole steps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from testbed.identification import noise_warnings


@pytest.mark.parametrize("share", [0.4, 3.0])
def test_only_coarse_encoders_are_named(share: float) -> None:
    estimate: Any = SimpleNamespace(joints=("waist", "elbow", "wrist"))
    noise: Any = SimpleNamespace(steps_matter=True, least_counts=(0.0, 1e-3, 0.0), by_counts=share)
    (line,) = noise_warnings._coarse(estimate, noise)
    assert "'elbow' (0.001 a step)" in line
    assert "waist" not in line
    assert "wrist" not in line
    assert f"about {min(100 * share, 100):.0f}% of the residuals" in line
