"""Changes of texts, bytes and tables by Hypothesis: words, blocks, values that parsers dislike."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from testbed.core.recordings.formats.parquet import METADATA_KEY

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


COLUMNS: tuple[Callable[[int], pa.Array], ...] = (
    pa.nulls, lambda n: pa.array(["x"] * n), lambda n: pa.array([[]] * n),
    lambda n: pa.array([[1.0]] * (n - 1) + [[1.0, 2.0]]), lambda n: pa.array([[1.0, 2.0]] * n),
    lambda n: pa.array([[None, 1.0]] * n), lambda n: pa.array([[[1.0]], *[[]] * (n - 1)]),
    lambda n: pa.array([{"a": 1.0}] * n), lambda n: pa.array([float("nan")] * n),
    lambda n: pa.array([2**63 - 1] * n), lambda n: pa.array([1e308] * n),
    lambda n: pa.array(range(n, 0, -1)), lambda n: pa.array([b"\0"] * n),
    lambda n: pa.array([0] * (n // 2) + [1] * (n - n // 2 - 1) + [0]),
)  # fmt: skip
"""In the place of a column."""


Change = Callable[[DrawFn, pa.Table, int], pa.Table]


def _values(draw: DrawFn, table: pa.Table, place: int) -> pa.Table:
    """Values that no instrument reads, in a column or a place of it."""
    column = table.column(place).to_numpy().astype(float).copy()
    value = draw(st.sampled_from([np.nan, np.inf, 1e308, 1e13, 5e-324, 0.0, -1.0, 2.0**63]))
    with np.errstate(all="ignore"):
        how: dict[str, Callable[[], Any]] = {
            "one": lambda: np.where(np.arange(len(column)) == len(column) // 2, value, column),
            "all": lambda: np.full(len(column), value),
            "times": lambda: column * value,
            "plus": lambda: column + value,
            "back": lambda: column[::-1],
            "doubled": lambda: np.repeat(column[::2], 2)[: len(column)],
        }
        made = how[draw(st.sampled_from(sorted(how)))]()
    return table.set_column(
        place, table.schema.field(place), pa.array(np.resize(made, len(column)))
    )


def _type(draw: DrawFn, table: pa.Table, place: int) -> pa.Table:
    """A column of another type, or of nothing."""
    kinds = [
        pa.int8(), pa.uint64(), pa.float16(), pa.bool_(), pa.null(), pa.string(), pa.binary(8),
        pa.timestamp("ns"), pa.duration("ms"), pa.decimal128(30, 5), pa.list_(pa.float64()),
        pa.struct({"x": pa.float64()}), pa.dictionary(pa.int8(), pa.float64()),
    ]  # fmt: skip
    array = pa.nulls(table.num_rows, draw(st.sampled_from(kinds)))
    if draw(st.booleans()):
        array = pa.array([str(value) for value in table.column(place).to_pylist()])
    return table.set_column(place, pa.field(table.column_names[place], array.type), array)


def _names(draw: DrawFn, table: pa.Table, place: int) -> pa.Table:
    """Columns renamed, doubled, left out or in another order."""
    names = list(table.column_names)
    names[place] = draw(st.one_of(words, st.sampled_from(names)))
    names[place] = names[place].encode("utf-8", "replace").decode()
    renamed = table.rename_columns(names)
    return (
        renamed if draw(st.booleans()) else table.select(draw(st.permutations(range(len(names)))))
    )


def _rows(draw: DrawFn, table: pa.Table, place: int) -> pa.Table:
    """Few samples, or many times as many."""
    count = draw(st.sampled_from([0, 1, 2, 5, 30, 200, 300_000]))
    few = table.slice(place, count)
    return few if count < table.num_rows else pa.concat_tables([table] * (count // table.num_rows))


def _metadata(draw: DrawFn, table: pa.Table, place: int) -> pa.Table:
    """What the file says of itself, as other JSON or none."""
    text = (table.schema.metadata or {}).get(METADATA_KEY.encode(), b"{}").decode()
    made = draw(edited([json.dumps(json.loads(text), indent=place % 2)]))
    return table.replace_schema_metadata({METADATA_KEY: made})


def _columns(draw: DrawFn, table: pa.Table, place: int) -> pa.Table:
    """Another column, fewer or one more."""
    made = draw(st.sampled_from(COLUMNS))(table.num_rows)
    how = draw(st.sampled_from(["other", "other", "without", "twice"]))
    if how == "without":
        return table.remove_column(place)
    if how == "twice":
        return table.append_column(table.column_names[place], made)
    return table.set_column(place, table.column_names[place], made)


CHANGES: tuple[Change, ...] = (_values, _values, _type, _names, _rows, _metadata, _columns)


@st.composite
def changed(draw: DrawFn, data: bytes) -> bytes:
    """A Parquet file after one or two changes of its table."""
    table, sink = pq.read_table(io.BytesIO(data)), io.BytesIO()
    for change in draw(st.lists(st.sampled_from(CHANGES), min_size=1, max_size=2)):
        place = draw(st.one_of(st.just(0), st.integers(0, 200))) % max(table.num_columns, 1)
        try:
            table = change(draw, table, place)
        except (pa.ArrowException, ArithmeticError, ValueError, TypeError, IndexError):
            continue  # the change before has left nothing to change
    try:
        pq.write_table(table, sink)
    except (pa.ArrowException, OSError, ValueError):  # what Parquet itself cannot hold
        return data
    return sink.getvalue()
