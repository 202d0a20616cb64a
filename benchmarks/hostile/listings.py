"""Hostile listings for `equations --against`."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from functools import cache

import testbed as tb
from benchmarks.hostile.case import Case, Change, chance, changed
from benchmarks.hostile.words import NAMES, NUMBERS, SPOILED
from tests.helpers.paths import ROOT

MODEL = str(ROOT / "models/puma562.urdf")
_TOKEN = re.compile(r"[A-Za-z_]\w*|\d+|[-+*=]")
SYMBOLS = (
    "q1", "q2", "q3", "qp1", "qpp3", "S1", "C23", "S_1_m2", "C_1", "K3zz", "mb2z", "g", "l12z",
    "Q1",
    "Q3", "M11", "Fz", "mm1", "K1yz", "x", "a1", "S" + "1" * 200, "C_" + "1_" * 100 + "2",
)  # fmt: skip
OPERATORS = (
    "+",
    "-",
    "*",
    "/",
    "**",
    "^",
    "(",
    ")",
    "=",
    "\n",
    "\n ",
    " ",
    ",",
    "(((",
    ")))",
    "--",
)


@cache
def sources() -> list[str]:
    """Listings to begin with, of both forms."""
    tree = tb.load_tree(MODEL)
    kinds = ["joint-forces", "base-wrench", "mass-matrix", "gravity-forces"]
    whole = [
        tb.write_equations(tb.equations(tree, kinds, form), "paper") for form in ("full", "reduced")
    ]
    short = tb.write_equations(tb.equations(tree, zeros=True), "paper")
    printed = [p.read_text() for p in sorted((ROOT / "docs/listings").glob("*.txt"))]
    return [*whole, short, short, *printed]


def tokens(rng: random.Random, text: str) -> str:
    """Some names, numbers or signs replaced."""
    places = list(_TOKEN.finditer(text))
    for place in sorted(rng.sample(places, min(len(places), rng.randint(1, 4))), key=_end):
        word = rng.choice((*SYMBOLS, *OPERATORS, *NUMBERS, *NAMES))
        text = text[: place.start()] + word + text[place.end() :]
    return text


def _end(place: re.Match[str]) -> int:
    return -place.end()


def lines(rng: random.Random, text: str) -> str:
    """Lines lost, doubled, exchanged."""
    rows = text.splitlines(keepends=True)
    a, b = rng.randrange(len(rows)), rng.randrange(len(rows))
    rows[a], rows[b] = rows[b], rows[a]
    rows.insert(rng.randrange(len(rows) + 1), rng.choice(rows))
    del rows[rng.randrange(len(rows))]
    return "".join(rows)


def grammar(rng: random.Random, text: str) -> str:
    """An equation of random symbols and operators."""
    del text
    return "Q1 = " + "".join(
        rng.choice((*SYMBOLS, *SYMBOLS, *OPERATORS, rng.choice(NUMBERS)))
        for _ in range(rng.choice((5, 30, 1000)))
    )


def expression(rng: random.Random, depth: int) -> str:
    """A well-formed expression."""
    if depth == 0 or rng.random() < 0.2:
        return rng.choice((*SYMBOLS[:12], "2", "0.5", "1e-3", "7"))
    parts = [expression(rng, depth - 1) for _ in range(rng.randint(1, 3))]
    how = rng.randrange(5)
    if how == 0:
        return f"({' + '.join(parts)})^{rng.choice((1, 2, 3, 7, 20))}"
    if how == 1:
        return f"({' - '.join(parts)})/{rng.choice((2, 3, 1e-300, 1e10))}"
    return f"({rng.choice((' + ', '*', ' - ')).join(parts)})"


def large(rng: random.Random, text: str) -> str:
    """Well-formed, and larger than it looks."""
    del text
    count = rng.choice((20, 200, 20_000))
    letter = expression(rng, 1)
    return rng.choice(
        (
            lambda: f"Q1 = {expression(rng, 6)}",
            lambda: f"Q1 = {expression(rng, 12)}",
            lambda: f"Q1 = {letter}{f'*{letter}' * count}",
            lambda: f"Q1 = {letter}{f' + {letter}*q1' * count}",
            lambda: (
                "a0 = q1 + q2\n"
                + "".join(f"a{k + 1} = a{k}*a{k} + {letter}\n" for k in range(min(count, 200)))
                + f"Q1 = a{min(count, 200)}"
            ),
            lambda: (
                f"a0 = {letter}\n"
                + "".join(
                    f"a{k + 1} = a{k} + {k}*{letter}*q{k % 3 + 1}^{k % 20 + 1}\n"
                    for k in range(count)
                )
                + f"Q1 = a{count}"
            ),
            lambda: f"Q1 = {'(' * count}q1{')' * count}",
            lambda: f"Q1 = {'-' * count}q1",
            lambda: f"Q1 = {'9' * count}*q1",
            lambda: f"Q1 = q1^{'9' * count}",
            lambda: (
                "Q1 = " + "*".join(f"(S{'1' * k} + C2{'3' * k})" for k in range(min(count, 40)))
            ),
            lambda: "Q1 = 0\n" + "\n" * count * 100,
        )
    )()


CHANGES: tuple[tuple[str, Change], ...] = (
    *(("tokens", tokens),) * 8,
    *(("lines", lines),) * 3,
    *(("grammar", grammar),) * 3,
    *(("large", large),) * 4,
    *SPOILED,
)


def cases(count: int, seed: int) -> Iterator[Case]:
    """Hostile listings.

    Args:
        count: How many.
        seed: Of all choices.
    """
    for number in range(count):
        rng = chance(seed, "listing", number)
        how, data = changed(rng, rng.choice(sources()), CHANGES)
        options = ["--form", rng.choice(("full", "reduced", "recursive"))]
        options += ["--zeros"] * (rng.random() < 0.5)
        words = ("equations", MODEL, "--against", "listing.txt", *options)
        yield Case(f"listing-{number:04d}", how, words, {"listing.txt": data})
