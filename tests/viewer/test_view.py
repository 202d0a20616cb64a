"""Runs in the viewer, from Python."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

import testbed as tb
from testbed.experiment.run import Run
from testbed.viewer import show


@pytest.mark.slow
def test_a_file_is_written_and_nothing_opened(
    puma_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subprocess, "Popen", None)  # calling it would fail
    path = tb.view(puma_run, tmp_path / "run.rrd")
    assert path.read_bytes()[:4] == b"RRF2"


@pytest.mark.slow
def test_without_a_place_the_viewer_is_started(
    puma_run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[list[str]] = []
    monkeypatch.setattr(show, "has_screen", lambda: True)
    monkeypatch.setattr(show, "viewer_program", lambda: "rerun")
    monkeypatch.setattr(subprocess, "Popen", lambda words, **_: started.append(words))
    path = tb.view([puma_run, puma_run])
    assert started == [["rerun", str(path), "--bind", "127.0.0.1"]]
    monkeypatch.setattr(show, "has_screen", lambda: False)
    with pytest.raises(tb.TestbedError, match="no screen"):
        tb.view(puma_run)
