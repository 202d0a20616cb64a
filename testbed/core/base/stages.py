"""Where a computation spends its time, stage by stage."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Progress = Callable[[int, int], None]
"""Called with what is done, and how much there is in all."""


def unreported(*values: object) -> None:
    """Report nothing: the default of what is called with progress."""


_seconds: ContextVar[defaultdict[str, float] | None] = ContextVar(
    "seconds", default=None
)
_inside: ContextVar[float] = ContextVar("inside", default=0.0)


@contextmanager
def stages() -> Iterator[dict[str, float]]:
    """Seconds of each stage that the block runs through, in the order in which they end."""
    seconds: defaultdict[str, float] = defaultdict(float)
    token = _seconds.set(seconds)
    try:
        yield seconds
    finally:
        _seconds.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """A block, or a decorated function, is a stage; stages inside it count for themselves.

    Args:
        name: What it does.
    """
    seconds = _seconds.get()
    if seconds is None:
        yield
        return
    outer, start = _inside.get(), time.perf_counter()
    _inside.set(0.0)
    try:
        yield
    finally:
        spent = time.perf_counter() - start
        seconds[name] += spent - _inside.get()
        _inside.set(outer + spent)
