"""Which pieces of an interrupted recording are long enough."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from testbed.recordings.importing.interruptions import SHORTEST, cut

SOURCE: Any = SimpleNamespace(steady=False, max_gap=0.2, rate=None)


@pytest.mark.parametrize(("length", "kept"), [(SHORTEST, 2), (SHORTEST - 0.125, 1)])
def test_a_piece_of_just_the_least_length_is_kept(length: float, kept: int) -> None:
    """Stamps are eighths of a second, which are exact."""
    first = np.arange(0, length + 0.125, 0.125)
    time = np.concatenate([first, np.arange(8.0, 12.125, 0.125)])
    windows, lines = cut((0.0, 12.0), {"log": SOURCE}, {"log": time})
    assert windows == [(0.0, length), (8.0, 12.0)][-kept:]
    assert ("left out" in lines[-1]) == (kept == 1)
    assert lines[0].startswith(f"nothing of source 'log' for {8 - length:.3g} s after {length:g} s")


@pytest.mark.parametrize("window", [(0.0, 5.0), (7.0, 12.0)])
def test_silence_before_and_after_what_is_wanted_cuts_nothing(
    window: tuple[float, float],
) -> None:
    """It begins where the window ends, or ends where the window begins."""
    time = np.concatenate([np.arange(0, 5.125, 0.125), np.arange(7, 12.125, 0.125)])
    assert cut(window, {"log": SOURCE}, {"log": time}) == ([window], [])
