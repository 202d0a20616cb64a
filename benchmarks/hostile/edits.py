"""Changes of texts and bytes by Hypothesis: words, stretches, blocks that parsers dislike."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

WORDS = (
    "nan", "inf", "-inf", "1e308", "1e400", "1e-320", "-0.0", "0", "-1", "1e20", "", " ", "0x10",
    "1_000", "\u0663", "1,5", "1.5.2", "9" * 5000, "true", "null", "1/0", "-9223372036854775809",
    "\x1b[31mred\x1b[0m", "\u202eevil", "a\nb", "\r", "../../etc/passwd", "/dev/zero", ".", "nul\0",
    "%s%n", "{0!r}", "$(id)", "'", '"', "<b>", "&amp;", "coding: utf-7", "*/", "\\", "x" * 100_000,
    "q1", "waist", "world", "--help", "#", "a/b", "\udc80", "[]", "{}", "[[[]]]", "[1, 'a', {}]",
    "{a = 1}", "07:32:00", "'''", "<", ">", "=", "(", ")", "**", "^",
)  # fmt: skip
"""In the place of numbers, names, values and signs."""

BLOCKS = (
    *(f"{'[' * n}{']' * n}" for n in (50, 100_000)), *("(" * n + ")" * n for n in (50, 20_000)),
    *("<x>" * n + "</x>" * n for n in (50, 5_000)), *("{a=" * n for n in (50, 100_000)),
    *(".".join("a" * n) for n in (50, 100_000)), *("-" * n for n in (50, 20_000)),
    *(mark * 100_000 for mark in (" ", "\n", "\t", "[t]\n", "*q1")),
    '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>', '<?xml version="9.9"?>',
    "\ufeff\ufeff", 'file = "/dev/zero"\n', "rate = 1e300\n", "matrix = [[1e308, 1e308]]\n",
    "offset = 1e300\n", "columns = []\n", "place = {}\n", "[gear]\nmatrix = [[1, 1], [1, 1]]\n",
)  # fmt: skip
"""Put in somewhere."""

_TOKEN = re.compile(r"[^\s\"'<>=\[\]{},()]+|\"[^\"\n]*\"")

words: SearchStrategy[str] = st.sampled_from(WORDS)


@st.composite
def edited(draw: DrawFn, texts: Sequence[str]) -> bytes:
    """One of some texts after one to three changes of tokens, lines or stretches, as bytes."""
    text = draw(st.sampled_from(texts))
    for _ in range(draw(st.integers(1, 3))):
        unit = draw(st.sampled_from(["token", "token", "token", "line", "stretch"]))
        where = draw(st.integers(0, 2**31))
        spans = {
            "token": [each.span() for each in _TOKEN.finditer(text)],
            "line": [each.span() for each in re.finditer(r"[^\n]*\n", text)],
            "stretch": [(k, k + 200) for k in range(0, len(text), 50)],
        }[unit] or [(0, len(text))]
        first, last = spans[where % len(spans)]
        again = spans[draw(st.integers(0, 2**31)) % len(spans)]
        kept = text[first:last]
        new = draw(
            st.one_of(
                words, st.just(""), st.just(kept * 2), st.just(text[slice(*again)]),
                st.sampled_from(BLOCKS),
            )
        )  # fmt: skip
        text = text[:first] + new + text[last:]
    encoding = draw(st.sampled_from(["utf-8"] * 9 + ["utf-16", "latin-1", "utf-8-sig", "cp037"]))
    if encoding == "utf-8":
        return text.encode("utf-8", "surrogatepass")
    return text.encode(encoding, "replace")


@st.composite
def spoiled(draw: DrawFn, data: bytes) -> bytes:
    """Bytes lost, changed or put in; more often near the ends, where plans are."""
    near = draw(st.sampled_from([0, max(0, len(data) - 600), None]))
    size = len(data) if near is None else min(len(data), 600)
    place = (near or 0) + draw(st.integers(0, 2**31)) % max(size, 1)
    junk = draw(st.binary(min_size=1, max_size=40))
    return draw(
        st.sampled_from(
            [
                data[:place], data[:place] + junk + data[place + len(junk) :],
                data[:place] + junk + data[place:], data[:place] + bytes(10_000) + data[place:],
                data + data, data[place:] + data[:place],
            ]
        )
    )  # fmt: skip
