"""Mistakes planted in a mapping of a real recording, and what the check makes of them.

Each sense, each exchange of two joints and each quarter turn of a zero is planted in the mapping of
the TX40's own recording, one at a time.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import typer

import testbed as tb
from benchmarks.judged_mappings import MARKS
from benchmarks.lines import print_lines
from testbed.core.base.diagnostics import sentences
from testbed.core.recordings.metadata import Metadata
from testbed.importing.check.assessment import assess_recording
from testbed.importing.check.remedies import mapping_with_lines
from testbed.importing.convert import import_recordings
from testbed.importing.encoder_steps import unwrapped_positions
from testbed.importing.foreign_table import JOINT_QUANTITIES
from testbed.importing.mapping import SignalTable
from testbed.importing.signal_maps import EFFORT_OF_UNIT, joint_signal
from tests.helpers.paths import ROOT

OPEN = ("equally explained", "do not decide", "not distinguish", *MARKS)
"""What is said of explanations that are equal."""

QUARTERS = (np.pi / 2, np.pi, -np.pi / 2)


def tx40() -> Iterator[dict[str, Any]]:
    """Each mistake planted in the real recording, and what the check makes of it."""
    folder = ROOT / "examples/tx40"
    tree = tb.load_tree(folder / "tx40.urdf")
    (pieced,), _ = import_recordings(folder / "tx40.toml")
    real = pieced.part(0, pieced.samples).ordered(tree)
    right = mapping_of(tree, real)
    yield _held_against(tree, real, "as given", right, right)
    for words, signal, key, value in _mistakes(tree.n, right):
        wrong = {**right, signal: {**right[signal], key: value}}
        yield _held_against(tree, real, words, right, wrong)


def mapping_of(tree: tb.Tree, real: tb.Recording) -> dict[str, Any]:
    """A mapping that leaves a recording's columns as they are.

    Args:
        tree: The robot.
        real: Its recording, the joints in the tree's order.
    """
    slides = np.array([not joint.revolute for joint in tree.joints])
    units = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "torque": ("N m", "N")}
    return {"joints": list(tree.names)} | {
        signal: {"source": "log", "columns": [f"{k}" for k in range(tree.n)],
                 "unit": np.where(slides, *pair[::-1]).tolist(), "sign": [1] * tree.n,
                 "offset": [0.0] * tree.n}
        for signal, pair in units.items() if signal in real.signals
    }  # fmt: skip


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
    tree: tb.Tree, real: tb.Recording, words: str, right: dict[str, Any], wrong: dict[str, Any]
) -> dict[str, Any]:
    """What the check says first, and whether the recording is right with what it proposes."""
    found = assess_recording(tree, recorded(real, wrong))
    lines = [line for remedy in found.remedies for line in remedy.lines]
    one, other = (recorded(real, each) for each in (right, mapping_with_lines(wrong, lines)))
    rest = np.asarray(other.position) - np.asarray(one.position)
    zero = (rest.mean(axis=0) + np.pi) % (2 * np.pi) - np.pi
    zero[[0, -1]] = 0  # no data tell
    same = not (np.abs(zero) > 1e-3).any() and np.ptp(rest, axis=0).max() < 1e-4
    same = same and bool(np.allclose(other.measured("torque"), one.measured("torque")))
    said = (d for d in found.diagnostics
            if d.code == "recording.ambiguous" or (d.level == "info") != bool(lines))  # fmt: skip
    text = " ".join(sentences(said))
    told_open = any(word in text for word in OPEN)
    result = "right" if same else "open" if told_open else "wrong" if lines else "no word"
    return {
        "tx40": words, "result": result, "certain": bool(found.errors),
        "said": [each.kind + " " + ", ".join(each.joints) for each in found.remedies],
        "undecided": [d.text for d in found.diagnostics if d.level != "error"],
    }  # fmt: skip


def recorded(real: tb.Recording, mapping: dict[str, Any]) -> tb.Recording:
    """The recording that a mapping makes of a file's columns."""
    signals: dict[str, Any] = {}
    for kind in (each for each in JOINT_QUANTITIES if each in mapping):
        values = real.measured(kind)[:, [int(column) for column in mapping[kind]["columns"]]]
        table = SignalTable(**mapping[kind])
        if kind == "position":  # as an import does
            values, _ = unwrapped_positions(table, real.names, real.time, values)
        signals[kind] = joint_signal(kind, table, None, values)
    currents = EFFORT_OF_UNIT.get(mapping["torque"]["unit"][0], "torque")
    metadata = Metadata(mapping=mapping, effort=dict.fromkeys(real.names, currents))
    return tb.Recording(real.names, real.time, **signals, metadata=metadata)


def main() -> None:
    """Corrections of planted mistakes; exit code 1 where one is wrong."""
    lines = print_lines(tx40())
    results = [line["result"] for line in lines]
    print_lines([{each: results.count(each) for each in ("right", "open", "no word", "wrong")}])
    raise typer.Exit(int("wrong" in results))
