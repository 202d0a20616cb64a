"""No number of fourteen runs moves, but where somebody means it to.

`TESTBED_KEEP=1 pytest tests/scenarios` writes them anew.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

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
    same = SCENARIOS[name].same
    for key, before in kept.items():
        size = np.abs(before[np.isfinite(before)]).max(initial=0.0) or 1.0
        np.testing.assert_allclose(
            found[key], before, rtol=0, atol=same * size, err_msg=key, strict=True
        )
