"""Hostile recordings: Parquet files with wrong types, values, times, names, metadata and bytes."""

from __future__ import annotations

import io
import json
import math
import random
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import testbed as tb
from benchmarks.hostile.case import Case, chance
from benchmarks.hostile.words import NAMES, NUMBERS, junk
from testbed.recordings.formats.parquet import KEY, write_table
from tests.helpers.paths import ROOT

MODEL = str(ROOT / "models/puma562.xml")
SETTINGS = ("motion.duration=3", "simulation.step=1e-3", "motion.candidates=1")
VALUES = (
    math.nan, math.inf, -math.inf, 1e308, -1e300, 1e13, 1e-320, 0.0, -0.0, 1e150, 5e-324, 2.0**63,
)  # fmt: skip


@cache
def base() -> pa.Table:
    """Three seconds of the PUMA on its plate."""
    experiment = tb.Experiment.load(ROOT / "experiments/table6.toml", SETTINGS)
    recording = tb.simulate(experiment)
    columns = recording.columns() | recording.true_columns()
    sink = io.BytesIO()
    write_table(sink, recording.units(), recording.metadata, [columns])  # type: ignore[arg-type]
    return pq.read_table(io.BytesIO(sink.getvalue()))


def types() -> list[pa.DataType]:
    """Of a column that should hold doubles."""
    return [
        pa.int8(), pa.int64(), pa.uint64(), pa.float16(), pa.float32(), pa.bool_(), pa.null(),
        pa.string(), pa.string_view(), pa.large_string(), pa.binary(), pa.binary(8),
        pa.date32(), pa.time64("us"), pa.timestamp("ns"), pa.timestamp("s", tz="UTC"),
        pa.duration("ms"), pa.decimal128(30, 5), pa.decimal256(60, 5), pa.month_day_nano_interval(),
        pa.list_(pa.float64()), pa.list_(pa.float64(), 1), pa.struct({"x": pa.float64()}),
        pa.map_(pa.string(), pa.float64()), pa.dictionary(pa.int8(), pa.float64()),
        pa.dictionary(pa.int32(), pa.string()),
    ]  # fmt: skip


def some_column(rng: random.Random, table: pa.Table) -> int:
    """Time most often: everything hangs on it."""
    return 0 if rng.random() < 0.3 else rng.randrange(table.num_columns)


def another_type(rng: random.Random, table: pa.Table) -> pa.Table:
    """One column of another type."""
    place = some_column(rng, table)
    field = table.schema.field(place)
    values = table.column(place).to_pylist()
    kind = rng.choice(types())
    array = pa.nulls(len(values), kind)
    ways: tuple[Callable[[float], Any], ...] = (
        float,
        lambda value: int(value * 1000),
        str,
        lambda value: [value],
        lambda value: {"x": value},
        lambda value: str(value).encode()[:8].ljust(8),
    )
    for way in ways:
        try:
            array = pa.array([way(value) for value in values], kind, safe=False)
            break
        except (pa.ArrowException, TypeError, ValueError, OverflowError, AttributeError):
            continue  # stays without values
    return table.set_column(place, pa.field(field.name, array.type, metadata=field.metadata), array)


def values(rng: random.Random, table: pa.Table) -> pa.Table:
    """Some values of a column, or all, that no instrument reads."""
    place = some_column(rng, table)
    column = table.column(place).to_numpy().astype(float).copy()
    value = rng.choice(VALUES)
    how = rng.randrange(4)
    with np.errstate(all="ignore"):
        if how == 0:
            column[rng.randrange(len(column))] = value
        elif how == 1:
            column[:] = value
        elif how == 2:
            column *= value
        else:
            column += value
    return table.set_column(place, table.schema.field(place), pa.array(column))


def nulls(rng: random.Random, table: pa.Table) -> pa.Table:
    """Places where nothing was measured."""
    place = some_column(rng, table)
    column = table.column(place).to_pylist()
    for k in rng.sample(range(len(column)), rng.choice((1, len(column)))):
        column[k] = None
    array = pa.array(column, pa.float64())
    return table.set_column(place, table.schema.field(place), array)


