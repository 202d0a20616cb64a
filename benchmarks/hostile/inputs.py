"""Hostile inputs by Hypothesis: files of every kind that commands read, spoiled."""

from __future__ import annotations

import io
import json
import tomllib
from collections.abc import Callable
from functools import cache
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
from benchmarks.hostile.datasets import IMPORT, OUTPUTS, datasets, good
from benchmarks.hostile.edits import edited, spoiled, words
from benchmarks.hostile.logs import logs
from testbed.core.recordings.formats.parquet import KEY, write_table
from tests.helpers.foreign_files import FORMATS
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot

PUMA = str(ROOT / "models/puma562.xml")
SHORT = ("motion.duration=1", "motion.candidates=1", "simulation.step=1e-3")


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
    recording = tb.record(tb.Experiment.from_toml(ROOT / "experiments/table6.toml", SHORT))
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


@st.composite
def foreign(draw: DrawFn) -> Case:
    """Spoiled files of other programs, and mappings."""
    files, text = good(draw(st.sampled_from(sorted(FORMATS))))
    name = draw(st.sampled_from(sorted(files)))
    if draw(st.integers(0, 4)):
        made = files | {name: draw(spoiled(files[name])), "map.toml": text.encode()}
    else:
        made = files | {"map.toml": draw(edited([text]))}
    guess = ("import", "--guess", name.partition("/")[0], "--out", "guess.toml")
    return Case(IMPORT if draw(st.integers(0, 6)) else guess, made, OUTPUTS)


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
