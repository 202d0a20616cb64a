"""Recordings of which no mapping, or not every line of one, can be right; and a real one.

Each odd recording is held against its robot with the mapping that was planted, and goes to
`--guess` besides. In the TX40's own recording each sense, each exchange of two joints and each
quarter turn of a zero is planted, one at a time.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import testbed as tb
from benchmarks.foreign_recordings import LAYOUTS, Planted, planted, raw_signals
from benchmarks.inverse_recordings import RATE, Truth, tree_of, truth
from benchmarks.judged_mappings import MARKS, right_mapping
from benchmarks.mappings import asked
from benchmarks.mistakes import recorded
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import RecordingError
from testbed.importing.check.check import assess, import_and_check
from testbed.importing.check.remedies import with_lines
from testbed.importing.convert import pieces
from tests.helpers.paths import ROOT

ROBOT = "ur5"

CROSSTALK, DRIFT, LOAD = 0.1, 30.0, 3.0
"""Of one channel on another, relative; of forces [N]; a mass that the file lacks [kg]."""

OPEN = ("equally explained", "do not decide", *MARKS)
"""What is said of explanations that are equal."""

QUARTERS = (np.pi / 2, np.pi, -np.pi / 2)


def _drifting(made: Truth) -> Truth:
    """Forces that wander once up and down; moments as of an arm of .3 m."""
    t = np.arange(len(made.position)) / (RATE * 30)
    phase = np.array([0, 1, 2, 3, 4, 5])
    size = DRIFT / 2 * np.repeat([1, 0.3], 3)
    assert made.wrench is not None
    return replace(made, wrench=made.wrench + size * np.sin(2 * np.pi * t[:, None] + phase))


def _mixed(made: Truth, told: Planted, rng: np.random.Generator) -> Truth:
    """Each of the plate's channels sees a tenth of the others, moments at .3 m."""
    assert made.wrench is not None
    length = np.repeat([1, 0.3], 3)
    mixing = np.eye(6) + CROSSTALK * rng.choice([-1, 1], (6, 6)) * (1 - np.eye(6)) * np.outer(
        length, 1 / length
    )
    inner = told.map @ mixing @ np.linalg.inv(told.map)
    return replace(made, wrench=(made.wrench + told.zero) @ inner.T - told.zero)


def _odd(seed: int, told: Planted) -> Mapping[str, Callable[[], Truth]]:
    """Recordings, by what is odd about them."""
    rng = np.random.default_rng([seed, 5])

    def made(**more: Any) -> Truth:
        return truth(ROBOT, seed, late=told.late, **more)

    def constant() -> Truth:
        one = made(moving=())
        still = np.repeat(one.position[:1], len(one.position), axis=0)
        assert one.wrench is not None
        mean = np.repeat(one.wrench.mean(axis=0)[None], len(still), axis=0)
        return replace(one, position=still, wrench=mean,
                       torque=np.repeat(one.torque[:1], len(still), axis=0))  # fmt: skip

    return {
        "as it should be": made,
        "another robot": lambda: replace(truth("kinova", seed), tree=tree_of(ROBOT)),
        "payload": lambda: made(payload=LOAD),
        "crosstalk": lambda: _mixed(made(), told, rng),
        "drift": lambda: _drifting(made()),
        "constant": constant,
        "one joint moves": lambda: made(moving=(1,)),
        "2 s": lambda: made(seconds=2.0),
        "at rest": lambda: made(moving=()),
    }


def scenarios(seed: int) -> Iterator[dict[str, Any]]:
    """Each odd recording, then those of the TX40.

    Args:
        seed: Of robots, motions and what is planted.
    """
    _, told = planted(ROBOT, "fifteen", "mat", seed)
    for name, made in _odd(seed, told).items():
        yield _scenario(name, made(), told, seed)
    yield from tx40()


def _scenario(name: str, made: Truth, told: Planted, seed: int) -> dict[str, Any]:
    """What the check says of the mapping that was planted, and what --guess makes of the file."""
    with TemporaryDirectory() as folder:
        files = LAYOUTS["mat"](Path(folder), made, raw_signals(made, told), seed)
        path = Path(folder) / "right.toml"
        path.write_text(right_mapping(made, files, told))
        try:
            says, refused = sentences(import_and_check(path, made.tree)[2].diagnostics), False
        except RecordingError as error:
            says, refused = (str(error),), True
        line, text = asked(ROBOT, files, made, told)
    words = " ".join([*says, line.get("said", ""), text]).lower()
    good = {
        "as it should be": not refused and line["result"] == "right",
        "another robot": refused and line["result"] in ("refused", "wrong refused"),
        "payload": not refused and line["result"] == "right",
        "crosstalk": "crosstalk" in words,
        "drift": bool(says) or line["result"] != "wrong accepted",
    }
    held = good.get(name, line["result"] in ("right", "marked", "refused"))
    return {"odd": name, "planted mapping refused": refused, "says": list(says), **line,
            "held": bool(held)}  # fmt: skip


