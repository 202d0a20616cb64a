"""A guessed mapping turns a log back into the recording that it was made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.importing.foreign_table import TIME_UNITS, UNITS_BY_QUANTITY
from testbed.importing.guess import guess_mapping
from testbed.importing.likely_clock import sampling_rate
from tests.helpers.strategies import rngs

STYLES = (
    ("pos", "vel", "tau"), ("position", "velocity", "effort"),
    ("actual_q", "actual_qd", "actual_torque"), ("JointAngle", "JointSpeed", "JointTorque"),
    ("msr_angle", "msr_speed", "msr_current_torque"), ("state/q", "state/qd", "state/tau"),
)  # fmt: skip
"""How loggers call positions, velocities and torques."""

WANTED = ("target_q", "cmd", "q_des", "Cmptd_torque", "torque_ref", "desired_vel")
NUMBERED = ("{word}_joint_{k}", "{word}{k}", "{word}[{k}]", "J{k}_{word}", "{word}/joint_{k}")
NAMED = ("{word}_{joint}", "{joint}_{word}", "{word}/{joint}", "{joint}.{word}")
AXES = (("F{}", "M{}"), ("F{}", "T{}"), ("plate_force_{}", "plate_moment_{}"),
        ("wrench/force/{}", "wrench/torque/{}"))  # fmt: skip
ROBOTS = (
    tuple(f"arm_joint_{k}" for k in range(1, 8)),
    ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"),
    ("hip_joint", "knee_joint", "ankle_joint"),
    ("joint3", "joint1", "joint2"),
)
MOMENTS = {"N m": ("N m", "Nm", "N-m", "N*m"), "lbf in": ("in-lbf", "lbf-in", "lb in"),
           "lbf ft": ("ft-lbf", "lbf ft"), "N mm": ("Nmm", "N mm")}  # fmt: skip
SPELT = {
    "position": {"deg": ("deg", "°", "degrees"), "rad": ("rad", "radians"), "turn": ("rev",)},
    "velocity": {"deg/s": ("deg/s", "°/s"), "rad/s": ("rad s^-1",), "rpm": ("rpm", "rev/min")},
    "torque": MOMENTS,
    "force": {"N": ("N",), "lbf": ("lbf", "lb"), "kgf": ("kgf",), "kN": ("kN",)},
    "moment": MOMENTS,
}
"""Of each kind the units and how loggers write them."""

EPOCH = 1_761_234_567


def pick(rng: np.random.Generator, each: Sequence[Any]) -> Any:
    return each[int(rng.integers(len(each)))]


def headed(rng: np.random.Generator, kind: str, name: str, unit: str) -> str:
    """A column's name with its unit, written in some way."""
    form = pick(rng, ("{} ({})", "{} [{}]", "{}({})"))
    return str(form.format(name, pick(rng, SPELT[kind][unit])))


def clock(rng: np.random.Generator, time: Array, epoch: bool) -> dict[str, Any]:
    """Stamps in some unit, whole but for seconds and milliseconds, perhaps since 1970."""
    unit = pick(rng, ("s", "ms", "us", "ns"))
    name = pick(rng, ("t ({})", "Time ({})", "timestamp_{}", "time [{}]")).format(unit)
    if unit in ("us", "ns"):
        scale = round(1 / TIME_UNITS[unit])
        name = "Timestamp" if epoch and unit == "ns" else name
        return {name: np.round(time * scale).astype(np.int64) + epoch * EPOCH * scale}
    return {name: time / TIME_UNITS[unit] + epoch * EPOCH * (unit == "s")}


def written(rng: np.random.Generator, stem: Path, columns: dict[str, Any]) -> Path:
    """A file of numbers or of text."""
    if rng.integers(2):
        path = stem.with_suffix(".parquet")
        pq.write_table(pa.table(columns), path)
        return path
    rows = zip(*(map(repr, values.tolist()) for values in columns.values()), strict=True)
    path = stem.with_suffix(".csv")
    path.write_text("\n".join([";".join(columns), *map(";".join, rows)]) + "\n")
    return path


@given(rng=rngs, named=st.booleans(), speeds=st.booleans(), hides=st.booleans(),
       split=st.booleans())  # fmt: skip
