"""What a report says of the instrument."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.experiment.predictions import predict
from testbed.experiment.run import Run, assemble_run
from testbed.identification.nuisances.all_nuisances import NUISANCES
from testbed.identification.nuisances.estimates import TraceTest
from testbed.instruments.plate import PlatePose
from testbed.recordings.columns import AXES
from testbed.reporting.instrument_tables import instrument_tables
from tests.helpers.measured import measured
from tests.helpers.runs import robot

pytestmark = pytest.mark.slow


def turned(**settings: object) -> Run:
    """A run of the PUMA whose plate is turned by a degree."""
    tree = robot("puma")
    recording = measured(tree)
    fault = PlatePose(rotation=(0.02, 0.0, 0.0), translation=(0.0, 0.0, 0.0))
    wrench = fault.apply(recording.measured("wrench"), recording.time, np.random.default_rng(0))
    table = tb.Settings(zeros=True, **settings)  # type: ignore[arg-type]
    return assemble_run(tree, replace(recording, wrench=wrench), name="turned", settings=table)


def test_a_clear_trace_is_shown_with_its_size() -> None:
    table, others, repeated = instrument_tables(turned())
    assert [each["traced"] for each in (table, others, repeated)] == [True, False, True]
    assert repeated["caption"].startswith("Part of the residuals that repeats with the motion")
    assert repeated["heads"] == ["channel", "part"]
    assert [row[0] for row in repeated["rows"]] == list(AXES)
    assert table["heads"] == ["fault", "chance", "would move", "size"]
    said, chance, moved, size = table["rows"][0]
    assert said == "a plate that is turned or shifted"
    assert chance == "below 1e-99"
    assert moved.endswith("sigma")
    assert "pose/rx 0.02" in size


def chance_of(table: dict[str, Any]) -> float:
    """That noise alone repeats with the motion as much as that."""
    return float(table["caption"].rpartition("chance ")[2].partition(" ")[0])


def test_what_was_estimated_is_shown_and_leaves_no_trace() -> None:
    numbers, tests, repeated = instrument_tables(turned(nuisances=["pose"]))
    name, unit, value, sigma = numbers["rows"][0]
    assert (name, unit) == ("pose/rx", "rad")
    assert abs(float(value) - 0.02) < 5 * float(sigma)
    assert tests["heads"] == ["fault", "chance"]
    assert chance_of(repeated) > 100 * chance_of(instrument_tables(turned())[-1])


def test_predictions_are_held_against_the_corrected_wrench() -> None:
    """The residual is then what it is without the fault."""
    left = {}
    for name, run in (("plain", turned()), ("known", turned(nuisances=["pose"]))):
        signal = next(s for s in predict(run).smoothed(10.0).signals if s.kind == "wrench")
        left[name] = abs(signal.residual("external")[:, :3]).mean()
    assert left["known"] < 0.9 * left["plain"]


@pytest.mark.parametrize(
    ("chance", "said"), [(0.31, "0.31"), (2e-30, "2e-30"), (0.0, "below 1e-99")]
)
def test_of_what_left_no_clear_trace_only_the_chance_is_told(chance: float, said: str) -> None:
    """What is no chance stands in a table of its own; rows have as many cells as heads."""
    kind = next(each for each in NUISANCES if each.kind == "pose")
    parts = ("pose/rx", "pose/ry"), ("rad", "rad"), (0.02, -0.5)
    clear = TraceTest(kind, 1e-80, 50.0, *parts, shift=12.0, parameter="mb2x")
    other = replace(clear, chance=chance, parameter="mb3x", shift=-3.0)
    estimate = SimpleNamespace(nuisances=(), trace_tests=(clear, other), noise=None)
    run: Any = SimpleNamespace(estimates={"external": estimate})
    tables = instrument_tables(run)
    assert [table["traced"] for table in tables] == ([True, False] if chance > 0.1 else [True])
    rows = {row[1]: row for table in tables for row in table["rows"]}
    assert rows["1e-80"][2] == "mb2x by 12 sigma"
    last = [] if chance > 0.1 else ["mb3x by -3 sigma", rows["1e-80"][3]]
    assert rows[said] == [kind.said, said, *last]
    for table in tables:
        assert {len(row) for row in table["rows"]} == {len(table["heads"])}


def test_the_period_that_is_told_is_the_motions() -> None:
    """Of a long recording, in which every third sample is looked at: 10 s are not 9.999 s."""
    tree = robot("puma")
    run = assemble_run(tree, measured(tree, duration=60.0, rate=1000.0), name="long",
                       settings=tb.Settings(zeros=True))  # fmt: skip
    repeated = instrument_tables(run)[-1]
    assert "every 10 s:" in repeated["caption"]
