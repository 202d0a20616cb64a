"""The mutation check draws what it says it draws (`python -m benchmarks mutation`)."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.mutation.campaign import set_aside
from benchmarks.mutation.changes import Mutant
from benchmarks.mutation.draw import LEAST, draw, shares_of
from benchmarks.mutation.tracer import FOLDER
from tests.helpers.paths import ROOT


@pytest.fixture(scope="module")  # every module is read: some seconds
def mutants() -> list[Mutant]:
    return draw(ROOT, 150, seed=1)


@pytest.mark.slow
def test_a_seed_draws_the_same_and_another_others() -> None:
    one, same, other = (draw(ROOT, 20, seed, only="excitation") for seed in (1, 1, 2))
    assert one == same
    assert {mutant.key for mutant in one} != {mutant.key for mutant in other}
    with pytest.raises(ValueError, match="no room 'attic'"):
        draw(ROOT, 20, 1, only="attic")


def spoken(tree: ast.Module) -> Iterator[str]:
    """What says nothing to a program: docstrings, annotations, errors' messages, imports."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.FunctionDef, ast.ClassDef)):
            yield ast.get_docstring(node) or ""
        if isinstance(node, ast.FunctionDef):
            yield ast.unparse(node.returns) if node.returns else ""
        if isinstance(node, (ast.arg, ast.AnnAssign)) and node.annotation:
            yield ast.unparse(node.annotation)
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield ast.unparse(node)


@pytest.mark.slow
def test_a_mutant_is_one_change_that_a_program_can_tell(mutants: list[Mutant]) -> None:
    for mutant in mutants:
        source = (ROOT / mutant.module).read_bytes()
        before, after = ast.parse(source), ast.parse(mutant.applied(source))
        assert ast.dump(before) != ast.dump(after), mutant
        assert list(spoken(before)) == list(spoken(after)), mutant
        assert mutant.original != mutant.mutated
        assert source[: mutant.start].count(b"\n") + 1 == mutant.line


@pytest.mark.slow
def test_every_room_has_its_share(mutants: list[Mutant]) -> None:
    drawn = Counter(mutant.room for mutant in mutants)
    assert len({mutant.key for mutant in mutants}) == len(mutants)
    assert min(drawn.values()) >= LEAST
    assert drawn["kernel"] > drawn["arrays"] == 0
    assert {"base", "dynamics", "kernel", "symbolic", "cli"} <= drawn.keys()


def test_shares_are_in_proportion_but_for_the_smallest() -> None:
    shares = shares_of({"large": 3000, "half": 1500, "tiny": 10}, 100)
    assert sum(shares.values()) == 100
    assert shares["tiny"] == LEAST
    assert shares["large"] == pytest.approx(2 * shares["half"], abs=2)


def test_what_is_set_aside_has_a_reason() -> None:
    for (module, _, original, mutated), reason in set_aside().items():
        assert (ROOT / module).is_file(), module
        assert original != mutated
        assert len(reason.split()) > 2


FOLLOWED = """def sign(number):
    if number < 0:
        return -1
    return [0, 1][sum(1 for _ in range(1) if number)]


class Room:
    def enter(self):
        return sign(3)
"""
FOLLOWING = """import json, pathlib, sys
from benchmarks.mutation import tracer
from testbed import rooms

told = {}
for kind in ("Asking", "Told"):
    if hasattr(tracer, kind):
        followed = getattr(tracer, kind)(pathlib.Path(sys.argv[1]))
        followed.start()
        told[kind] = []
        for call in (lambda: rooms.sign(-2), rooms.Room().enter, lambda: rooms.sign(-1)):
            lines = set()
            with followed.collecting(lines):
                followed.start()
                call()
            told[kind].append(sorted(lines))
        followed.stop()
print(json.dumps(told))
"""


def test_lines_are_told_anew_for_every_test_by_whatever_follows_them(tmp_path: Path) -> None:
    (tmp_path / "testbed").mkdir()
    (tmp_path / "testbed/__init__.py").touch()
    (tmp_path / "testbed/rooms.py").write_text(FOLLOWED)
    around = {name: value for name, value in os.environ.items() if name != FOLDER}
    around["PYTHONPATH"] = os.pathsep.join([str(tmp_path), str(ROOT)])
    command = [sys.executable, "-S", "-c", FOLLOWING, str(tmp_path)]
    printed = subprocess.run(
        command, cwd=tmp_path, env=around, check=True, capture_output=True, text=True
    )
    told = json.loads(printed.stdout)
    assert ("Told" in told) == (sys.version_info >= (3, 12))
    negative, positive = [1, 2, 3], [1, 2, 4, 8, 9]
    for lines in told.values():
        assert [[line for _, line in each] for each in lines] == [negative, positive, negative]
        assert {module for each in lines for module, _ in each} == {"testbed/rooms.py"}
