"""Delays that were found are added to those that the mapping knew, table by table."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from testbed.recordings.importing.mapping import Mapping, read_mapping
from testbed.sanity.alignment import aligned
from testbed.sanity.clock_offset import ClockOffset
from tests.helpers.foreign_files import npz, some_log

REPORT: Any = SimpleNamespace(clocks={"log": SimpleNamespace(lead=0.25)})


def offset(signal: str, delay: float, skew: float = 0.0) -> ClockOffset:
    return ClockOffset(signal, delay, 1e-5, skew, 1e-7, 10.0, 0.5, 0.01)


def mapping(folder: Path, plates: bool) -> Mapping:
    text = npz(folder, some_log())
    if plates:
        before, wrench = text.split("[wrench]\n")
        text = f"{before}[plates.left]\ndelay = 0.004\n{wrench}\n[plates.right]\n{wrench}"
    (folder / "map.toml").write_text(text)
    return read_mapping(folder / "map.toml")


@pytest.mark.parametrize("signal", ["torque", "wrench"])
def test_a_late_signal_gets_its_delay(signal: str, tmp_path: Path) -> None:
    given = mapping(tmp_path, plates=False)
    found = aligned(given, REPORT, [offset(signal, 0.003)])
    assert getattr(found, signal).delay == pytest.approx(0.003, abs=1e-15)
    other = "wrench" if signal == "torque" else "torque"
    assert getattr(found, other) == getattr(given, other)
    assert found.sources == given.sources


def test_all_plates_get_the_delay_of_their_sum(tmp_path: Path) -> None:
    given = mapping(tmp_path, plates=True)
    found = aligned(given, REPORT, [offset("wrench", 0.003)])
    delays = {name: table.delay for name, table in found.plates.items()}
    assert delays == pytest.approx({"left": 0.007, "right": 0.003}, abs=1e-15)
    assert found.torque == given.torque


def test_late_torques_leave_plates_as_they_are(tmp_path: Path) -> None:
    given = mapping(tmp_path, plates=True)
    found = aligned(given, REPORT, [offset("torque", 0.003)])
    assert found.plates == given.plates
    assert found.torque is not None
    assert found.torque.delay == pytest.approx(0.003, abs=1e-15)


def test_what_may_be_noise_changes_nothing(tmp_path: Path) -> None:
    given = mapping(tmp_path, plates=True)
    assert aligned(given, REPORT, [offset("torque", 1e-6), offset("wrench", 0.0)]) == given


def test_a_clock_that_positions_share_does_not_drift(tmp_path: Path) -> None:
    """Whatever was found: what one device stamps has one clock."""
    found = aligned(mapping(tmp_path, plates=False), REPORT, [offset("wrench", 0.003, 1e-4)])
    assert found.sources["log"].skew == 0.0
    assert found.wrench is not None
    assert found.wrench.delay == pytest.approx(0.003, abs=1e-15)
