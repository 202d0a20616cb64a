"""Hostile files of other programs and mappings: bytes lost, changed, put in; keys, too."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from benchmarks.hostile.case import Case, chance, changed
from benchmarks.hostile.words import NAMES, NUMBERS, junk
from tests.helpers.foreign_files import FORMATS, some_log

KINDS = tuple(name for name in FORMATS if name != "mcap")
"""A folder is no single file; its one file alone is."""

LINES = (
    'file = "../../etc/passwd"', 'file = "/dev/zero"', 'file = "."', 'file = ""', "rate = 1e300",
    "rate = 1e-300", "skew = 0.5", "offset = 1e300", "max_gap = 0", 'topic = "/x"', "steady = true",
    "drop_held = true", "start = 1e9", "stop = 1e-9", "matrix = [[1]]", "matrix = [[1e308, 1e308]]",
    "gain = 0", "sign = [0, 1]", "columns = []", 'unit = ["rad", "mm"]', "place = {}", "delay = 5",
    "tare = [1, 2]", "[gear]\nratio = [1e-300, 1e300]", "[gear]\nmatrix = [[1, 1], [1, 1]]",
)  # fmt: skip
"""Lines that are put into mappings."""


@cache
def base(kind: str) -> tuple[str, bytes, str]:
    """A good file of a format: its name, its bytes, its mapping."""
    with tempfile.TemporaryDirectory() as place:
        text = FORMATS[kind](Path(place), some_log())
        file = max(Path(place).glob("log*"), key=lambda path: (path.is_file(), path.name))
        return file.name, file.read_bytes(), text


def flipped(rng: random.Random, data: bytes) -> bytes:
    """A few bytes changed; those at the ends, where plans are, more often."""
    spoiled = bytearray(data)
    near = rng.choice((len(data), min(len(data), 600), -min(len(data), 600)))
    for _ in range(rng.choice((1, 2, 5, 40))):
        place = rng.randrange(near) if near > 0 else len(data) + rng.randrange(near, 0)
        spoiled[place] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
    return bytes(spoiled)


def spoiled(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """Bytes lost, changed or put in."""
    where = rng.randrange(len(data))
    how = rng.choice(
        ("cut", "flipped", "flipped", "flipped", "put in", "zeros", "doubled", "moved")
    )
    made = {
        "cut": lambda: data[:where],
        "flipped": lambda: flipped(rng, data),
        "put in": lambda: data[:where] + junk(rng) + data[where:],
        "zeros": lambda: data[:where] + b"\0" * rng.choice((1, 100, 10_000)) + data[where:],
        "doubled": lambda: data + data,
        "moved": lambda: data[where:] + data[:where],
    }[how]()
    return made, how


def lines_changed(rng: random.Random, text: str) -> str:
    """A mapping with lines lost, doubled, or others in their places."""
    lines = text.splitlines()
    for _ in range(rng.choice((1, 1, 2, 3))):
        place = rng.randrange(len(lines))
        how = rng.randrange(4)
        if how == 0:
            del lines[place]
        elif how == 1:
            lines.insert(place, rng.choice(LINES))
        elif how == 2:
            key = lines[place].partition("=")[0]
            word = rng.choice((*NUMBERS, f"'{rng.choice(NAMES)}'", "[]", "{}", "true", "[[[]]]"))
            lines[place] = f"{key}= {word}"
        else:
            lines[place] = lines[place].replace("a", rng.choice(NAMES), 1)
    return "\n".join(lines)


def mapping_changed(rng: random.Random, text: str) -> str | bytes:
    """As `Change` has it."""
    return lines_changed(rng, text)


def cases(count: int, seed: int) -> Iterator[Case]:
    """Hostile files and mappings.

    Args:
        count: How many.
        seed: Of all choices.
    """
    for number in range(count):
        rng = chance(seed, "foreign", number)
        kind = KINDS[number % len(KINDS)]
        name, data, text = base(kind)
        how, mapping = kind, text.encode()
        if rng.random() < 0.8:
            data, said = spoiled(rng, data)
            how = f"{kind} {said}"
        if how == kind or rng.random() < 0.1:
            said, mapping = changed(rng, text, (("mapping", mapping_changed),))
            how = f"{how}, {said}"
        words: tuple[str, ...] = ("import", "map.toml", "--out", "out.parquet")
        if rng.random() < 0.15:
            words = ("import", "--guess", name)
        yield Case(
            f"foreign-{number:04d}", how, words, {name: data, "map.toml": mapping}, ("out.parquet",)
        )
