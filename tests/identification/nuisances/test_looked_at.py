"""Traces of faults are looked for in some windows of a long recording; all else is as it was."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.identification import windows
from testbed.identification.windows import make_plan
from testbed.instruments.encoders import EncoderGain
from testbed.instruments.fault import Fault
from testbed.instruments.plate import PlatePose
from testbed.instruments.plate_clock import PlateDelay
from testbed.kernel.layout import layout
from tests.helpers.faulty import clean, with_faults
from tests.helpers.runs import robot


@pytest.fixture
def short_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of half a minute."""
    monkeypatch.setattr(windows, "WINDOW", 1000)


@pytest.mark.slow
@pytest.mark.parametrize(("most", "seen"), [(1, 1), (3, 3), (4, 4), (10_000, None)])
def test_windows_that_are_looked_at_are_spread_evenly(
    short_windows: None, monkeypatch: pytest.MonkeyPatch, most: int, seen: int | None
) -> None:
    tree = robot("puma")
    monkeypatch.setattr(windows, "LOOKED_AT", most)
    recording = clean(tree, 0, duration=260.0, rate=200.0)
    rows = layout(tree.without_inertias(), tb.minimal_set(tree, "reaction"))
    plan = make_plan(recording, rows, tb.pedestal_wrench(tree), tb.Settings())
    every = [window.row for window in plan.windows()]
    assert len(plan.looked_at) == (seen or len(every))
    assert plan.looked_at <= set(every)
    assert plan.looked_at_all == (seen is None)
    if len(plan.looked_at) > 1:
        at = [every.index(row) for row in sorted(plan.looked_at)]
        assert at[0] == 0
        assert at[-1] == len(every) - 1
        assert np.ptp(np.diff(at)) <= 1


FAULTS: dict[str, Fault | None] = {
    "": None,
    "skew": PlateDelay(delay=1e-3),
    "pose": PlatePose(rotation=3.5e-3, translation=1e-3),
    "encoder_gains": EncoderGain(error=0.01),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind"), [*(("puma", kind) for kind in FAULTS), ("gantry", ""), ("gantry", "skew")]
)
def test_faults_are_found_in_part_of_a_recording(
    short_windows: None, monkeypatch: pytest.MonkeyPatch, name: str, kind: str
) -> None:
    """A third of it. The estimate is the same; sizes and shifts are those of the whole, about."""
    tree, fault = robot(name), FAULTS[kind]
    recording = clean(tree, 1, duration=260.0, rate=200.0)
    recording = with_faults(recording, 1, *([fault] if fault else []))
    whole = tb.identify(tree, recording)
    monkeypatch.setattr(windows, "LOOKED_AT", 3)
    part = tb.identify(tree, recording)
    np.testing.assert_allclose(part.values, whole.values, rtol=1e-9)
    np.testing.assert_allclose(part.covariance, whole.covariance, rtol=1e-6)
    said = [estimate.doubtful for estimate in (whole, part)]
    assert said == [bool(kind)] * 2
    if kind:
        one, other = (
            next(test for test in each.trace_tests if test.nuisance.kind == kind)
            for each in (whole, part)
        )
        assert other.chance < 1e-9
        at = int(np.abs(one.size).argmax())
        np.testing.assert_allclose(other.size[at], one.size[at], rtol=0.3)
        assert 0.3 < other.shift / one.shift < 3
