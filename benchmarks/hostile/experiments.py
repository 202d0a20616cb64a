"""Hostile experiments: TOML files and `--set` words with wrong keys, values and depths."""

from __future__ import annotations

import random
import tomllib
from collections.abc import Iterator
from functools import cache
from typing import Any

import tomli_w

from benchmarks.hostile.case import Case, Change, chance, changed
from benchmarks.hostile.words import NAMES, NUMBERS, SPOILED
from tests.helpers.paths import GOLDEN, ROOT

PENDULUM = str(GOLDEN / "robots/pendulum.urdf")
PUMA = str(ROOT / "models/puma562.xml")
QUICK: dict[str, Any] = {
    "motion": {"duration": 1.0, "candidates": 1},
    "simulation": {"step": 1e-3},
}
VALUES = (
    *NUMBERS, "'x'", "[]", "{}", "[[[]]]", "[1, 'a', {}]", "true", "1979-05-27T07:32:00Z",
    "07:32:00", "{a = 1}", "0.0", "-1.0", "1e9", "1e-9", "1e300", '"""', "'''a\nb'''", "inf",
    "0b101",
)  # fmt: skip


@cache
def sources() -> list[dict[str, Any]]:
    """Experiments to begin with, short."""
    found = []
    for path in sorted((ROOT / "experiments").glob("*.toml")):
        content = tomllib.loads(path.read_text())
        if "model" not in content:
            continue  # a comparison of variants of another file
        content["model"] = PUMA
        found.append(_merged(content, QUICK))
    arm = {"name": "pendulum", "model": PENDULUM, "identification": {"zeros": True}}
    return [*found, _merged(arm, QUICK), _merged(arm, QUICK)]


def _merged(content: dict[str, Any], more: dict[str, Any]) -> dict[str, Any]:
    made = dict(content)
    for key, value in more.items():
        made[key] = {**made.get(key, {}), **value}
    return made


def values(rng: random.Random, text: str) -> str:
    """The value of one key replaced."""
    lines = text.splitlines()
    places = [k for k, line in enumerate(lines) if " = " in line]
    if places:
        place = rng.choice(places)
        key, _, _ = lines[place].partition(" = ")
        lines[place] = f"{key} = {rng.choice(VALUES)}"
    return "\n".join(lines) + "\n"


def keys(rng: random.Random, text: str) -> str:
    """A key or table renamed, lost, doubled, or put elsewhere."""
    lines = text.splitlines()
    place = rng.randrange(len(lines))
    line = lines[place]
    key, _, value = line.partition(" = ")
    made = rng.choice(
        (
            [],
            [line, line],
            [f"{key}x = {value}"],
            [f"{quoted(rng.choice(NAMES))} = {value or 1}"],
            [f"[{rng.choice(('motion', 'robot', 'x', 'measurement', 'expect', 'simulation'))}]"],
            [f"{key}.{key} = {value}"],
            [f"[[{key}]]"],
        )
    )
    lines[place : place + 1] = made
    return "\n".join(lines) + "\n"


def quoted(name: str) -> str:
    """A TOML key; some characters cannot stand in one, and then it is no TOML."""
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'


def nested(rng: random.Random, text: str) -> str:
    """Arrays in arrays, tables in tables, keys of a thousand dots."""
    depth = rng.choice((10, 500, 100_000))
    return text + rng.choice(
        (
            f"x = {'[' * depth}{']' * depth}\n",
            f"x = {'{a=' * depth}1{'}' * depth}\n",
            f"{'.'.join('a' * depth)} = 1\n",
            f"[{'.'.join('b' * depth)}]\n",
            "".join(f"k{i} = 1\n" for i in range(depth)),
            "".join(f"[t{i}]\n" for i in range(depth)),
        )
    )


CHANGES: tuple[tuple[str, Change], ...] = (
    *(("values", values),) * 6,
    *(("keys", keys),) * 4,
    ("nesting", nested),
    *SPOILED,
)
SET_KEYS = (
    "motion.duration", "motion.candidates", "motion.harmonics", "motion.amplitude", "seed", "name",
    "model", "simulation.step", "measurement.rate", "measurement.encoder_noise", "robot.lock.waist",
    "robot.weld_root", "identification.cutoff", "identification.zeros", "expect.external_max_z",
    "expect.external_max_z.at_most", "gravity", "measurement.torque_constant_error.waist", "motion",
    "identification.terms", "robot.friction.waist.coulomb", "a.b.c.d.e", "", ".", "..", "=",
    "claim",
    "measurement.encoder_resolution", "expect.nothing.at_most", "motion.seed", "x" * 1000,
)  # fmt: skip


def set_words(rng: random.Random) -> list[str]:
    """One to three `--set` words."""
    words: list[str] = []
    for _ in range(rng.randint(1, 3)):
        value = rng.choice((*VALUES, *NAMES, "[" * 3000 + "]" * 3000, PENDULUM, "off", "full"))
        word = rng.choice(
            (
                f"{rng.choice(SET_KEYS)}={value}",
                f"{rng.choice(SET_KEYS)}={value}",
                rng.choice(SET_KEYS),
                f"{rng.choice(NAMES)}={rng.choice(VALUES)}",
                f"{'.'.join(['a'] * rng.choice((3, 2000)))}=1",
            )
        )
        words += ["--set", word.replace("\0", "")[:60_000].encode("utf-8", "replace").decode()]
    return words


def cases(count: int, seed: int) -> Iterator[Case]:
    """Hostile experiments.

    Args:
        count: How many.
        seed: Of all choices.
    """
    for number in range(count):
        rng = chance(seed, "experiment", number)
        content = rng.choice(sources())
        text = tomli_w.dumps(content)
        how, data, words = "unchanged", text.encode(), []
        if rng.random() < 0.65:
            how, data = changed(rng, text, CHANGES)
        else:
            how, words = "settings", set_words(rng)
        command = ["run", "e.toml", "--out", "out"]
        if rng.random() < 0.2:
            command = ["simulate", "e.toml", "--out", "out.parquet"]
        yield Case(
            f"experiment-{number:04d}",
            how,
            (*command, *words),
            {"e.toml": data},
            ("out", "out.parquet"),
        )
