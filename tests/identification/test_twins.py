"""Twins of real recordings at small size: better than the file, right advice, held intervals."""

from __future__ import annotations

import pytest

from benchmarks.twins import GROUPS

ADVICE = {
    "motors": set[str](),
    "a joint that hardly moves": {"drives.one-way"},
    "payload": set[str](),
    "coarse poses": {"encoder.interpolated"},
    "coarse poses, advice followed": set[str](),
}


@pytest.mark.parametrize("group", GROUPS)
def test_an_estimate_is_better_than_the_file_and_says_what_helps(group: str) -> None:
    """Intervals of 95 % hold; where the advice was followed, there is none left."""
    found = GROUPS[group](1)
    assert found.error < found.file
    assert ADVICE[group] <= {*found.advice}
    assert found.inside > 0.8
    assert not (group == "coarse poses, advice followed" and found.advice)
