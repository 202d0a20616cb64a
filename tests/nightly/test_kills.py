"""A campaign whose worker is killed: no run is lost, none is there twice."""

from __future__ import annotations

import pytest

from benchmarks.campaign import kills

pytestmark = pytest.mark.nightly


def test_a_kill_at_a_random_moment_costs_nothing() -> None:
    """Kill -9 of a worker; of the command and the scheduler, too: python -m benchmarks campaign."""
    assert kills("worker", 3, 20, 1)["same_table"] == 3
