"""Which tests can see a mutant: those that execute its lines.

What a module does when it is imported, and what compiled functions do, is in no such map.
It may be seen by all tests that execute a function of the module or of one that imports it.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.mutation.changes import Mutant, room_of

HOUSE = "house"
"""The folder of tests about all rooms: they look at modules without running them."""

COMPILER = "testbed/kernel/compiler.py"
"""What imports it, directly or not, may hold compiled functions."""


@dataclass(frozen=True)
class Test:
    """A test.

    Attributes:
        name: Its node id.
        seconds: Of processor time that it took, traced.
        slow: Whether it is marked so.
        lines: What it executes, by module.
    """

    __test__ = False

    name: str
    seconds: float
    slow: bool
    lines: dict[str, frozenset[int]]

    @property
    def room(self) -> str:
        """The room of testbed/ that it is about, by its folder."""
        return Path(self.name).parts[1]


def digest(*paths: Path) -> str:
    """Of the contents of files."""
    found = hashlib.sha256()
    for path in paths:
        found.update(path.read_bytes() if path.exists() else b"-")
    return found.hexdigest()[:16]


class Coverage:
    """What the tests execute, file by file, kept until a file or what it executes changes."""

    def __init__(self, root: Path, folder: Path, rooms: Collection[str] | None = None) -> None:
        """What is kept in a folder.

        Args:
            root: The project.
            folder: Where the maps are.
            rooms: Whose tests count; None for all.
        """
        self._root, self._folder, self._rooms = root, folder, rooms
        self._imports = {name: set(_imports(root, name)) for name in _modules(root)}
        self._compiled = self._closure(_importers(self._imports, {COMPILER}) | {COMPILER})
        folder.mkdir(parents=True, exist_ok=True)

    def files(self) -> list[str]:
        """All files of tests that count."""
        found = (path.relative_to(self._root) for path in (self._root / "tests").rglob("test_*.py"))
        wanted = (p for p in found if self._rooms is None or p.parts[1] in self._rooms)
        return sorted(path.as_posix() for path in wanted)

    def place(self, file: str, *, slow: bool) -> Path:
        """Where the map of a file of tests is kept: of its slow ones, or of the others."""
        return self._folder / f"{file.replace('/', '-')}{'.slow' * slow}.json"

    def stale(self, *, slow: bool) -> list[str]:
        """Files of tests whose map is wanting; of slow ones where the other says there are."""
        files = self.files()
        if slow:
            files = [
                f for f in files if json.loads(self.place(f, slow=False).read_text())["others"]
            ]
        return [file for file in files if not self._is_fresh(file, slow)]

    def seal(self, file: str, *, slow: bool) -> list[str]:
        """Note what a map that was just made depends on; returns the tests that fail."""
        place = self.place(file, slow=slow)
        if not place.exists():
            raise RuntimeError(f"{file} cannot be traced; see the log beside the copies")
        traced: dict[str, Any] = json.loads(place.read_text())
        modules = {name for lines in traced["lines"] for name in lines}
        traced["needs"] = {name: digest(self._root / name) for name in sorted(modules)}
        traced["self"] = self._self(file)
        place.write_text(json.dumps(traced))
        return [name for name, record in traced["tests"].items() if not record["passed"]]

    def tests(self, *, slow: bool) -> list[Test]:
        """All slow tests that pass, or all others."""
        found = []
        for file in self.files():
            place = self.place(file, slow=slow)
            if not place.exists():
                continue
            traced = json.loads(place.read_text())
            lines = [{name: frozenset(of) for name, of in each.items()} for each in traced["lines"]]
            for name, record in traced["tests"].items():
                if record["passed"]:
                    executed = lines[record["lines"]]
                    found.append(Test(name, record["seconds"], record["slow"], executed))
        return found

    def is_compiled(self, module: str) -> bool:
        """Whether Numba's compiled code depends on a module."""
        return module in self._compiled

    def seeing(self, mutant: Mutant, tests: Sequence[Test]) -> list[Test]:
        """The tests that may see a mutant, those of its room first, then the quickest."""
        lines = range(*mutant.often)
        if lines and mutant.module not in self._compiled:
            found = [t for t in tests if not t.lines.get(mutant.module, _NONE).isdisjoint(lines)]
        else:
            found = self._importing(mutant.module, tests)
            found += [t for t in tests if t.room == HOUSE and not t.slow and t not in found]
        rank: dict[str, int] = defaultdict(int)
        ranked = []
        for test in sorted(found, key=lambda test: test.seconds):
            law = test.name.partition("[")[0]
            ranked.append(
                (
                    test.room not in (mutant.room, HOUSE),
                    rank[law] // 3,
                    test.seconds,
                    test.name,
                    test,
                )
            )
            rank[law] += 1  # of a law that holds for many cases, a few first
        return [test for *_, test in sorted(ranked, key=lambda entry: entry[:-1])]

    def _importing(self, module: str, tests: Sequence[Test]) -> list[Test]:
        """Tests that execute a function of a module or of its nearest importers that have any.

        What nobody imports is started as a program: then those of what it imports itself.
        """
        around = {module} | _importers(self._imports, {module})
        if around == {module}:
            around |= self._imports[module]
        while True:
            found = [test for test in tests if around & test.lines.keys()]
            wider = around | _importers(self._imports, around)
            if found or wider == around:
                return found
            around = wider

    def _closure(self, modules: set[str]) -> set[str]:
        """Modules and all that they import within the kernel."""
        while True:
            more = set().union(*(self._imports[name] for name in modules)) | modules
            more = {name for name in more if room_of(name) == "kernel"}
            if more == modules:
                return modules
            modules = more

    def _self(self, file: str) -> str:
        shared = sorted((self._root / "tests/helpers").glob("*.py"))
        return digest(self._root / file, self._root / "tests/conftest.py", *shared)

    def _is_fresh(self, file: str, slow: bool) -> bool:
        place = self.place(file, slow=slow)
        if not place.exists():
            return False
        traced = json.loads(place.read_text())
        return traced.get("self") == self._self(file) and all(
            digest(self._root / name) == mark for name, mark in traced["needs"].items()
        )


_NONE: frozenset[int] = frozenset()


def _modules(root: Path) -> Iterator[str]:
    for path in sorted((root / "testbed").rglob("*.py")):
        yield path.relative_to(root).as_posix()


def _imports(root: Path, name: str) -> Iterator[str]:
    """The project's modules that one imports, lazily or not."""
    for node in ast.walk(ast.parse((root / name).read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            parts = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            for part in parts:
                path = f"{part.replace('.', '/')}.py"
                if (root / path).is_file():
                    yield path


def _importers(imports: dict[str, set[str]], of: Iterable[str]) -> set[str]:
    wanted = set(of)
    return {name for name, needs in imports.items() if needs & wanted}
