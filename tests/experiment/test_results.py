"""What of an estimate goes into files."""

from __future__ import annotations

import json

import pytest

import testbed as tb
from testbed.experiment.results import estimate_as_json
from tests.helpers.measured import measured


@pytest.mark.slow
def test_noise_is_written_where_it_has_a_memory(puma: tb.Tree) -> None:
    recording = measured(puma, memory=0.9)
    estimate = tb.identify(puma, recording)
    assert estimate.noise is not None
    found = json.loads(json.dumps(estimate_as_json(estimate)))["noise"]
    assert found["order"] == estimate.noise.order >= 1
    assert found["memory"] == list(estimate.noise.memory)
    assert found["factor"] == estimate.noise.factor
    assert len(found["bias"]) == len(found["bias_sigma"]) == 6
    assert 0 <= found["bias_chance"] <= 1
    assert 0 <= found["bias_weight"] <= 1
    assert found["hidden"] == ["mbar1"]
    assert found["drowned"] == []
    white = tb.identify(puma, recording, settings=tb.Settings(noise="white"))
    assert estimate_as_json(white)["noise"] is None
