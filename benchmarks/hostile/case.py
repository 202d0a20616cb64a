"""One hostile input: files in a folder, and a command that is to take or refuse them."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

Text: TypeAlias = str | bytes
Change: TypeAlias = Callable[[random.Random, str], Text]


@dataclass(frozen=True)
class Case:
    """One hostile input.

    Attributes:
        name: Such as model-0017; made of the same numbers, it is the same case.
        how: What is hostile about it.
        words: The command line, in the case's folder.
        files: What lies there, by name.
        outputs: What the command may leave there.
    """

    name: str
    how: str
    words: tuple[str, ...]
    files: dict[str, bytes] = field(default_factory=dict)
    outputs: tuple[str, ...] = ()


def chance(seed: int, kind: str, number: int) -> random.Random:
    """The random numbers of one case, which depend on no other case."""
    return random.Random(f"{seed}/{kind}/{number}")


def changed(
    rng: random.Random, text: str, changes: Sequence[tuple[str, Change]]
) -> tuple[str, bytes]:
    """A text after one to three changes, and what they are called."""
    names = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if not text:
            break
        name, change = rng.choice(changes)
        names.append(name)
        made = change(rng, text)
        if isinstance(made, bytes):  # no text any more
            return ", ".join(names), made
        text = made
    return ", ".join(names), text.encode("utf-8", "surrogatepass")
