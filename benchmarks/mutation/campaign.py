"""A campaign: each mutant meets the tests that can see it; results are kept and go on.

A mutant that was killed stays so while its module and the test that saw it are the same;
one that survived is tried again when any test has changed.
"""

from __future__ import annotations

import json
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from queue import SimpleQueue
from typing import TypeAlias, TypeVar

from benchmarks.mutation.changes import Mutant
from benchmarks.mutation.coverage import HOUSE, Coverage, Test, digest
from benchmarks.mutation.draw import draw
from benchmarks.mutation.workshop import Bench, load_packages

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "build" / "mutation"
EQUIVALENT = ROOT / "benchmarks" / "equivalent_mutants.toml"

PATIENCE, START, COMPILING = 5.0, 60.0, 300.0
"""Time for a test: so many times what it took when traced, and for its fixtures or to start,
and to compile [s]."""

UNFINISHED = "slow tests not met yet"
"""Of a mutant that all others have passed."""

Say: TypeAlias = Callable[[str], None]
"""Called with a line for people."""

Item = TypeVar("Item")
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Result:
    """What became of a mutant.

    Attributes:
        mutant: The change.
        fate: "killed", "survived" or "set aside".
        by: The test that saw it, why it is set aside, or how much of the tests it met.
        chosen: How many tests might have seen it.
    """

    mutant: Mutant
    fate: str
    by: str
    chosen: int

    def __str__(self) -> str:
        """For people."""
        return f"{self.fate:<9} {self.mutant}" + (f"  [{self.by}]" if self.by else "")


@dataclass(frozen=True)
class Plan:
    """What a campaign is to do.

    Attributes:
        count: How many mutants to draw.
        seed: Of the draw.
        room: Only this one's; None for all.
        own: Meet the tests of the mutant's own room only, and those about all rooms: quick.
        jobs: Copies of the project that work at once.
        minutes: After which nothing new is started; None for no end.
        most: Seconds of tests that a mutant meets of the quick, and of the slow; None for all.
    """

    count: int = 200
    seed: int = 0
    room: str | None = None
    own: bool = False
    jobs: int = 2
    minutes: float | None = None
    most: float | None = None


def campaign(plan: Plan, say: Say) -> tuple[list[Result], bool]:
    """Draw mutants and try those that no kept result speaks of.

    Args:
        plan: What to do.
        say: Called with a line for every result.

    Returns:
        What is known so far, and whether that is all.
    """
    mutants = draw(ROOT, plan.count, plan.seed, plan.room)
    aside = set_aside()
    results = [Result(m, "set aside", aside[_saying(m)], 0) for m in mutants if _saying(m) in aside]
    waiting = [m for m in mutants if _saying(m) not in aside]
    kept = {m.key: result for m in waiting if (result := _kept(m))}
    results += (result for result in kept.values() if result.by != UNFINISHED)
    passed = [result.mutant for result in kept.values() if result.by == UNFINISHED]
    waiting = _by_turns([m for m in waiting if m.key not in kept])
    if waiting or passed:
        load_packages()
        rooms = {*(mutant.room for mutant in waiting + passed), HOUSE} if plan.own else None
        shop = Shop(plan, rooms, say)
        for result in shop.try_all(waiting, slow=False):
            if result.by == UNFINISHED:
                passed.append(result.mutant)
            else:
                results.append(result)
        late = list(shop.try_all(passed, slow=True))
        met = {result.mutant.key for result in late}
        results += late
        results += (Result(m, "survived", UNFINISHED, 0) for m in passed if m.key not in met)
    complete = len(results) == len(mutants) and all(r.by != UNFINISHED for r in results)
    return sorted(results, key=lambda r: r.mutant.key), complete


