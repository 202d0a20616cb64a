"""What a mapping is worth: held against what was planted in the files, by its meaning.

The 6x6 map from the plate's columns to the wrench in the robot's frame, positions and torques as
numbers, and when each sample was taken are read here from the file's keys, by arithmetic of this
module's own. What no data tell apart is no mistake: a turn about the first joint's axis with that
joint's zero, the last joint's zero, shifts and zeros of `UNTOLD`.

Sigmas are read from comments of the form `VALUE +- SIGMA UNIT`, several separated by commas:
`rpy 0.02, -0.01, 90.02 +- 0.05, 0.04, 0.05 deg; xyz 10.2, 0.1, -45.3 +- .5, .4, .9 mm` beside the
place, `ratio 39.36 +- 0.01` beside the units, `20.13 +- 0.05 ms` beside an offset or a delay. Where
a value was rounded to what a person writes, the comment's is the one that sigma is of.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.foreign_recordings import FORCE, MOMENT, Files, Planted, moved
from benchmarks.inverse_recordings import RATE, Truth
from testbed.core.base.arrays import Array

UNTOLD: dict[str, tuple[str, tuple[int, ...]]] = {
    "scara": ("z", (2,)),
    "gantry": ("xyz", (0, 1, 2)),
}
"""Directions of a shift, and joints whose zero, that no data tell, by the robot."""

GOALS = {"turn": 0.1, "shift": 1.0, "ratio": 0.3, "clock": 0.1}
"""Rms errors that are good enough [deg, mm, %, ms]."""

TIMES = 3.0
"""So many times a goal an error of one mapping may be, if that is to be right."""

SIGMAS = 3.0
"""By so many of its own sigmas a value may be off that is as unsure as its line says."""

MARKS = ("ASSUMED", "not told apart", "cannot be told", "not decidable")
"""What a comment says of a value that may be another."""

SECOND = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180, "turn": 2 * np.pi}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}
"""One of each in SI."""


@dataclass(frozen=True)
class Judged:
    """What a mapping is worth.

    Attributes:
        wrong: What it says wrongly, by its tables.
        errors: Of turn [deg], shift [mm], ratio of gains [%] and clock [ms].
        sigmas: Errors in the mapping's own sigmas, where it says these.
    """

    wrong: dict[str, str] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    sigmas: dict[str, float] = field(default_factory=dict)

    @property
    def as_unsure_as_said(self) -> bool:
        """Whether all that is wrong is off by no more than its line says that it may be."""
        names = [name for each in self.wrong.values() for name in each.split(", ")]
        return all(self.sigmas.get(name, np.inf) <= SIGMAS for name in names)


def judged(robot: str, text: str, files: Files, made: Truth, told: Planted) -> Judged:
    """Hold a mapping against what was planted.

    Args:
        robot: Its name in `ROBOTS`.
        text: The mapping, complete.
        files: That it is of.
        made: What is true.
        told: What was planted.
    """
    said = tomllib.loads(text)
    wrong: dict[str, str] = {}
    names = list(made.tree.names)
    if sorted(said["joints"]) != sorted(names):
        return Judged({"joints": f"{said['joints']}"})
    by_name = [said["joints"].index(name) for name in names]
    turned = _position(robot, said, files, made, by_name, wrong)
    if "torque" not in said:
        wrong["torque"] = "there is none"
    else:
        found = _signal(said["torque"], said, files, FORCE | MOMENT)[:, by_name]
        rest = np.abs(found - made.torque).max(axis=0) / np.abs(made.torque).max(axis=0)
        bad = [names[k] for k in np.flatnonzero(rest > 1e-5)]
        if bad:
            wrong["torque"] = ", ".join(bad)
    if "wrench" not in said:
        return Judged(wrong | {"wrench": "there is none"})
    errors = _plate(robot, said, files, made, told, turned, wrong)
    untold = UNTOLD.get(robot, ("", ()))[0]
    return Judged(wrong, errors, _in_sigmas(text, told, errors, untold))


def _position(
    robot: str, said: dict[str, Any], files: Files, made: Truth, by_name: Sequence[int],
    wrong: dict[str, str],
) -> float:  # fmt: skip
    """Other zeros that no data tell are no mistake; returns that of the first joint [rad]."""
    found = _signal(said["position"], said, files, ANGLE | LENGTH)[:, by_name]
    rest = found - made.position
    zero = np.median(rest, axis=0)
    turning = np.array([joint.revolute for joint in made.tree.joints])
    odd = np.where(turning, (zero + np.pi) % (2 * np.pi) - np.pi, zero)
    free = {0, made.tree.n - 1, *UNTOLD.get(robot, ("", ()))[1]}
    bad = [
        name
        for k, name in enumerate(made.tree.names)
        if np.abs(rest[:, k] - zero[k]).max() > 1e-4 or (abs(odd[k]) > 1e-3 and k not in free)
    ]
    if bad:
        wrong["position"] = ", ".join(bad)
    return float(odd[0]) if turning[0] and not bad else 0.0


def _signal(
    table: dict[str, Any], said: dict[str, Any], files: Files, units: dict[str, float]
) -> Array:
    """A joints' signal of a mapping, by its keys, (M, n); nan where a column is none."""
    columns = _columns(table, said, files)
    unit = table["unit"] if isinstance(table["unit"], list) else [table["unit"]] * len(columns)
    size = np.array([units.get(each, np.nan) for each in unit]) * table.get("gain", 1.0)
    found = np.stack([files.raw[s][:, k] if s else np.full(len(files.raw["position"]), np.nan)
                      for s, k in columns], axis=1)  # fmt: skip
    found = found * size * np.array(table.get("sign", [1] * len(columns)))
    found = found @ np.array(table.get("matrix", np.eye(len(columns)))).T
    return np.asarray(np.nan_to_num(found + np.array(table.get("offset", 0.0)), nan=1e9))


