"""How much is computed, told by no clock: machines are slow and noisy, counts are not."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Calls:
    """Functions that were called, Python's and C's."""

    count = 0

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        """What the interpreter says of every call and return."""
        if event in ("call", "c_call"):
            self.count += 1


@contextmanager
def counted_calls() -> Iterator[Calls]:
    """Count the calls that are made meanwhile, by this thread."""
    calls, before = Calls(), sys.getprofile()
    sys.setprofile(calls)
    try:
        yield calls
    finally:
        sys.setprofile(before)
