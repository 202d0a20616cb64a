"""A report to read."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.experiment.run import Run
from testbed.experiment.unseen import unseen
from testbed.recordings.recording import Recording
from testbed.reporting.html import write_report


@pytest.fixture(scope="session")
def other(puma_run: Run) -> Recording:
    """A motion that the run's estimates have not seen."""
    recording = unseen(puma_run)
    assert recording is not None
    return recording


@pytest.fixture(scope="session")
def page(puma_run: Run, other: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(puma_run, path, other)
    return path