def _columns(table: dict[str, Any], said: dict[str, Any], files: Files) -> list[tuple[str, int]]:
    file = Path(said["sources"][table["source"]]["file"]).name
    return [files.columns.get((file, name), ("", 0)) for name in table["columns"]]


def _plate(
    robot: str, said: dict[str, Any], files: Files, made: Truth, told: Planted, turned: float,
    wrong: dict[str, str],
) -> dict[str, float]:  # fmt: skip
    """Errors of the plate's map and clock; what is beyond the goals is wrong."""
    table = said["wrench"]
    columns = _columns(table, said, files)
    pick = np.zeros((len(columns), 6))
    for row, (signal, k) in enumerate(columns):
        pick[row, k] = signal == "wrench"
    inner = np.array(table.get("matrix", np.eye(6))) @ pick
    place = table.get("place", {"xyz": [0.0] * 3, "rpy": [0.0] * 3})
    turn = Rotation.from_euler("xyz", place["rpy"]).as_matrix()
    size = np.repeat([FORCE[table["units"][0]], MOMENT[table["units"][1]]], 3)
    sense = 1 if table["sense"] == "on_robot" else -1
    found = moved(turn, np.array(place["xyz"])) @ (sense * size[:, None] * inner)
    apart = _first_joint(made, -turned) @ found @ np.linalg.inv(told.map)
    force, moment, cross = apart[:3, :3], apart[3:, 3:], apart[3:, :3]
    gain = np.cbrt([np.linalg.det(force), np.linalg.det(moment)])
    if not (gain > 0).all() or np.abs(apart[:3, 3:]).max() > 1e-6 * gain.max():
        wrong["wrench"] = "columns or sense"
        return {}
    error, _ = Rotation.align_vectors((force / gain[0]).T, np.eye(3))
    arm = cross @ error.as_matrix().T / gain[1]
    shift = np.array([arm[2, 1] - arm[1, 2], arm[0, 2] - arm[2, 0], arm[1, 0] - arm[0, 1]]) / 2
    shift[["xyz".index(axis) for axis in UNTOLD.get(robot, ("", ()))[0]]] = 0
    errors = {
        "turn": float(np.degrees(error.magnitude())),
        "shift": float(np.linalg.norm(shift)) * 1e3,
        "ratio": abs(float(gain[1] / gain[0]) - 1) * 100,
        "clock": _clock(said, files, told) * 1e3,
    }
    bad = [name for name, goal in GOALS.items() if not errors[name] < TIMES * goal]
    bad += ["size"] * (not 0.98 < gain[0] < 1.02)
    off = np.abs(force / gain[0] - error.as_matrix()).max()
    bad += ["crosstalk"] * bool(max(off, np.abs(moment / gain[1] - force / gain[0]).max()) > 0.01)
    zero = _first_joint(made, -turned) @ np.array(table.get("tare", np.zeros(6))) - told.zero
    bad += ["tare"] * bool(np.abs(zero[:2]).max() > 0.02 * made.weight)  # Fz may be the robot's
    if bad:
        wrong["wrench"] = ", ".join(bad)
    return errors


