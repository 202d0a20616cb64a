"""What the terminal shows, as wide as it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from testbed.experiment.experiment_tables import Bound
from testbed.experiment.unseen import validated
from testbed.reporting.terminal import print_estimates, print_run
from tests.helpers import runs
from tests.helpers.ideal import ideal


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


@pytest.mark.slow
@pytest.mark.parametrize("robot", runs.ROBOTS)
def test_a_run_fits_one_screen(
    robot: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """40 rows of 100 columns, whatever is wrong: verdict, one cause, ten parameters."""
    monkeypatch.setenv("COLUMNS", "100")
    tree = runs.robot(robot)
    recording = runs.noisy(ideal(tree))
    weak = replace(recording, torque=1.06 * recording.measured("torque"))
    bound = Bound(at_most=1e-9)
    expect = {"external_max_z": bound, "internal_max_z": bound, "internal_to_external": bound}
    claim = runs.experiment(expect=expect).model_copy(update={"claim": "All is well. " * 12})
    run = validated(runs.run_of(tree, weak, claim), runs.noisy(ideal(tree, seed=8), 4))
    assert len(run.warnings) > 1
    estimates = list(run.estimates.values())
    shows: tuple[Callable[..., None], ...] = (
        partial(print_run, run, Path("folder")),
        partial(print_estimates, estimates, run.warnings),
    )
    for show in shows:
        show(everything=False)
        short = capsys.readouterr().out
        show(everything=True)
        whole = capsys.readouterr().out
        rows = sum(max(1, -(-len(line) // 100)) for line in short.splitlines())
        assert rows <= 40, short
        names = {name for e in estimates for name in e.names}
        shown = [{n for n in names if f" {n} " in text} for text in (short, whole)]
        assert len(shown[0]) >= min(10, len(names))
        assert shown[1] == names
        assert sum(line.startswith("warning: ") for line in short.splitlines()) == 1
        assert sum(line.startswith("warning: ") for line in whole.splitlines()) >= len(run.warnings)
