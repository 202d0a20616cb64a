"""What a campaign says while it runs, and of lists that are too long for a terminal."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from testbed.campaign.campaign_folder import RESULTS
from testbed.campaign.conduct import Standing
from testbed.reporting.campaign_lines import (
    Throughput,
    duration,
    print_changes,
    print_conducted,
)
from tests.helpers.console import printed


def test_a_campaigns_line_says_runs_failures_rate_and_time_left() -> None:
    shown = Throughput()
    shown.of(Standing(2, 100, 0, 0.5))
    assert shown.line == f"2 of 100 runs, 0.5 a second, {duration(98 / 0.5)} left, 2% ..."
    shown.of(Standing(4, 100, 1, 0.5))
    assert shown.line.startswith("4 of 100 runs, 1 failed, 0.5 a second")


@pytest.mark.parametrize(("count", "more"), [(0, None), (20, None), (21, 1), (45, 25)])
def test_twenty_failures_are_listed(count: int, more: int | None) -> None:
    failures = [(f"testbed run {k}", f"reason {k}") for k in range(count)]
    folder: Any = SimpleNamespace(
        failures=lambda: failures, status=dict.fromkeys(range(count + 3)), path=Path("r")
    )
    lines = printed(100, print_conducted, folder).splitlines()
    assert print_conducted(Console(quiet=True), folder) == count
    assert sum(line.startswith("failed: reason") for line in lines) == min(count, 20)
    assert sum(line.startswith("  testbed run") for line in lines) == min(count, 20)
    told = [line for line in lines if line.startswith("...")]
    assert told == ([] if more is None else [f"... {more} more, in the table"])
    assert f"3 runs with a result, {count} without" in lines
    assert f"table: {Path('r') / RESULTS}" in lines


def test_campaigns_of_no_common_cell_are_said_to_be() -> None:
    said = printed(100, print_changes, [])
    assert "the two campaigns have no cell of the same levels" in said