def _first_joint(made: Truth, angle: float) -> Array:
    """The map of wrenches by a turn about the first joint's axis, (6, 6)."""
    first = made.tree.joints[0]
    turn = Rotation.from_rotvec(angle * (first.rotation @ first.axis)).as_matrix()
    return moved(turn, first.offset - turn @ first.offset)


def _clock(said: dict[str, Any], files: Files, told: Planted) -> float:
    """Error of the plate's times beside the positions' [s]."""
    robot, plate = (_times(said[signal], said, files) for signal in ("position", "wrench"))
    real = np.arange(len(robot)) / RATE
    apart = (plate - robot) - (-told.late)
    stretch = abs(np.ptp(robot) / np.ptp(real) - 1)
    return float(np.abs(apart.mean())) + (1e3 if not stretch < 1e-3 else 0.0)


def _times(table: dict[str, Any], said: dict[str, Any], files: Files) -> Array:
    """When samples were taken by a mapping [s], since an instant in common."""
    source = said["sources"][table["source"]]
    file = Path(source["file"]).name
    if "time" not in source:
        time = np.arange(len(files.raw["position"])) / source["rate"]
    else:
        stamps = files.stamps.get((file, source["time"]))
        if stamps is None:
            return np.full(len(files.raw["position"]), np.nan)
        since = stamps - (next(iter(files.stamps.values()))[0] if stamps.dtype.kind == "i" else 0)
        time = since * SECOND[source.get("time_unit", "s")]
    time = time * (1 + source.get("skew", 0.0))
    return np.asarray(time + source.get("offset", 0.0) - table.get("delay", 0.0))


NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
LIST = rf"{NUMBER}(?:,\s*{NUMBER})*"
SAID = re.compile(rf"(ratio )?\[?({LIST})\]?\s*\+-\s*\[?({LIST})\]?\s*(deg|mm|%|ms)?")


def _in_sigmas(text: str, told: Planted, errors: dict[str, float], untold: str) -> dict[str, float]:
    """Errors over the sigmas that comments give; rms over the components of turn and shift."""
    found: dict[str, float] = {}
    kinds = {"deg": "turn", "mm": "shift", "%": "ratio", "ms": "clock"}
    comments = [line.partition("#")[2] for line in text.splitlines() if "+-" in line]
    for match in (each for comment in comments for each in SAID.finditer(comment)):
        values, sigma = (np.array(match[k].split(","), float) for k in (2, 3))
        kind = "ratio" if match[1] else kinds.get(match[4] or "", "")
        if not kind or kind not in errors or kind in found or not (sigma > 0).all():
            continue
        error = errors[kind]
        if kind == "turn" and len(values) == 3:
            turn = Rotation.from_euler("xyz", values, degrees=True).as_matrix()
            error = float(np.degrees(Rotation.from_matrix(turn @ told.turn.T).magnitude()))
        if kind == "ratio" and match[1]:
            real = FORCE[told.units[0]] / MOMENT[told.units[1]]
            error = min(abs(values[0] / each - 1) for each in (real, 1 / real)) * 100
            sigma = sigma / values[0] * 100 if match[4] != "%" else sigma
        if kind == "shift" and len(sigma) == 3:
            sigma = np.delete(sigma, ["xyz".index(axis) for axis in untold])
        if not len(sigma):
            continue
        found[kind] = error / float(np.sqrt((sigma**2).sum()))
    return found


def marked(text: str, wrong: dict[str, str]) -> bool:
    """Whether a mapping says of all that is wrong in it that it may be."""
    table, found = "", set()
    for line in text.splitlines():
        head = re.match(r"\s*\[([\w.]+)\]\s*(#|$)", line)
        table = head[1] if head else table
        if any(mark in line.partition("#")[2] for mark in MARKS):
            found.add(table)
    return wrong.keys() <= found
