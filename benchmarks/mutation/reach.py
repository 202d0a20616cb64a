"""Which lines of the project each test executes, programs that it starts included.

A plugin of pytest for one file of tests at a time. Lines of functions alone are counted:
what a module does while it is imported, it does for all tests. What a shared fixture
executes counts for every test that uses it, what happens while tests are collected for all.
"""

from __future__ import annotations

import atexit
import json
import os
import sys
import threading
import uuid
from collections import defaultdict
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import wraps
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, TypeAlias

import pytest

FOLDER = "TESTBED_REACH"
"""The environment's name for the folder in which started programs leave what they executed."""

Lines: TypeAlias = set[tuple[str, int]]
"""Modules, by their path below the root, and lines."""


class Tracer:
    """Follows the functions of the project in all threads."""

    def __init__(self, root: Path) -> None:
        self._root = f"{root}/"
        self._files: dict[str, str | None] = {}
        self._left: dict[CodeType, set[int]] = {}
        self.lines: Lines = set()

    def start(self) -> None:
        """From now on."""
        threading.settrace(self._call)
        sys.settrace(self._call)

    @contextmanager
    def collecting(self, lines: Lines) -> Iterator[None]:
        """While it lasts, lines go to another set."""
        before, self.lines, self._left = self.lines, lines, {}
        try:
            yield
        finally:
            self.lines, self._left = before, {}

    def _module(self, file: str) -> str | None:
        if file not in self._files:
            inside = file.startswith(f"{self._root}testbed/")
            self._files[file] = file.removeprefix(self._root) if inside else None
        return self._files[file]

    def _call(self, frame: FrameType, event: str, arg: object) -> Any:
        code = frame.f_code
        if self._module(code.co_filename) is None or not code.co_flags & CO_OPTIMIZED:
            return None
        if code not in self._left:
            self._left[code] = {line for _, _, line in code.co_lines() if line is not None}
            self._left[code].discard(code.co_firstlineno)  # of which no event tells
            self.lines.add((self._module(code.co_filename) or "", code.co_firstlineno))
        return self._line if self._left[code] else None

    def _line(self, frame: FrameType, event: str, arg: object) -> Any:
        code = frame.f_code
        left = self._left.setdefault(code, set())
        left.discard(frame.f_lineno)
        self.lines.add((self._module(code.co_filename) or "", frame.f_lineno))
        return self._line


def leave_out_compilation() -> None:
    """Do not follow Numba while it compiles: it would take minutes."""
    from numba.core import dispatcher

    numba: Any = dispatcher.Dispatcher
    compiled = numba.compile

    @wraps(compiled)
    def untraced(*arguments: Any) -> Any:
        tracing = sys.gettrace()
        sys.settrace(None)
        try:
            return compiled(*arguments)
        finally:
            sys.settrace(tracing)

    numba.compile = untraced


class Reach:
    """The plugin: `found` holds a record a test."""

    def __init__(self, root: Path, folder: Path) -> None:
        self._tracer = Tracer(root)
        self._folder = folder
        self._common: Lines = set()  # while tests are collected
        self._shared: dict[str, Lines] = defaultdict(set)  # by fixture
        self._tests: dict[str, Lines] = {}
        self._records: dict[str, dict[str, Any]] = {}
        os.environ[FOLDER] = str(folder)
        leave_out_compilation()

    @pytest.hookimpl(wrapper=True)
    def pytest_collection(self) -> Generator[None, Any, Any]:
        """Follow what happens from the first import on."""
        self._tracer.start()
        with self._tracer.collecting(self._common):
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
    ) -> Generator[None, Any, Any]:
        """A fixture of its own scope: what it executes counts for all that use it."""
        if fixturedef.scope == "function":
            return (yield)
        with self._tracer.collecting(self._shared[fixturedef.argname]):
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Function) -> Generator[None, Any, Any]:
        """One test."""
        self._tests[item.nodeid] = set()
        slow = item.get_closest_marker("slow") is not None
        self._records[item.nodeid] = {"seconds": 0.0, "slow": slow, "passed": True}
        self._records[item.nodeid]["fixtures"] = list(item.fixturenames)
        with self._tracer.collecting(self._tests[item.nodeid]):
            self._tracer.start()  # whatever the last test did to it
            return (yield)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """How long it took, and whether it passed."""
        record = self._records[report.nodeid]
        record["seconds"] += report.duration
        record["passed"] &= report.outcome != "failed"

    def found(self) -> dict[str, Any]:
        """Records of tests by name; the lines of each are one of `lines`, counted from 0."""
        sys.settrace(None)
        for path in self._folder.glob("*.json"):
            said = json.loads(path.read_text())
            if said["test"] in self._tests:
                self._tests[said["test"]] |= {(module, line) for module, line in said["lines"]}
        kept: dict[str, int] = {}
        for name, record in self._records.items():
            lines = self._tests[name] | self._common
            for fixture in record.pop("fixtures"):
                lines |= self._shared.get(fixture, set())
            by_module = defaultdict(list)
            for module, line in sorted(lines):
                by_module[module].append(line)
            record["lines"] = kept.setdefault(json.dumps(by_module), len(kept))
        return {"tests": self._records, "lines": [json.loads(text) for text in kept]}


def follow() -> None:
    """In a program that a test started: leave what it executed where the test finds it."""
    folder, test = os.environ.get(FOLDER), os.environ.get("PYTEST_CURRENT_TEST")
    if not folder or not test:
        return
    tracer = Tracer(Path(__file__).parents[2])

    def leave() -> None:
        sys.settrace(None)
        said = {"test": test.rpartition(" (")[0], "lines": sorted(tracer.lines)}
        (Path(folder) / f"{uuid.uuid4().hex}.json").write_text(json.dumps(said))

    atexit.register(leave)
    tracer.start()
