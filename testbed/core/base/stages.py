"""Computing time of each processing stage, and callbacks that report progress."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Progress = Callable[[int, int], None]
"""Callback with the number of finished steps and the total number."""


def ignore_progress(*values: object) -> None:
    """Ignore reported progress; this is the default callback."""


_stage_seconds: ContextVar[defaultdict[str, float] | None] = ContextVar(
    "seconds", default=None
)
"""Seconds keyed by stage in the enclosing `measure_stages` block; None outside a block."""
_nested_seconds: ContextVar[float] = ContextVar("inside", default=0.0)
"""Seconds spent so far in stages that are nested in the current stage."""


@contextmanager
def measure_stages() -> Iterator[dict[str, float]]:
    """Context manager that measures the run time of each stage in its block.

    Yields:
        Seconds keyed by stage name, summed up by `timed_stage`.
    """
    seconds: defaultdict[str, float] = defaultdict(float)
    token = _stage_seconds.set(seconds)
    try:
        yield seconds
    finally:
        _stage_seconds.reset(token)


@contextmanager
def timed_stage(name: str) -> Iterator[None]:
    """Context manager or decorator that adds its run time to a stage.

    The time of a nested stage is added only to the nested stage. Outside `measure_stages`, no time
    is measured.

    Args:
        name: Name of the stage.
    """
    seconds = _stage_seconds.get()
    if seconds is None:
        yield
        return
    outer_nested, start = _nested_seconds.get(), time.perf_counter()
    _nested_seconds.set(0.0)
    try:
        yield
    finally:
        duration = time.perf_counter() - start
        seconds[name] += duration - _nested_seconds.get()
        _nested_seconds.set(outer_nested + duration)
