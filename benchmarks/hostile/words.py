"""Words, numbers and spoiled texts that no reader may trust, whatever the format."""

from __future__ import annotations

import random

NUMBERS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e400", "1e-320", "-0.0", "0", "-1", "1e150", "1e20",
    "1e300", "", " ", "3 ", " 3", "3\n", "0x10", "1_000", "٣", "1,5", "1.5.2", "--1", "+1",
    "1 2 3 4 5 6 7", "pi", "${x}", "1e5000", "9" * 5000, "0." + "3" * 5000, "true", "null", "None",
    "1/0", "2147483648", "-9223372036854775809", "1e-5 2", "1d3", "1.0f", "NaN(1)", "Infinity",
)  # fmt: skip
"""Where a number should be."""

NAMES = (
    "", " ", "\x1b[31mred\x1b[0m", "\x9b2J", "\u202eevil\u2066", "\x7f\x08", "a\nb", "a\tb", "\r",
    "../../etc/passwd", "/dev/zero", "/", ".", "nul\u0000", "%s%n%x", "{0}{x!r}", "$(id)", "`id`",
    "'; DROP TABLE", '"', "'", "<b>", "&amp;", "coding: utf-7", "*/", "\\", "é日本\u0663", "\ufeff",
    "\U0001f600" * 3, "x" * 100_000, "q1", "waist", "K1zz", "world", "base", "-",
    "__import__('os')",
    "--help", "#", "a:b", "a/b", "0", "1e5", "nan", "A" * 256, "\udc80",
)  # fmt: skip
"""Where a name should be."""


def junk(rng: random.Random, most: int = 40) -> bytes:
    """Random bytes."""
    return rng.randbytes(rng.randint(1, most))


def truncated(rng: random.Random, text: str) -> str:
    """Only its beginning."""
    return text[: rng.randrange(len(text) + 1)]


def flipped(rng: random.Random, text: str) -> bytes:
    """Some bytes changed."""
    data = bytearray(text.encode("utf-8", "surrogatepass"))
    for _ in range(rng.randint(1, 8)):
        if data:
            data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


def interrupted(rng: random.Random, text: str) -> str:
    """A stretch left out, or doubled."""
    first = rng.randrange(len(text) + 1)
    last = min(len(text), first + rng.randint(1, 200))
    return text[:first] + text[first:last] * rng.choice((0, 2)) + text[last:]


def inserted(rng: random.Random, text: str) -> bytes:
    """Random bytes in the middle."""
    place = rng.randrange(len(text) + 1)
    whole = (text[:place], text[place:])
    before, after = (part.encode("utf-8", "surrogatepass") for part in whole)
    return before + junk(rng) + after


def encoded(rng: random.Random, text: str) -> bytes:
    """In another encoding than it says."""
    name = rng.choice(("utf-16", "utf-32", "latin-1", "utf-8-sig", "utf-7", "cp037", "utf-16-be"))
    return text.encode(name, "replace")


def replaced_name(rng: random.Random, text: str) -> str:
    """A hostile name in the place of some word, everywhere."""
    words = sorted({word for word in text.replace('"', " ").split() if word.isidentifier()})
    return text.replace(rng.choice(words), rng.choice(NAMES)) if words else rng.choice(NAMES)


def long_blank(rng: random.Random, text: str) -> str:
    """A megabyte of blanks or line ends somewhere."""
    place = rng.randrange(len(text) + 1)
    return text[:place] + rng.choice((" ", "\n", "\t")) * 1_000_000 + text[place:]


SPOILED = (
    ("truncated", truncated),
    ("bytes flipped", flipped),
    ("a stretch lost or doubled", interrupted),
    ("junk inserted", inserted),
    ("another encoding", encoded),
    ("words replaced", replaced_name),
    ("blanks", long_blank),
)
"""What can happen to any text."""
