"""Copies of the project in which its tests run, changed or not, one process each.

Processes are forked from one that has the large packages loaded, so that a run of a few
tests takes about as long as these tests. Numba's compiled code is kept between runs, unless
the change is one of compiled code.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any

import pytest

LOADED = (
    "scipy.signal", "scipy.linalg", "mujoco", "mujoco.batch", "pinocchio", "coal", "numba",
    "pydantic", "rich.table", "jinja2", "matplotlib.figure", "threadpoolctl", "hypothesis",
)  # fmt: skip
"""Packages that most tests need; none starts threads, which do not survive a fork."""

OWN = ("testbed", "tests", "benchmarks")
"""What is imported anew in each process, from its copy."""

WAITING = 6.0
"""Wall time that a process may take, in limits of its processor time: machines are busy."""

MEMORY = 8 << 30
"""Bytes of data that a process of tests may hold."""


STARTS = """import os

if "TESTBED_REACH" in os.environ:
    import benchmarks.mutation.tracer

    benchmarks.mutation.tracer.follow()
"""
"""What programs in a copy begin with; that they are followed costs only where it is wanted."""


class Chosen:
    """A plugin of pytest: the tests that are wanted, in their order; the first that fails."""

    def __init__(self, limits: Mapping[str, float], said: Path) -> None:
        self._limits = limits
        self._order = {name: place for place, name in enumerate(limits)}
        self._said = said

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leave out the others."""
        kept = [item for item in items if item.nodeid in self._order]
        items[:] = sorted(kept, key=lambda item: self._order[item.nodeid])

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """What the test may take from now on."""
        limit_time(self._limits[nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note what failed, once."""
        if report.failed and not self._said.exists():
            self._said.write_text(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Note what could not be imported."""
        if report.failed and not self._said.exists():
            self._said.write_text(f"import of {report.nodeid}")


class Bench:
    """One copy of the project, for one process at a time."""

    def __init__(self, root: Path, folder: Path) -> None:
        """Make the copy like the project, or bring it up to date.

        Args:
            root: The project, a checkout of git.
            folder: Where the copy is to stand; what else is in it is removed.
        """
        self.folder = folder
        self._compiled = folder.parent / f"{folder.name}-numba"
        self._log = folder.parent / f"{folder.name}.log"
        self._said = folder.parent / f"{folder.name}.said"
        self._changed: tuple[Path, bytes, int] | None = None
        listing = ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
        listed = subprocess.run(listing, cwd=root, check=True, capture_output=True, text=True)
        wanted = {name for name in listed.stdout.split("\0") if name and (root / name).is_file()}
        for name in sorted(wanted):
            _copy(root / name, folder / name)
        for path in folder.rglob("*.py"):
            if path.relative_to(folder).as_posix() not in wanted:
                path.unlink()
        (folder / "sitecustomize.py").write_text(STARTS)

    def trace(self, file: str, into: Path, *, slow: bool) -> None:
        """Run the slow tests of a file or the others, and write what each executes as JSON."""

        def run() -> int:
            from benchmarks.mutation.reach import Reach

            with tempfile.TemporaryDirectory() as left:
                reach = Reach(self.folder, Path(left), slow=slow)
                pytest.main([file, *_QUIET], plugins=[reach])
                into.write_text(json.dumps(reach.found()))
            return 0

        self._forked(run, self._compiled, limit=None)

    def failure(self, limits: Mapping[str, float], start: float, *, compiles: bool = False) -> str:
        """Run some tests in their order, until one fails.

        Args:
            limits: Seconds of processor time that each may take, by name.
            start: What is given to imports and collection.
            compiles: Whether what Numba compiled before is not to be used.

        Returns:
            The test that failed, or what else stopped the run; "" if all passed.
        """
        files = list(dict.fromkeys(name.partition("::")[0] for name in limits))
        self._said.unlink(missing_ok=True)

        def run() -> int:
            limit_time(start)
            plugin = Chosen(limits, self._said)
            return int(pytest.main([*files, "-x", *_QUIET], plugins=[plugin]))

        fresh = self._compiled.with_name(f"{self._compiled.name}-fresh")
        shutil.rmtree(fresh, ignore_errors=True)
        limit = start + sum(limits.values())
        code = self._forked(run, fresh if compiles else self._compiled, limit)
        if code == 0:
            return ""
        if self._said.exists():
            return self._said.read_text()
        return "time or memory spent" if code < 0 else f"pytest ended with {code}"

    def change(self, name: str, content: bytes) -> None:
        """Write another content into a file of the copy."""
        path = self.folder / name
        if self._changed is not None:
            self.restore()
        self._changed = path, path.read_bytes(), path.stat().st_mtime_ns
        path.write_bytes(content)
        Path(cache_from_source(str(path))).unlink(missing_ok=True)

    def restore(self) -> None:
        """Undo the change; compiled code goes by times, so these come back, too."""
        if self._changed is not None:
            path, content, time_ns = self._changed
            path.write_bytes(content)
            os.utime(path, ns=(time_ns, time_ns))
            Path(cache_from_source(str(path))).unlink(missing_ok=True)
            self._changed = None

    def _forked(self, run: Callable[[], int], compiled: Path, limit: float | None) -> int:
        """The exit code of a function in a new process; one that waits for ever is ended."""
        new = multiprocessing.get_context("fork").Process(target=self._inside, args=(run, compiled))
        new.start()
        waited = 0.0
        while new.is_alive() and (limit is None or waited < WAITING * limit):
            new.join(1.0)
            waited += 1.0  # a machine that slept meanwhile has waited no longer
        assert new.pid is not None
        with suppress(ProcessLookupError):  # with all that it started
            os.killpg(new.pid, signal.SIGKILL)
        new.join()
        assert new.exitcode is not None
        return new.exitcode

    def _inside(self, run: Callable[[], int], compiled: Path) -> None:
        """In the new process: this copy, no output, low priority, a limit."""
        os.setsid()
        os.nice(10)
        output = os.open(self._log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(output, stream)
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        for name in [name for name in sys.modules if name.split(".")[0] in OWN]:
            del sys.modules[name]
        sys.path[:] = [str(self.folder), *(p for p in sys.path if p not in ("", str(Path.cwd())))]
        os.chdir(self.folder)
        sys.path_importer_cache.clear()
        os.environ["PYTHONPATH"] = str(self.folder)
        os.environ["NUMBA_CACHE_DIR"] = str(compiled)
        settings: Any = import_module("numba.core.config")
        settings.CACHE_DIR = str(compiled)
        with tempfile.TemporaryDirectory() as examples:
            os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = examples
            code = run()
        sys.stdout.flush()
        os._exit(code)


def limit_time(seconds: float) -> None:
    """End this process after so many more seconds of processor time."""
    end = time.process_time() + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (int(end) + 1, resource.RLIM_INFINITY))


_QUIET = (
    "-p", "no:cacheprovider", "-p", "no:xdist", "--hypothesis-seed=0", "--no-header",
    "-W", "ignore::pytest.PytestAssertRewriteWarning",  # hypothesis is loaded already
)  # fmt: skip


def load_packages() -> None:
    """Load what processes of tests have in common."""
    for name in LOADED:
        import_module(name)


def _copy(source: Path, target: Path) -> None:
    """Copy a file with its time, unless it is there: compiled code goes by times."""
    if target.exists() and target.read_bytes() == source.read_bytes():
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy2(source, target)
