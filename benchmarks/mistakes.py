"""Mistakes of mappings planted in recordings that the project's simulator has not made.

Each recording goes through columns as a file would have them and a mapping with up to two mistakes;
what the check proposes is written into the mapping, and the recording is made and held against the
robot again.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import testbed as tb
from benchmarks.inverse_recordings import RATE, Truth, truth
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.columns import AXES
from testbed.core.robot.inertia import from_vector, to_rpy
from testbed.importing.check.check import assess, check_recording
from testbed.importing.check.plate import PLATE_ORDERS, quarter_turns
from testbed.importing.check.plate_map import transform
from testbed.importing.check.remedies import Remedy, with_lines
from testbed.importing.foreign_table import FORCES, MOMENTS
from testbed.importing.mapping import SignalTable, WrenchTable
from testbed.importing.signal_maps import joint_signal, wrench_of

ARMS = ("puma562", "ur5", "xarm7", "panda")
"""Of the robots."""

KINDS = (
    "turn", "turn", "turn", "shift", "units", "units", "sense", "plate order", "tare", "late",
    "degrees", "position sign", "position order", "torque sign", "torque order", "any turn",
)  # fmt: skip
"""Of mistakes; frames are what people get wrong most."""

SAME = {"wrench": 3e-3, "position": 1e-6, "torque": 1e-6}
"""Rms difference to the right mapping's signal, relative, in which a cure is right."""


@dataclass(frozen=True, eq=False)
class Case:
    """A file's columns, the mapping that is right for them, and one with mistakes."""

    kinds: tuple[str, ...]
    columns: dict[str, Array]
    right: dict[str, Any]
    wrong: dict[str, Any]
    late: float = 0.0


def case(made: Truth, kinds: tuple[str, ...], rng: np.random.Generator, which: int) -> Case:  # noqa: PLR0912
    """Columns for which a mapping with these mistakes is wrong; which of the 24 turns."""
    tree, n = made.tree, made.tree.n
    wrench: dict[str, Any] = {"source": "log", "columns": list(AXES), "units": ["N", "N m"],
                              "sense": "on_robot"}  # fmt: skip
    position: dict[str, Any] = {"source": "log", "columns": [f"q{k}" for k in range(n)],
                                "unit": "rad", "sign": [1] * n}  # fmt: skip
    torque: dict[str, Any] = {"source": "log", "columns": [f"tau{k}" for k in range(n)],
                              "unit": "N m", "sign": [1] * n}  # fmt: skip
    right = {"joints": list(tree.names), "wrench": wrench, "position": position, "torque": torque}
    wrong = {key: dict(value) if isinstance(value, dict) else value for key, value in right.items()}
    turn, place, zero, late = np.eye(3), np.zeros(3), np.zeros(6), 0.0
    for kind in kinds:
        joint = int(rng.integers(n))
        if kind == "turn":
            turn = quarter_turns()[which]
        if kind == "any turn":
            turn = from_vector(rng.normal(size=3))
        if kind == "shift":
            place = rng.uniform(-0.2, 0.2, 3)
        if kind == "units":
            pairs = [[f, m] for f in FORCES for m in MOMENTS if (f, m) != ("N", "N m")]
            wrench["units"] = pairs[rng.integers(len(pairs))]
        if kind == "sense":
            wrench["sense"] = "on_plate"
        if kind == "plate order":
            order = PLATE_ORDERS[rng.integers(len(PLATE_ORDERS))]
            wrench["columns"] = [AXES[k] for k in order]
        if kind == "tare":
            zero = made.weight * rng.normal(size=6) * np.repeat([0.2, 0.1], 3)
            wrench["tare"] = zero.tolist()
        if kind == "late":
            late = float(rng.choice([-1, 1]) * rng.uniform(5e-3, 30e-3))
        if kind == "degrees":
            position["unit"] = "deg"
        if kind.endswith("sign"):
            table = position if kind == "position sign" else torque
            table["sign"] = [-1 if k == joint else 1 for k in range(n)]
        if kind in ("position order", "torque order"):
            table = position if kind == "position order" else torque
            one, other = rng.choice(n, 2, replace=False)
            columns = list(table["columns"])
            columns[one], columns[other] = columns[other], columns[one]
            table["columns"] = columns
    if {"turn", "any turn", "shift"} & set(kinds):
        wrench["place"] = {"xyz": place.tolist(), "rpy": list(to_rpy(turn))}
    return Case(kinds, _columns(made, right, turn, place, zero, late), right, wrong, late)


def _columns(made: Truth, mapping: dict[str, Any], turn: Array, place: Array, zero: Array,
             late: float) -> dict[str, Array]:  # fmt: skip
    """A file for which a mapping is right."""
    from scipy.interpolate import make_interp_spline

    t = np.arange(len(made.position)) / RATE
    assert made.wrench is not None
    wrench = made.wrench + zero
    if late:
        wrench = make_interp_spline(t, wrench, k=3)(np.clip(t - late, t[0], t[-1]))
    table = mapping["wrench"]
    sensed = wrench @ np.linalg.inv(transform(turn, place)).T
    sensed = sensed * (1 if table["sense"] == "on_robot" else -1)
    sensed = sensed / np.repeat([FORCES[table["units"][0]], MOMENTS[table["units"][1]]], 3)
    found = dict(zip(table["columns"], sensed.T, strict=True))
    degree = np.pi / 180 if mapping["position"]["unit"] == "deg" else 1.0
    for signal, values in (("position", made.position / degree), ("torque", made.torque)):
        table = mapping[signal]
        found |= dict(zip(table["columns"], (values * table["sign"]).T, strict=True))
    return found


