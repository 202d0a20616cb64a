"""Keep foreign parsers from writing to the terminal behind our back."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def captured_stderr() -> Iterator[Callable[[], str]]:
    """Collect what C++ code writes to standard error; yields a reader of it.

    What Python writes meanwhile, such as another thread's progress, goes where it did before.
    """
    ours = sys.stderr
    ours.flush()
    saved = os.dup(2)
    with tempfile.TemporaryFile() as sink, os.fdopen(saved, "w", encoding="utf-8") as before:
        if _writes_to_standard_error(ours):
            sys.stderr = before
        os.dup2(sink.fileno(), 2)

        def said() -> str:
            sink.seek(0)
            return sink.read().decode(errors="replace")

        try:
            yield said
        finally:
            before.flush()
            os.dup2(saved, 2)
            sys.stderr = ours


def _writes_to_standard_error(stream: object) -> bool:
    """Whether a stream ends in file descriptor 2; a test's or a notebook's does not."""
    try:
        return int(stream.fileno()) == 2  # type: ignore[attr-defined]
    except (AttributeError, OSError, ValueError):
        return False
