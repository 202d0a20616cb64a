"""Hostile inputs by Hypothesis: files of every kind that commands read, spoiled."""

from __future__ import annotations

import io
import json
import re
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

import testbed as tb
from benchmarks.hostile.bombs import BOMBS
from benchmarks.hostile.case import Case
from benchmarks.hostile.datasets import datasets
from benchmarks.hostile.logs import logs
from testbed.core.recordings.formats.parquet import KEY, write_table
from tests.helpers.foreign_files import FORMATS, some_log
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot

PUMA = str(ROOT / "models/puma562.xml")
SHORT = ("motion.duration=1", "motion.candidates=1", "simulation.step=1e-3")

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
    """One of some texts after one to three changes of tokens, lines or stretches, as bytes.

    Args:
        draw: Hypothesis'.
        texts: To begin with.
    """
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
    """Bytes lost, changed or put in; more often near the ends, where plans are.

    Args:
        draw: Hypothesis'.
        data: To begin with.
    """
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


@cache
def model_texts() -> tuple[tuple[str, str], ...]:
    """Models to begin with: file name and text."""
    files = [*(ROOT / "models").glob("puma*"), *sorted((GOLDEN / "robots").glob("*.urdf"))[:6]]
    made = [random_robot(np.random.default_rng(seed), 3 + seed) for seed in range(3)]
    texts = [each for robot in made for each in (("r.urdf", robot.urdf()), ("r.xml", robot.mjcf()))]
    return (*((f"r{path.suffix}", path.read_text()) for path in files), *texts)


@st.composite
def models(draw: DrawFn) -> Case:
    """Models with wrong numbers, names and structures, and bombs."""
    command = draw(
        st.sampled_from(
            [
                ("minimal",), ("minimal", "--zeros", "--map"), ("minimal", "--json"),
                ("minimal", "--weld-root", "--lock-mimic"), ("minimal", "--verify"),
                ("equations", "--form", "recursive"), ("equations", "--zeros"),
                ("equations", "--language", "c", "--form", "recursive", "--what", "all"),
            ]
        )
    )  # fmt: skip
    if draw(st.integers(0, 9)) == 0:
        files = BOMBS[draw(st.sampled_from(sorted(BOMBS)))]()
    else:
        name, text = draw(st.sampled_from(model_texts()))
        files = {name: draw(edited([text]))}
    return Case((command[0], next(iter(files)), *command[1:]), files)


@cache
def experiment_texts() -> tuple[str, ...]:
    """Experiments to begin with, short."""
    found = []
    for path in sorted((ROOT / "experiments").glob("*.toml")):
        content = tomllib.loads(path.read_text())
        content["model"] = PUMA
        content["motion"] = {**content.get("motion", {}), "duration": 1.0, "candidates": 1}
        content["simulation"] = {**content.get("simulation", {}), "step": 1e-3}
        found.append(tomli_w.dumps(content))
    return tuple(found)


@st.composite
def experiments(draw: DrawFn) -> Case:
    """Experiments with wrong keys, values and depths, in their file and on the command line."""
    command = draw(
        st.sampled_from(
            [("run", "e.toml", "--out", "out"), ("simulate", "e.toml", "--out", "out.parquet")]
        )
    )
    if draw(st.booleans()):
        return Case(command, {"e.toml": draw(edited(experiment_texts()))}, ("out", "out.parquet"))
    text = draw(st.sampled_from(experiment_texts()))
    keys = [line.partition(" = ")[0] for line in text.splitlines() if " = " in line]
    key = draw(st.one_of(st.sampled_from(keys), words))
    table = draw(
        st.sampled_from(["motion.", "simulation.", "measurement.", "robot.", "expect.", ""])
    )
    word = f"{table}{key}={draw(words)}".replace("\0", "").encode("utf-8", "replace").decode()
    return Case((*command, "--set", word[:60_000]), {"e.toml": text.encode()},
                ("out", "out.parquet"))  # fmt: skip