def times(rng: random.Random, table: pa.Table) -> pa.Table:
    """Time that stands, runs back, jumps, or is too fine or too coarse."""
    count = table.num_rows
    time = table.column(0).to_numpy().copy()
    noise = np.random.default_rng(rng.randrange(2**32))
    time = rng.choice(
        (
            time[::-1].copy,
            lambda: noise.permutation(time),
            lambda: np.full(count, rng.choice(VALUES)),
            lambda: time * rng.choice((1e-300, 1e300, -1.0, 1e9, 1e-9)),
            lambda: time + rng.choice((1e300, -1e9, 1e18)),
            lambda: np.repeat(time[::2], 2)[:count],
            lambda: np.cumsum(noise.exponential(1e-3, count)),
            lambda: np.concatenate([time[: count // 2], time[count // 2 :] + 1e6]),
        )
    )()
    return table.set_column(0, table.schema.field(0), pa.array(np.resize(time, count)))


def names(rng: random.Random, table: pa.Table) -> pa.Table:
    """Columns renamed, doubled, in another order, or thousands of them."""
    old = list(table.column_names)
    how = rng.randrange(6)
    place = rng.randrange(len(old))
    if how == 0:
        old[place] = rng.choice(NAMES).encode("utf-8", "replace").decode()
    elif how == 1:
        old[place] = rng.choice(old)
    elif how == 2:
        signal, _, _ = old[place].partition("/")
        old[place] = f"{signal}/{rng.choice(NAMES).encode('utf-8', 'replace').decode()}"
    elif how == 3:
        return table.select(rng.sample(range(len(old)), len(old)))
    elif how == 4:
        return table.select(rng.sample(range(len(old)), rng.randrange(len(old))))
    else:
        zero = pa.array(np.zeros(table.num_rows))
        for k in range(rng.choice((50, 2000))):
            table = table.append_column(f"{rng.choice(('position', 'x', 'torque'))}/j{k}", zero)
        return table
    return table.rename_columns(old)


def rows(rng: random.Random, table: pa.Table) -> pa.Table:
    """No samples, one, a few, or a million."""
    count = rng.choice((0, 1, 2, 3, 5, 30, 200, 1_000_000))
    if count <= table.num_rows:
        return table.slice(rng.randrange(table.num_rows), count)
    return pa.concat_tables([table] * (count // table.num_rows))


def deep(depth: int) -> str:
    """JSON of lists in lists."""
    return "[" * depth + "]" * depth


def metadata(rng: random.Random, table: pa.Table) -> pa.Table:
    """What the file says of itself, by another type, or no JSON at all."""
    text = (table.schema.metadata or {}).get(KEY.encode(), b"{}").decode()
    content = json.loads(text)
    how = rng.randrange(5)
    if how == 0:
        text = rng.choice(
            ("", "{", "null", "[]", '"x"', "NaN", deep(100_000), '{"tare": 1' + "0" * 400 + "}",
             '{"facts": ' + deep(900) + "}", '{"format": "another"}', "\x00", "x" * 20_000_000)
        )  # fmt: skip
    elif how == 1:
        text = text[: rng.randrange(len(text))]
    else:
        _spoil(rng, content, 0)
        text = json.dumps(content)
    return table.replace_schema_metadata({KEY: text})


def _spoil(rng: random.Random, content: Any, depth: int) -> None:
    """Something else in the place of a value somewhere."""
    places = list(content) if isinstance(content, dict) else range(len(content))
    if not places:
        return
    place = rng.choice(list(places))
    inner = content[place]
    if isinstance(inner, dict | list) and inner and rng.random() < 0.75:
        _spoil(rng, inner, depth + 1)
        return
    content[place] = rng.choice(
        (None, True, -1, 1e308, 10**400, "x", "", [], {}, [None], {"a": {}}, [1, 2, 3], [[1.0]],
         math.nan, math.inf, rng.choice(NAMES), rng.choice(NUMBERS), ["a"] * 1000, 1 + 10**18)
    )  # fmt: skip


CHANGES = (
    (another_type, 4), (values, 5), (nulls, 2), (times, 5), (names, 4), (rows, 2), (metadata, 6),
)  # fmt: skip
COMMANDS = (
    ("identify", "r.parquet", "--model", MODEL, "--zeros"),
    ("identify", "r.parquet", "--model", MODEL, "--json"),
    ("identify", "r.parquet", "--model", MODEL, "--method", "external", "--gravity", "0,0,-1"),
    ("identify", "r.parquet", "--model", MODEL, "--set", "identification.weights=full"),
)  # fmt: skip
PICTURES = (
    ("view", "r.parquet", "--model", MODEL, "--save", "out.rrd"),
    ("report", "r.parquet", "--model", MODEL, "--out", "out.html"),
)
OPTIONS = (
    "cutoff", "position_cutoff", "deadband", "zeros", "terms", "weights", "x", "external", "tare",
)  # fmt: skip


def stored(rng: random.Random, table: pa.Table) -> bytes:
    """A Parquet file, in one of its ways."""
    sink = io.BytesIO()
    options: dict[str, Any] = {
        "compression": rng.choice(("zstd", "none", "snappy", "gzip")),
        "row_group_size": rng.choice((None, 1000, 7)) if table.num_rows < 10_000 else None,
        "version": rng.choice(("1.0", "2.6")),
    }
    try:
        pq.write_table(table, sink, **options)
    except (pa.ArrowException, OSError, ValueError):  # what Parquet itself cannot hold
        pq.write_table(base(), sink)
    return sink.getvalue()


IMPOSSIBLE = (
    pa.ArrowException, ValueError, TypeError, IndexError, OverflowError, RecursionError,
    ZeroDivisionError,
)  # fmt: skip
"""What a change says of a recording that another change has spoiled."""


def cases(count: int, seed: int) -> Iterator[Case]:
    """Hostile recordings.

    Args:
        count: How many.
        seed: Of all choices.
    """
    changes, weights = zip(*CHANGES, strict=True)
    for number in range(count):
        rng = chance(seed, "recording", number)
        table, how = base(), []
        if rng.random() < 0.85:
            for change in rng.choices(changes, weights, k=rng.choice((1, 1, 2))):
                try:
                    table = change(rng, table)
                except IMPOSSIBLE:
                    continue  # the one before has left nothing to change
                how.append(change.__name__)
        data = stored(rng, table)
        if not how:
            data, said = spoiled(rng, data)
            how.append(said)
        words = rng.choice(COMMANDS) if rng.random() < 0.95 else rng.choice(PICTURES)
        if words[0] == "identify" and rng.random() < 0.1:
            value = rng.choice((*NUMBERS, "off", "[]", "{}", "['x']", rng.choice(NAMES)))
            word = f"identification.{rng.choice(OPTIONS)}={value}".replace("\0", "")[:50_000]
            words = (*words, "--set", word)
            how.append("settings")
        yield Case(
            f"recording-{number:04d}",
            ", ".join(name.replace("_", " ") for name in how),
            words,
            {"r.parquet": data},
            ("out.rrd", "out.html", "out.json"),
        )


def spoiled(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """Bytes lost, changed or put in; the end of the file, where its plan is, more often."""
    where = rng.randrange(max(0, len(data) - 3000), len(data)) if rng.random() < 0.7 else None
    where = rng.randrange(len(data)) if where is None else where
    how = rng.choice(("truncated", "flipped", "inserted", "zeros", "plan only", "doubled"))
    if how == "truncated":
        return data[:where], how
    if how == "inserted":
        return data[:where] + junk(rng) + data[where:], how
    if how == "zeros":
        return b"\0" * rng.choice((0, 4, 8, 100_000)), how
    if how == "plan only":
        return data[-3000:], how
    if how == "doubled":
        return data + data, how
    changed = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        changed[min(len(data) - 1, where + rng.randrange(30))] = rng.randrange(256)
    return bytes(changed), how
