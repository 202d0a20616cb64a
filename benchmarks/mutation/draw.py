"""Mutants drawn with a seed, every room in proportion to its statements."""

from __future__ import annotations

import random
from collections import defaultdict
from pathlib import Path

from benchmarks.mutation.changes import Module, Mutant, Statement, room_of

LEAST = 8
"""Mutants that every room gets at least."""


def draw(root: Path, count: int, seed: int, only: str | None = None) -> list[Mutant]:
    """Mutants by chance: a statement first, then one of its changes.

    Args:
        root: The project.
        count: How many; more, where rooms would get too few.
        seed: Of the draw.
        only: All of them of this room.

    Raises:
        ValueError: There is no such room.
    """
    rooms: dict[str, list[tuple[Module, Statement]]] = defaultdict(list)
    for path in sorted((root / "testbed").rglob("*.py")):
        room = room_of(path.relative_to(root).as_posix())
        if only in (None, room):
            module = Module(root, path)
            rooms[room] += [(module, each) for each in module.statements]
    if only is not None and only not in rooms:
        raise ValueError(f"there is no room '{only}' in testbed/")
    sizes = {room: len(found) for room, found in rooms.items() if found}
    shares = shares_of(sizes, count) if only is None else {only: count}
    drawn = []
    for room, share in sorted(shares.items()):
        chance = random.Random(f"{seed} {room}")
        for module, statement in chance.sample(rooms[room], min(share, len(rooms[room]))):
            drawn.append(module.mutant(statement, chance.choice(statement.changes)))
    return sorted(drawn, key=lambda mutant: (mutant.room, mutant.module, mutant.start))


def shares_of(sizes: dict[str, int], count: int) -> dict[str, int]:
    """Whole numbers in proportion to sizes, none below `LEAST`."""
    shares = dict.fromkeys(sizes, LEAST)
    while sum(shares.values()) < count:
        room = max(sizes, key=lambda name: sizes[name] / (shares[name] + 0.5))
        shares[room] += 1
    return shares