def recorded(made: Truth, columns: dict[str, Array], mapping: dict[str, Any]) -> tb.Recording:
    """The recording that a mapping makes of a file's columns."""

    def of(table: dict[str, Any]) -> Array:
        return np.column_stack([columns[name] for name in table["columns"]])

    said = mapping.get("wrench")
    wrench = None if said is None else wrench_of(WrenchTable(**said), of(said))
    tare = None if said is None else np.array(said.get("tare") or np.zeros(6))
    signals = {kind: joint_signal(kind, SignalTable(**mapping[kind]), None, of(mapping[kind]))
               for kind in ("position", "torque")}  # fmt: skip
    position = signals["position"]
    return tb.Recording(
        made.tree.names, np.arange(len(position)) / RATE, position,
        torque=signals["torque"], wrench=wrench, tare=tare, facts={"mapping": mapping},
    )  # fmt: skip


def difference(case: Case, made: Truth, mapping: dict[str, Any]) -> dict[str, float]:
    """Rms difference of each signal to that of the right mapping, relative to how it varies."""
    right, found = (recorded(made, case.columns, each) for each in (case.right, mapping))
    return {signal: _apart(right.measured(signal), found.measured(signal)) for signal in SAME}


def _apart(one: Array, other: Array) -> float:
    rest = ((one - other) - (one - other).mean(axis=0)) ** 2
    size = one.var(axis=0)
    if one.shape[1] == 6:  # forces beside forces, moments beside moments
        size = np.repeat(size.reshape(2, 3).sum(axis=1), 3)
    return float(np.sqrt((rest.mean(axis=0) / size).sum()))


@dataclass(frozen=True)
class Outcome:
    """What became of a case.

    Attributes:
        cpu: Of the first check [s].
        said: Kinds that it named.
        refused: Whether it refused the recording.
        right: Whether the cure that it proposed makes the recording right, or it named lateness
            or the plate's zero as they are.
        accepted: Whether the recording is accepted at last: as it was, or with the cure.
    """

    cpu: float
    said: tuple[str, ...]
    refused: bool
    right: bool
    accepted: bool


def tried(made: Truth, case: Case) -> Outcome:
    """A case held against its robot, cured, and held against it again."""
    begun = time.process_time()
    found = assess(made.tree, recorded(made, case.columns, case.wrong))
    cpu = time.process_time() - begun
    refused = bool(found.certain)
    lines = [line for remedy in found.remedies for line in remedy.lines]
    mapping = with_lines(case.wrong, lines)
    apart = difference(case, made, mapping)
    same = {**SAME, "wrench": SAME["wrench"] if not case.late else 1.0}
    right = all(apart[signal] < same[signal] for signal in SAME)
    cured = recorded(made, case.columns, mapping)
    try:
        accepted = check_recording(made.tree, cured)
    except RecordingError:
        return Outcome(cpu, _kinds(found.remedies), refused, False, False)
    delays = [clock.delay for clock in accepted.offsets if clock.signal == "wrench" and clock.late]
    told = float(case.wrong["wrench"].get("delay", 0.0)) if not delays else delays[0]
    right &= abs(told - case.late) < 2e-3
    if "tare" in case.kinds:
        zero = np.array(mapping["wrench"].get("tare") or np.zeros(6)) - case.right["wrench"]["tare"]
        right &= bool(np.abs(zero[:2]).max() < 0.01 * made.weight)
    return Outcome(cpu, _kinds(found.remedies), refused, right, True)


def _kinds(remedies: tuple[Remedy, ...]) -> tuple[str, ...]:
    return tuple(remedy.kind for remedy in remedies)


def study(count: int, seed: int, only: str = "") -> Iterator[dict[str, Any]]:
    """Each recording of the study: right ones, then mistakes, one and two at once.

    Args:
        count: Mistakes on each robot; half as many recordings are right.
        seed: Of robots, motions and mistakes.
        only: Robots whose names hold this.
    """
    turn = itertools.cycle(range(1, 24))
    for robot in (name for name in ARMS if only in name):
        rng = np.random.default_rng([seed, sum(map(ord, robot))])
        seeds = rng.integers(1 << 31, size=count // 2)
        for each in seeds:
            made = truth(robot, int(each))
            yield {"robot": robot, "planted": (), **vars(tried(made, case(made, (), rng, 0)))}
        several = [truth(robot, int(each)) for each in seeds[:3]]
        for k in range(count):
            kinds = tuple(dict.fromkeys(rng.choice(KINDS, 1 + k % 2).tolist()))
            if {"turn", "any turn"} <= set(kinds):
                kinds = ("turn",)
            made = several[k % len(several)]
            planted = case(made, kinds, rng, next(turn) if "turn" in kinds else 0)
            yield {"robot": robot, "planted": kinds, **vars(tried(made, planted))}


def total(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """What a study says in all, and robot by robot its CPU time."""
    wrong = [line for line in lines if line["planted"]]
    clean = [line for line in lines if not line["planted"]]
    cpu = {
        robot: [round(float(f([o["cpu"] for o in lines if o["robot"] == robot])), 2)
                for f in (np.median, np.max)]
        for robot in dict.fromkeys(o["robot"] for o in lines)
    }  # fmt: skip
    return {
        "mistakes": len(wrong),
        "right cure first": sum(line["right"] for line in wrong),
        "wrong accepted": sum(line["accepted"] and not line["right"] for line in wrong),
        "right recordings": len(clean),
        "right refused": sum(line["refused"] for line in clean),
        "right accepted with a cure": sum(bool(line["said"]) for line in clean),
        "cpu median, most [s]": cpu,
    }


def reached(found: dict[str, Any]) -> bool:
    """Whether a total is good enough: 95 % cured, nothing wrong accepted or right refused."""
    cured = found["right cure first"] >= 0.95 * found["mistakes"]
    return bool(cured and not found["wrong accepted"] and not found["right refused"])