class Shop:
    """Benches at work, until a deadline."""

    def __init__(self, plan: Plan, rooms: Collection[str] | None, say: Say) -> None:
        self._plan, self._say = plan, say
        self._deadline = time.monotonic() + 60 * (plan.minutes or float("inf"))
        self._benches: SimpleQueue[Bench] = SimpleQueue()
        for k in range(plan.jobs):
            self._benches.put(Bench(ROOT, FOLDER / f"copy-{k}"))
        self._coverage = Coverage(ROOT, FOLDER / "coverage", rooms)

    def try_all(self, mutants: Sequence[Mutant], *, slow: bool) -> Iterator[Result]:
        """Results as they come: with the slow tests, or before them with all others.

        Nothing, if there is no time to learn what the tests execute.
        """
        if not mutants or not self._trace(slow):
            return
        tests = self._coverage.tests(slow=slow)
        for result in self._shared(lambda bench, m: self._judged(bench, m, tests, slow), mutants):
            self._say(str(result))
            if result.fate == "killed" or not self._plan.own:
                _keep(result)
            yield result

    def _trace(self, slow: bool) -> bool:
        """See to it that it is known what every test executes; whether it is by now."""

        def trace(bench: Bench, file: str) -> list[str]:
            place = self._coverage.place(file, slow=slow)
            place.unlink(missing_ok=True)
            start = time.monotonic()
            bench.trace(file, place, slow=slow)
            failed = self._coverage.seal(file, slow=slow)
            line = f"traced {file}{', slow tests' * slow}: {time.monotonic() - start:.0f} s"
            return [line, *(f"left out, it fails as things are: {name}" for name in failed)]

        for lines in self._shared(trace, self._coverage.stale(slow=slow)):
            for line in lines:
                self._say(line)
        return not self._coverage.stale(slow=slow)

    def _judged(self, bench: Bench, mutant: Mutant, tests: Sequence[Test], slow: bool) -> Result:
        """What becomes of a mutant that meets tests, those of its own room first."""
        seeing = self._coverage.seeing(mutant, tests)
        if self._plan.own:
            seeing = [test for test in seeing if test.room in (mutant.room, HOUSE)]
        met = _affordable(seeing, self._plan.most)
        compiles = self._coverage.is_compiled(mutant.module)
        more = START + COMPILING * compiles
        bench.change(mutant.module, mutant.applied((ROOT / mutant.module).read_bytes()))
        by = ""
        for part in _stages(met, mutant.room):
            limits = {test.name: more + PATIENCE * test.seconds for test in part}
            by = by or bench.failure(limits, more, compiles=compiles)
        bench.restore()
        if by:
            return Result(mutant, "killed", by, len(seeing))
        said = UNFINISHED if not slow else ""
        if slow and len(met) < len(seeing):
            said = f"{len(met)} of {len(seeing)} slow tests met"
        return Result(mutant, "survived", said, len(seeing))

    def _shared(
        self, work: Callable[[Bench, Item], Answer], items: Sequence[Item]
    ) -> Iterator[Answer]:
        """Answers as they come; what the deadline leaves no time for has none."""

        def one(item: Item) -> Answer | None:
            if time.monotonic() > self._deadline:
                return None
            bench = self._benches.get()
            try:
                return work(bench, item)
            finally:
                self._benches.put(bench)

        with ThreadPoolExecutor(self._plan.jobs) as pool:
            for done in as_completed([pool.submit(one, item) for item in items]):
                answer = done.result()
                if answer is not None:
                    yield answer


def _by_turns(mutants: Sequence[Mutant]) -> list[Mutant]:
    """One of every room, the next of every room: a campaign may be stopped at any time."""
    seen: Counter[str] = Counter()
    turns = []
    for mutant in mutants:
        turns.append((seen[mutant.room], mutant.room, mutant.start, mutant))
        seen[mutant.room] += 1
    return [mutant for *_, mutant in sorted(turns, key=lambda turn: turn[:-1])]


def _affordable(tests: Sequence[Test], most: float | None) -> Sequence[Test]:
    """The first tests that together take no longer than so many seconds."""
    if most is None:
        return tests
    ends = accumulate(test.seconds for test in tests)
    return [test for test, end in zip(tests, ends, strict=True) if end <= most]


def _stages(tests: Sequence[Test], room: str) -> Iterator[Sequence[Test]]:
    """Tests of the room, then the others; each a process of its own."""
    own = [test for test in tests if test.room == room]
    yield from (part for part in (own, [t for t in tests if t.room != room]) if part)


# ----------------------------------------------------------------------------- kept results


def _place(mutant: Mutant) -> Path:
    return FOLDER / "results" / f"{mutant.key}.json"


def _mark(mutant: Mutant, by: str) -> str:
    """What a result depends on: the module, and the test that saw it or all tests."""
    file = ROOT / by.partition("::")[0]
    tests = [file] if by and file.is_file() else sorted((ROOT / "tests").rglob("*.py"))
    return digest(ROOT / mutant.module, *tests)


def _keep(result: Result) -> None:
    place = _place(result.mutant)
    place.parent.mkdir(parents=True, exist_ok=True)
    said = {"fate": result.fate, "by": result.by, "chosen": result.chosen}
    said["mark"] = _mark(result.mutant, result.by)
    fresh = place.with_suffix(".new")  # whole or not at all: campaigns may be stopped
    fresh.write_text(json.dumps(said))
    fresh.replace(place)


def _kept(mutant: Mutant) -> Result | None:
    place = _place(mutant)
    if not place.exists():
        return None
    said = json.loads(place.read_text())
    if said["mark"] != _mark(mutant, said["by"]):
        return None
    return Result(mutant, said["fate"], said["by"], said["chosen"])


def set_aside() -> dict[tuple[str, str, str, str], str]:
    """Changes that change nothing that can be observed, and why; written by hand."""
    found = {}
    for entry in tomllib.loads(EQUIVALENT.read_text())["mutant"]:
        mutated = entry["mutated"]
        for each in [mutated] if isinstance(mutated, str) else mutated:
            place = entry["module"], entry["function"], entry["original"], each
            found[place] = entry["because"]
    return found


def stale() -> list[tuple[str, str, str, str]]:
    """What is set aside of lines that are not there any more."""
    found = []
    for place in set_aside():
        path = ROOT / place[0]
        text = " ".join(path.read_text().split()) if path.is_file() else ""
        if place[2] not in text:
            found.append(place)
    return found


def _saying(mutant: Mutant) -> tuple[str, str, str, str]:
    return mutant.module, mutant.function, mutant.original, mutant.mutated