def test_a_guess_converts_the_log_back(
    rng: np.random.Generator, named: bool, speeds: bool, hides: bool, split: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:  # fmt: skip
    """Whatever the logger's words, order and units; a person fills in the sense of the wrench."""
    folder = tmp_path_factory.mktemp("log")
    names = list(pick(rng, ROBOTS)[: rng.integers(2, 8)])
    n, rate = len(names), float(pick(rng, (50, 125, 200, 250, 500)))
    time = np.arange(400) / rate
    size, speed = rng.uniform(0.2, 1.5, n), rng.uniform(2, 6, n)
    angle = speed * time[:, None]
    truth = {
        "position": size * np.sin(angle) + rng.uniform(-1, 1, n),
        "velocity": size * speed * np.cos(angle),
        "torque": rng.normal(size=(400, n)),
        "wrench": rng.normal(size=(400, 6)) + 20 * np.eye(6)[2],
    }
    unit = {kind: pick(rng, list(each)) for kind, each in SPELT.items()}
    if speeds and hides:  # then the position's unit follows from the velocity's
        unit["velocity"] = "rad/s"
    own = [int(name[5:]) if name[5:].isdigit() else 0 for name in names]
    first = int(rng.integers(2))
    numbers = own if all(own) else list(range(first, first + n))
    robot = {f"{pick(rng, WANTED)}_{k}": rng.normal(size=400) for k in range(n)}
    robot["motor_temperature"] = rng.normal(size=400)
    for kind, word in zip(("position", "velocity", "torque"), pick(rng, STYLES), strict=True):
        if kind == "velocity" and not speeds:
            del truth["velocity"]
            continue
        form = pick(rng, NAMED if named else NUMBERED)
        for k, values in enumerate(truth[kind].T / UNITS_BY_QUANTITY[kind][unit[kind]]):
            name = form.format(word=word, k=numbers[k], joint=names[k])
            silent = kind == "position" and speeds and hides
            robot[name if silent else headed(rng, kind, name, unit[kind])] = values
    plate, axes = {}, pick(rng, AXES)
    for k, values in enumerate(truth["wrench"].T):
        kind = ("force", "moment")[k // 3]
        name = headed(rng, kind, axes[k // 3].format("xyz"[k % 3]), unit[kind])
        plate[name] = values / UNITS_BY_QUANTITY[kind][unit[kind]]
    epoch = not split and bool(rng.integers(2))
    paths = []
    for k, part in enumerate([robot, plate] if split else [robot | plate]):
        shuffled = {name: part[name] for name in rng.permutation(list(part)).tolist()}
        paths.append(written(rng, folder / f"log{k}", clock(rng, time, epoch) | shuffled))
    known = names if not named or rng.integers(2) else ()
    text = guess_mapping(paths, folder, known).text
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    empty = [line for line in lines if '""' in line or line.startswith("rate = 0")]
    assert [line[:10] for line in empty] == ['sense = ""'], text
    (folder / "map.toml").write_text(text.replace('sense = ""', 'sense = "on_robot"'))
    made = tb.import_recording(folder / "map.toml")
    assert made.rate == pytest.approx(rate, rel=1e-9), text
    assert sorted(made.names) == sorted(names), text
    order = [made.names.index(name) for name in names]
    for kind, values in truth.items():
        found = made.measured(kind)[:, range(6) if kind == "wrench" else order]
        np.testing.assert_allclose(found, values, atol=1e-5, err_msg=text)


@given(
    rate=st.sampled_from([20, 50, 59.94, 125, 240, 500, 800]),
    since=st.sampled_from([0, EPOCH]),
    unit=st.sampled_from(["s", "ms", "us", "ns"]),
)
def test_a_rate_is_as_round_as_its_stamps_allow(rate: float, since: int, unit: str) -> None:
    """Counted in whole units, of which a sample may be few, or in seconds with a fraction."""
    samples = np.arange(int(30 * rate))
    if unit == "s":
        stamps: Any = since + samples / rate
    else:
        scale = round(1 / TIME_UNITS[unit])
        stamps = np.round(samples / rate * scale).astype(np.int64) + since * scale
    stamps = np.delete(stamps, slice(len(stamps) // 3, len(stamps) // 3 + 40))  # a gap
    assert sampling_rate(stamps) / TIME_UNITS[unit] == pytest.approx(rate, rel=1e-12)


def test_files_names_other_words_and_what_does_not_grow_are_understood(tmp_path: Path) -> None:
    """Columns of joints alone; a counter that begins again."""

    def guess(columns: str, row: str, *names: str) -> Mapping[str, Mapping[str, Any]]:
        rows = [row.replace("K", f"{k}").replace("R", f"{k % 3}") for k in range(5)]
        for name in names:
            (tmp_path / f"{name}.csv").write_text("\n".join([columns, *rows]) + "\n")
        draft = guess_mapping(
            [tmp_path / f"{name}.csv" for name in names], tmp_path, ("J_1", "J_2")
        )
        (tmp_path / "map.toml").write_text(draft.text)
        return draft.tables

    found = guess("J_1,J_2", "1,2", "curr_data", "pos_read_data")
    sources = {kind: found[kind]["source"] for kind in ("position", "torque")}
    assert sources == {"position": "pos_read_data", "torque": "curr_data"}
    assert "time" not in guess("count,q", "R,0", "log")["sources.log"]
