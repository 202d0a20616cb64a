"""No number of fourteen runs moves, but where somebody means it to.

`TESTBED_KEEP=1 pytest tests/scenarios` writes them anew.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from testbed.arrays import Array
from tests.scenarios.scenarios import SCENARIOS, figures

KEPT = Path(__file__).parent / "kept"


@pytest.mark.parametrize("name", SCENARIOS)
def test_no_number_moves(name: str) -> None:
    found, place = figures(name), KEPT / f"{name}.json"
    if "TESTBED_KEEP" in os.environ:
        lines = (f"{json.dumps(key)}: {json.dumps(each.tolist())}" for key, each in found.items())
        place.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    kept = {key: np.array(each, dtype=float) for key, each in json.loads(place.read_text()).items()}
    assert list(found) == list(kept)
    moved = {key: _change(kept[key], each) for key, each in found.items()}
    assert {
        key: change for key, change in moved.items() if not change <= SCENARIOS[name].same
    } == {}


def _change(before: Array, now: Array) -> float:
    """Largest, relative to the largest number; infinite where an entry is another kind."""
    if before.shape != now.shape or not np.array_equal(np.isfinite(before), np.isfinite(now)):
        return np.inf
    known = np.isfinite(before)
    if not known.any():
        return 0.0
    apart, size = np.abs(now[known] - before[known]).max(), np.abs(before[known]).max()
    return float(apart / size) if size > 0 else float(apart)