def tx40() -> Iterator[dict[str, Any]]:
    """Each mistake planted in the real recording, and what the check makes of it."""
    made, right = _real()
    columns = {name: values for signal in ("position", "torque")
               for name, values in zip(right[signal]["columns"], getattr(made, signal).T,
                                       strict=True)}  # fmt: skip
    yield _held_against(made, columns, "as given", right, right)
    for words, signal, key, value in _mistakes(made.tree.n, right):
        wrong = {**right, signal: {**right[signal], key: value}}
        yield _held_against(made, columns, words, right, wrong)


def _real() -> tuple[Truth, dict[str, Any]]:
    """The TX40's recording, and a mapping to which nothing is to add."""
    folder = ROOT / "examples/tx40"
    tree = tb.load_tree(folder / "tx40.urdf")
    (recording,), _ = pieces(folder / "tx40.toml")
    ordered = recording.part(0, recording.samples).ordered(tree)
    assert ordered.torque is not None
    made = Truth(tree, np.array(ordered.position), np.array(ordered.torque), None)
    n = tree.n
    right = {"joints": list(tree.names)} | {
        signal: {"source": "log", "columns": [f"{signal}{k}" for k in range(n)], "unit": unit,
                 "sign": [1] * n, "offset": [0.0] * n}
        for signal, unit in (("position", "rad"), ("torque", "N m"))
    }  # fmt: skip
    return made, right


def _mistakes(n: int, right: dict[str, Any]) -> Iterator[tuple[str, str, str, list[Any]]]:
    """In words; table, key and value of the mapping."""
    for signal in ("position", "torque"):
        for k in range(n):
            yield (f"{signal} {k + 1} negative", signal, "sign",
                   [-1 if j == k else 1 for j in range(n)])  # fmt: skip
        for one, other in itertools.combinations(range(n), 2):
            columns = list(right[signal]["columns"])
            columns[one], columns[other] = columns[other], columns[one]
            yield f"{signal}s {one + 1}, {other + 1} exchanged", signal, "columns", columns
    for k, angle in itertools.product(range(n), QUARTERS):
        yield (f"zero of {k + 1} by {np.degrees(angle):.0f} deg", "position", "offset",
               [angle if j == k else 0.0 for j in range(n)])  # fmt: skip


def _held_against(
    made: Truth, columns: dict[str, Array], words: str, right: dict[str, Any], wrong: dict[str, Any]
) -> dict[str, Any]:
    """What the check says first, and whether the recording is right with what it proposes."""
    found = assess(made.tree, recorded(made, columns, wrong))
    lines = [line for remedy in found.remedies for line in remedy.lines]
    one, other = (recorded(made, columns, each) for each in (right, with_lines(wrong, lines)))
    rest = np.asarray(other.position) - np.asarray(one.position)
    zero = (rest.mean(axis=0) + np.pi) % (2 * np.pi) - np.pi
    zero[[0, -1]] = 0  # no data tell
    same = not (np.abs(zero) > 1e-3).any() and np.ptp(rest, axis=0).max() < 1e-4
    same = same and bool(np.allclose(other.measured("torque"), one.measured("torque")))
    text = " ".join(sentences(d for d in found.diagnostics if (d.level == "info") != bool(lines)))
    told_open = any(word in text for word in OPEN)
    result = "right" if same else "open" if told_open else "wrong" if lines else "no word"
    return {
        "tx40": words, "result": result, "certain": bool(found.certain),
        "said": [each.kind + " " + ", ".join(each.joints) for each in found.remedies],
        "undecided": [d.text for d in found.diagnostics if d.level == "info"],
        "held": result != "wrong",
    }  # fmt: skip


def total(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """What all of them say: what is not as it should be, and how many of each result."""
    results = [line["result"] for line in lines if "tx40" in line]
    return {
        "tx40": {each: results.count(each) for each in ("right", "open", "no word", "wrong")},
        "not held": [line.get("odd", line.get("tx40")) for line in lines if not line["held"]],
    }
