"""What foreign parsers complain of is told from what this program writes meanwhile."""

from __future__ import annotations

import os
import sys
from threading import Thread

import pytest

from testbed.robot.stderr import captured_stderr


def test_progress_of_another_thread_is_no_complaint(monkeypatch: pytest.MonkeyPatch) -> None:
    """A progress line during the reading of a model would refuse the model."""
    with os.fdopen(2, "w", closefd=False) as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        with captured_stderr() as said:
            progress = Thread(target=lambda: print("reading ...", file=sys.stderr, flush=True))
            progress.start()
            progress.join()
            assert said() == ""
            os.write(2, b"a parser's complaint")
            assert said() == "a parser's complaint"
        assert sys.stderr is stream
