"""Hostile inputs by Hypothesis: files of every kind that commands read, spoiled."""

from __future__ import annotations

import io
import tomllib
from collections.abc import Sequence
from functools import cache

import numpy as np
import tomli_w
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

import testbed as tb
from benchmarks.hostile.bombs import BOMBS
from benchmarks.hostile.case import Case
from benchmarks.hostile.datasets import (
    IMPORT,
    LEROBOT,
    OUTPUTS,
    TRAPS,
    changed_dataset,
    good,
    mapping_of,
)
from benchmarks.hostile.edits import changed, edited, spoiled, words
from benchmarks.hostile.logs import LOG_TRAPS, Trap, trap
from testbed.core.recordings.formats.parquet import write_table
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
def recorded() -> bytes:
    """A second of the PUMA on its plate, as Parquet."""
    recording = tb.record(tb.Experiment.from_toml(ROOT / "experiments/table6.toml", SHORT))
    sink, columns = io.BytesIO(), recording.columns() | recording.true_columns()
    write_table(sink, recording.units(), recording.metadata.table(), [columns])  # type: ignore[arg-type]
    return sink.getvalue()


@st.composite
def recordings(draw: DrawFn) -> Case:
    """Recordings with wrong types, values, times, names and metadata, and spoiled files."""
    data = recorded()
    data = draw(st.one_of(changed(data), changed(data), spoiled(data)))
    command = draw(
        st.sampled_from(
            [
                ("identify", "--zeros"), ("identify", "--json"),
                ("identify", "--method", "wrench", "--gravity", "0,0,-1"),
                ("identify", "--set", "identification.cutoff=4"),
                ("view", "--save", "out.rrd"), ("report", "--out", "out.html"),
            ]
        )
    )  # fmt: skip
    name, *more = command
    return Case((name, "r.parquet", "--model", PUMA, *more), {"r.parquet": data},
                ("out.rrd", "out.html", "out.json"))  # fmt: skip


@st.composite
def foreign(draw: DrawFn, kinds: Sequence[str]) -> Case:
    """Files of other programs and traps, spoiled, and mappings or guesses of them."""
    kind = draw(st.sampled_from(kinds))
    if kind == "trap":
        kind = draw(st.sampled_from(sorted({*TRAPS, *LOG_TRAPS})))
        found = trap(kind)
        text = mapping_of(found.name)
    else:
        files, text = good(kind)
        name = draw(st.sampled_from(sorted(files)))
        if draw(st.integers(0, 4)) and kind in LEROBOT:
            files = draw(changed_dataset(files))
        elif kind not in LEROBOT:
            files = files | {name: draw(spoiled(files[name]))}
        found = Trap(files, name.partition("/")[0])
    named = () if kind in LEROBOT or kind in TRAPS else (found.name, "map.toml")
    if draw(st.integers(0, 5)) == 0:
        topic = text.replace("[sources.log]", '[sources.log]\ntopic = "episode 1"')
        text, named = draw(edited([text, topic])).decode(errors="replace"), ()
    files = found.files | {"map.toml": text.encode("utf-8", "replace")}
    if draw(st.booleans()):
        guess = ("import", "--guess", found.name, "--out", "guess.toml")
        return Case(guess, files, OUTPUTS, found.links, named[:1])
    return Case(IMPORT, files, OUTPUTS, found.links, named)


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
    "foreign": foreign([*FORMATS, "bag folder"]),
    "datasets": foreign(LEROBOT),
    "logs": foreign(["trap"]),
    "experiments": experiments(),
    "listings": listings(),
}
