"""Which lines of the project each test executes, programs that it starts included.

A plugin of pytest for one file of tests at a time. Lines of functions alone are counted:
what a module does while it is imported, it does for all tests. What a shared fixture
executes counts for every test that uses it, what happens while tests are collected for all.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.mutation.tracer import FOLDER, Lines, tracer


class Reach:
    """The plugin: `found` holds a record a test."""

    def __init__(self, root: Path, folder: Path, *, slow: bool) -> None:
        """For the tests of a file that are slow, or those that are not.

        Args:
            root: The project.
            folder: Where started programs leave what they executed.
            slow: Which of the two.
        """
        self._tracer = tracer(root)
        self._slow = slow
        self._others = 0
        self._folder = folder
        self._common: Lines = set()  # while tests are collected
        self._shared: dict[str, Lines] = defaultdict(set)  # by fixture
        self._tests: dict[str, Lines] = {}
        self._records: dict[str, dict[str, Any]] = {}
        os.environ[FOLDER] = str(folder)

    @pytest.hookimpl(wrapper=True)
    def pytest_collection(self) -> Generator[None, Any, Any]:
        """Follow what happens from the first import on."""
        self._tracer.start()
        with self._tracer.collecting(self._common):
            return (yield)

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leave out the others, and count them."""
        kept = [item for item in items if is_slow(item) == self._slow]
        self._others = len(items) - len(kept)
        items[:] = kept

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
        self._records[item.nodeid] = {"seconds": 0.0, "slow": self._slow, "passed": True}
        self._records[item.nodeid]["fixtures"] = list(item.fixturenames)
        begun = _processor_time()
        with self._tracer.collecting(self._tests[item.nodeid]):
            self._tracer.start()  # whatever the last test did to it
            try:
                return (yield)
            finally:
                self._records[item.nodeid]["seconds"] = _processor_time() - begun

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Whether it passed."""
        self._records[report.nodeid]["passed"] &= report.outcome != "failed"

    def found(self) -> dict[str, Any]:
        """Records of tests by name; the lines of each are one of `lines`, counted from 0.

        How many tests were left out is there, too.
        """
        self._tracer.stop()
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
        found = {"tests": self._records, "lines": [json.loads(text) for text in kept]}
        return found | {"others": self._others}


def is_slow(item: pytest.Item) -> bool:
    """Whether a test is marked so."""
    return item.get_closest_marker("slow") is not None


def _processor_time() -> float:
    """Seconds of processor time of this process and of programs that have ended."""
    return sum(os.times()[:4])
