"""What a campaign found, by room, for people and for programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.mutation.campaign import ROOT, Plan, Result, campaign, stale
from benchmarks.mutation.draw import draw

FATES = ("killed", "set aside", "survived")

GOAL, ROOM_GOAL = 0.92, 0.80
"""Share of the mutants that tests are to see: of all, and of every room's."""


def run(plan: Plan, *, show: bool, as_json: bool) -> int:
    """The command `mutation`: its exit code, 1 if a complete campaign misses the goal.

    Args:
        plan: What to do.
        show: Draw mutants and print them, try none.
        as_json: Print JSON instead of a table.
    """
    if show:
        for mutant in draw(ROOT, plan.count, plan.seed, plan.room):
            print(mutant)
        return 0
    results, complete = campaign(plan, _silent if as_json else _spoken)
    found = by_room(results)
    if as_json:
        said = [asdict(r.mutant) | {"fate": r.fate, "by": r.by} for r in results]
        whole = {"benchmark": "mutation", **asdict(plan), "complete": complete}
        print(json.dumps(whole | {"rooms": found, "mutants": said}))
    else:
        _print(results, found, complete)
    return 0 if not complete or goals_met(found) else 1


def _spoken(line: str) -> None:
    print(line, flush=True)


def _silent(line: str) -> None:
    pass


def by_room(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Drawn, killed, set aside, survived and the share killed, by room; the last is of all."""
    rooms = sorted({result.mutant.room for result in results})
    lines = []
    for room in [*rooms, "all"]:
        own = [r for r in results if room in (r.mutant.room, "all")]
        count = {fate: sum(r.fate == fate for r in own) for fate in FATES}
        met = count["killed"] + count["survived"]
        share = count["killed"] / met if met else 1.0
        lines.append({"room": room, "drawn": len(own), **count, "share": share})
    return lines


def goals_met(found: Sequence[dict[str, Any]]) -> bool:
    """Whether tests see as many mutants as the project asks."""
    *rooms, whole = found
    return whole["share"] >= GOAL and all(line["share"] >= ROOM_GOAL for line in rooms)


def _print(results: Sequence[Result], found: Sequence[dict[str, Any]], complete: bool) -> None:
    for fate in ("set aside", "survived"):
        print()
        for result in results:
            if result.fate == fate:
                print(result)
    table = Table("room", "drawn", *FATES, "share killed")
    for line in found:
        counts = [str(line[name]) for name in ("drawn", *FATES)]
        table.add_row(line["room"], *counts, f"{line['share']:.0%}")
    Console().print(table)
    for module, function, original, _ in stale():
        print(f"set aside, but no longer there: {module} {function}: {original}")
    if not complete:
        print("not all have been tried yet: the same command goes on")
