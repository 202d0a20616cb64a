"""What many tests need: the PUMA, the golden data."""

from __future__ import annotations

import json
import os
import signal
import threading
from typing import Any

import hypothesis
import pytest

# before NumPy: on matrices this small, BLAS threads only wait for each other
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# hundreds of processes are started: they need not compile the project each
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# what they print waits in a buffer, as it does for most people
os.environ.pop("PYTHONUNBUFFERED", None)
# where tests run in the background Ctrl-C is ignored, and would be by what they start
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

import testbed as tb
from testbed.view import output
from tests.helpers.paths import GOLDEN, ROOT

# machines are noisy: no deadline; the same examples each time, but in the nightly run
hypothesis.settings.register_profile(
    "suite", deadline=None, derandomize=True, max_examples=20, database=None
)
hypothesis.settings.register_profile("nightly", deadline=None, max_examples=100)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "suite"))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Nightly tests run only where they are asked for."""
    if "nightly" not in config.option.markexpr:
        dropped = [item for item in items if item.get_closest_marker("nightly")]
        config.hook.pytest_deselected(items=dropped)
        items[:] = [item for item in items if item not in dropped]


@pytest.fixture(autouse=True)
def no_lines_of_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """How long something takes must not show in what it says."""
    monkeypatch.setattr(output, "MIN_LINE_INTERVAL", float(threading.TIMEOUT_MAX))


@pytest.fixture(scope="session")
def puma() -> tb.Tree:
    return tb.load_tree(ROOT / "models/puma562.xml")


@pytest.fixture(scope="session")
def golden() -> Any:
    return json.loads((GOLDEN / "puma562.json").read_text())