@cache
def recorded() -> pa.Table:
    """A second of the PUMA on its plate."""
    recording = tb.record(tb.Experiment.load(ROOT / "experiments/table6.toml", SHORT))
    sink, columns = io.BytesIO(), recording.columns() | recording.true_columns()
    write_table(sink, recording.units(), recording.metadata, [columns])  # type: ignore[arg-type]
    return pq.read_table(io.BytesIO(sink.getvalue()))


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
    text = (table.schema.metadata or {}).get(KEY.encode(), b"{}").decode()
    made = draw(edited([json.dumps(json.loads(text), indent=place % 2)]))
    return table.replace_schema_metadata({KEY: made})


CHANGES: tuple[Change, ...] = (_values, _values, _type, _names, _rows, _metadata)


@st.composite
def recordings(draw: DrawFn) -> Case:
    """Recordings with wrong types, values, times, names and metadata, and spoiled files."""
    table, sink = recorded(), io.BytesIO()
    for change in draw(st.lists(st.sampled_from(CHANGES), max_size=2)):
        place = draw(st.one_of(st.just(0), st.integers(0, 200))) % max(table.num_columns, 1)
        try:
            table = change(draw, table, place)
        except (pa.ArrowException, ArithmeticError, ValueError, TypeError, IndexError):
            continue  # the change before has left nothing to change
    try:
        pq.write_table(table, sink)
    except (pa.ArrowException, OSError, ValueError):  # what Parquet itself cannot hold
        pq.write_table(recorded(), sink)
    data = sink.getvalue()
    if table is recorded():
        data = draw(spoiled(data))
    command = draw(
        st.sampled_from(
            [
                ("identify", "--zeros"), ("identify", "--json"),
                ("identify", "--method", "external", "--gravity", "0,0,-1"),
                ("identify", "--set", "identification.cutoff=4"),
                ("view", "--save", "out.rrd"), ("report", "--out", "out.html"),
            ]
        )
    )  # fmt: skip
    name, *more = command
    return Case((name, "r.parquet", "--model", PUMA, *more), {"r.parquet": data},
                ("out.rrd", "out.html", "out.json"))  # fmt: skip


@cache
def foreign_file(kind: str) -> tuple[str, bytes, str]:
    """A good file of a format: its name, its bytes, its mapping."""
    with tempfile.TemporaryDirectory() as place:
        text = FORMATS[kind](Path(place), some_log())
        file = max(Path(place).glob("log*"), key=lambda path: (path.is_file(), path.name))
        return file.name, file.read_bytes(), text


@st.composite
def foreign(draw: DrawFn) -> Case:
    """Spoiled files of other programs, and mappings."""
    kinds = [name for name in FORMATS if name != "mcap"]  # a folder; its one file alone is there
    name, data, text = foreign_file(draw(st.sampled_from(kinds)))
    files = {name: data, "map.toml": text.encode()}
    if draw(st.integers(0, 4)):
        files[name] = draw(spoiled(data))
    else:
        files["map.toml"] = draw(edited([text]))
    command: tuple[str, ...] = ("import", "map.toml", "--out", "out.parquet")
    if draw(st.integers(0, 6)) == 0:
        command = ("import", "--guess", name, "--out", "guess.toml")
    return Case(command, files, ("out.parquet", "guess.toml"))


@cache
def listing_texts() -> tuple[str, ...]:
    """Listings to begin with, of both forms."""
    tree = tb.load_tree(ROOT / "models/puma562.urdf")
    kinds = ["joint-forces", "base-wrench", "mass-matrix"]
    made = [tb.write_equations(tb.equations(tree, kinds, f), "paper") for f in ("full", "reduced")]
    return (*made, "Q1 = (S1 + C23)^7*q1 - K3zz/2\nQ2 = Q1*Q1\n", "a = q1\nQ1 = a + a*a\n")


@st.composite
def listings(draw: DrawFn) -> Case:
    """Hostile listings for `equations --against`."""
    form = draw(st.sampled_from(["full", "reduced", "recursive"]))
    command = ("equations", str(ROOT / "models/puma562.urdf"), "--against", "listing.txt")
    return Case((*command, "--form", form), {"listing.txt": draw(edited(listing_texts()))})


KINDS: dict[str, SearchStrategy[Case]] = {
    "models": models(),
    "recordings": recordings(),
    "foreign": foreign(),
    "datasets": datasets(),
    "logs": logs(),
    "experiments": experiments(),
    "listings": listings(),
}
