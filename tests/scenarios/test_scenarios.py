"""No number of fourteen runs moves, but where somebody means it to."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from testbed.core.base.arrays import Array
from tests.scenarios.scenarios import SCENARIOS, figures

KEPT = Path(__file__).parent / "kept"
SAME = {"motion": 1e-6}  # a search adds rounding up
"""Part of an array's largest number by which any may differ; 1e-9 of other scenarios."""


def change(found: Array, before: Array) -> float:
    """Part of an array's largest number by which one differs; infinite if other numbers lack."""
    known = np.isfinite(before)
    if found.shape != before.shape or not np.isfinite(found[known]).all():
        return np.inf
    if not np.array_equal(found[~known], before[~known], equal_nan=True):
        return np.inf
    size = np.abs(before[known]).max(initial=0.0) or 1.0
    return float(np.abs(found[known] - before[known]).max(initial=0.0) / size)


def test_no_number_moves() -> None:
    """Else an estimate, a sigma or a figure of somebody's robot changes and nobody knows why."""
    moved = []
    for name in SCENARIOS:
        found, place = figures(name), KEPT / f"{name}.json"
        if "TESTBED_KEEP" in os.environ:
            lines = (f"{json.dumps(k)}: {json.dumps(each.tolist())}" for k, each in found.items())
            place.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        kept = {k: np.array(each, dtype=float) for k, each in json.loads(place.read_text()).items()}
        gaps = {key: change(found[key], kept[key]) for key in found.keys() & kept.keys()}
        gaps |= dict.fromkeys(found.keys() ^ kept.keys(), np.inf)
        far = {key: gap for key, gap in gaps.items() if gap > SAME.get(name, 1e-9)}
        if far:
            worst = max(far, key=far.__getitem__)
            moved.append(f"{name}: {len(far)} of {len(gaps)}, most '{worst}' by {far[worst]:.1e}")
    if moved:
        pytest.fail(
            "\n".join(moved) + "\nif that is meant, TESTBED_KEEP=1 pytest tests/scenarios writes "
            "them anew, and the commit says why",
            pytrace=False,
        )
