"""Which lines of the project's functions run: by `sys.monitoring` where Python has it (3.12).

There a line that was seen once costs nothing until the next test begins; `sys.settrace` asks
at every line, which makes the tests several times slower.
"""

from __future__ import annotations

import atexit
import json
import os
import sys
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, TypeAlias

FOLDER = "TESTBED_REACH"
"""The environment's name for the folder in which started programs leave what they executed."""

Lines: TypeAlias = set[tuple[str, int]]
"""Modules, by their path below the root, and lines."""


class Tracer:
    """Follows the functions of the project in all threads."""

    def __init__(self, root: Path) -> None:
        self._root = f"{root}/"
        self._files: dict[str, str | None] = {}
        self.lines: Lines = set()

    def start(self) -> None:
        """From now on."""
        raise NotImplementedError

    def stop(self) -> None:
        """No more."""
        raise NotImplementedError

    def again(self) -> None:
        """Tell of lines that were told of before."""
        raise NotImplementedError

    @contextmanager
    def collecting(self, lines: Lines) -> Iterator[None]:
        """While it lasts, lines go to another set."""
        before, self.lines = self.lines, lines
        self.again()
        try:
            yield
        finally:
            self.lines = before
            self.again()

    def _entered(self, code: CodeType) -> str | None:
        """The module of a function that is called, if it is the project's."""
        file = code.co_filename
        if file not in self._files:
            inside = file.startswith(f"{self._root}testbed/")
            self._files[file] = file.removeprefix(self._root) if inside else None
        module = self._files[file] if code.co_flags & CO_OPTIMIZED else None
        if module is not None:
            self.lines.add((module, code.co_firstlineno))  # of which no event tells
        return module


class Asking(Tracer):
    """By `sys.settrace`."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self._left: dict[CodeType, set[int]] = {}
        self._apart = False

    def start(self) -> None:
        """From now on."""
        if "numba.core.dispatcher" in sys.modules and not self._apart:
            self._apart = True
            _leave_out_compilation()
        threading.settrace(self._call)
        sys.settrace(self._call)

    def stop(self) -> None:
        """No more."""
        sys.settrace(None)

    def again(self) -> None:
        """Tell of lines that were told of before."""
        self._left = {}

    def _call(self, frame: FrameType, event: str, arg: object) -> Any:
        code = frame.f_code
        if self._entered(code) is None:
            return None
        if code not in self._left:
            self._left[code] = {line for _, _, line in code.co_lines() if line is not None}
            self._left[code].discard(code.co_firstlineno)
        return self._line if self._left[code] else None

    def _line(self, frame: FrameType, event: str, arg: object) -> Any:
        code = frame.f_code
        self._left.setdefault(code, set()).discard(frame.f_lineno)
        self.lines.add((self._files[code.co_filename] or "", frame.f_lineno))
        return self._line


if sys.version_info >= (3, 12):

    class Told(Tracer):
        """By `sys.monitoring`."""

        def start(self) -> None:
            """From now on."""
            said = sys.monitoring
            if said.get_tool(said.COVERAGE_ID) is not None:
                return
            said.use_tool_id(said.COVERAGE_ID, "testbed")
            said.register_callback(said.COVERAGE_ID, said.events.PY_START, self._call)
            said.register_callback(said.COVERAGE_ID, said.events.LINE, self._line)
            said.set_events(said.COVERAGE_ID, said.events.PY_START)

        def stop(self) -> None:
            """No more."""
            said = sys.monitoring
            if said.get_tool(said.COVERAGE_ID) is not None:
                said.set_events(said.COVERAGE_ID, said.events.NO_EVENTS)
                said.free_tool_id(said.COVERAGE_ID)

        def again(self) -> None:
            """Tell of lines that were told of before."""
            sys.monitoring.restart_events()

        def _call(self, code: CodeType, offset: int) -> Any:
            said = sys.monitoring
            if self._entered(code) is not None:
                said.set_local_events(said.COVERAGE_ID, code, said.events.LINE)
            return said.DISABLE

        def _line(self, code: CodeType, line: int) -> Any:
            self.lines.add((self._files[code.co_filename] or "", line))
            return sys.monitoring.DISABLE


def tracer(root: Path) -> Tracer:
    """The best that this Python has.

    Args:
        root: Folder of the project, whose `testbed` is followed.
    """
    if sys.version_info >= (3, 12):
        return Told(root)
    return Asking(root)


def _leave_out_compilation() -> None:
    """Do not ask Numba's lines while it compiles: it would take minutes."""
    from numba.core import dispatcher

    numba: Any = dispatcher.Dispatcher
    compiled: Callable[..., Any] = numba.compile

    @wraps(compiled)
    def unasked(*arguments: Any) -> Any:
        asking = sys.gettrace()
        sys.settrace(None)
        try:
            return compiled(*arguments)
        finally:
            sys.settrace(asking)

    numba.compile = unasked


def follow() -> None:
    """In a program that a test started: leave what it executed where the test finds it."""
    folder, test = os.environ.get(FOLDER), os.environ.get("PYTEST_CURRENT_TEST")
    if not folder or not test:
        return
    followed = tracer(Path(__file__).parents[2])

    def leave() -> None:
        followed.stop()
        said = {"test": test.rpartition(" (")[0], "lines": sorted(followed.lines)}
        (Path(folder) / f"{uuid.uuid4().hex}.json").write_text(json.dumps(said))

    atexit.register(leave)
    followed.start()
