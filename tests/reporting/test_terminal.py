"""What the terminal shows, as wide as it is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from testbed.reporting.terminal import print_estimates, print_run
from tests.helpers import runs


@pytest.mark.slow
@pytest.mark.parametrize("columns", [60, 72, 80, 110, 140])
@pytest.mark.parametrize("robot", runs.ROBOTS)
def test_no_number_is_cut_off_at_any_width(
    robot: str, columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    run = runs.run_of(runs.robot(robot))
    shown: tuple[Callable[[], None], ...] = (
        lambda: print_run(run, Path("folder")),
        lambda: print_estimates(list(run.estimates.values()), run.warnings),
    )
    for show in shown:
        show()
        said = capsys.readouterr().out
        assert "…" not in said
        table = [line for line in said.splitlines() if line.startswith(("│", "  "))]
        assert table
        assert max(map(len, table)) <= columns
