"""A guessed mapping turns a log back into the recording that it was made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.arrays import Array
from testbed.recordings.importing.foreign_units import TIMES, UNITS
from testbed.recordings.importing.guess import guessed
from testbed.recordings.importing.stamps import rate_of

KINDS = ("position", "velocity", "torque")
WORDS = {
    "position": ("pos", "position", "actual_q", "JointAngle", "msr_angle", "state/q"),
    "velocity": ("vel", "velocity", "actual_qd", "JointSpeed", "msr_speed", "state/qd"),
    "torque": ("tau", "effort", "actual_torque", "JointTorque", "msr_current_torque", "state/tau"),
}
"""How loggers call signals, each in a style."""

WANTED = ("target_q", "cmd", "q_des", "Cmptd_torque", "torque_ref", "desired_vel")
NUMBERED = (
    "{word}_joint_{k}",
    "{word}{k}",
    "{word}[{k}]",
    "J{k}_{word}",
    "{word}_J{k}",
    "{word}/joint_{k}",
)
NAMED = ("{word}_{joint}", "{joint}_{word}", "{word}/{joint}", "{joint}.{word}")
"""Where the joint's number stands, or its name."""

ROBOTS = (
    tuple(f"arm_joint_{k}" for k in range(1, 8)),
    ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"),
    ("hip_joint", "knee_joint", "ankle_joint"),
    tuple(f"joint{k}" for k in (3, 1, 2)),
)
"""Names of joints in model files."""

UNIT_NAMES = ("{name} ({unit})", "{name} [{unit}]", "{name}({unit})")
SPELT = {
    "deg": ("deg", "°", "degrees"), "rad": ("rad", "radians"), "deg/s": ("deg/s", "°/s"),
    "rad/s": ("rad/s", "rad s^-1"), "rpm": ("rpm", "rev/min"), "turn": ("rev", "turn"),
    "N m": ("N m", "Nm", "N-m", "N*m"), "lbf in": ("in-lbf", "lbf-in", "lb in"),
    "lbf ft": ("ft-lbf", "lbf ft"), "N mm": ("Nmm", "N mm"), "N": ("N",), "lbf": ("lbf", "lb"),
    "kgf": ("kgf",), "kN": ("kN",),
}  # fmt: skip
USED = {
    "position": ("rad", "deg", "turn"), "velocity": ("rad/s", "deg/s", "rpm"),
    "torque": ("N m", "lbf in", "N mm", "lbf ft"), "force": ("N", "lbf", "kN", "kgf"),
    "moment": ("N m", "lbf in", "N mm", "lbf ft"),
}  # fmt: skip
AXES = (
    ("F{}", "M{}"),
    ("F{}", "T{}"),
    ("plate_force_{}", "plate_moment_{}"),
    ("wrench/force/{}", "wrench/torque/{}"),
)
CLOCKS = {"s": "float", "ms": "int", "us": "int", "ns": "int"}
EPOCH = 1_761_234_567


@dataclass(frozen=True, eq=False)
class Log:
    """Columns of one file, by name."""

    columns: dict[str, Any]
    ending: str


def motion(rng: np.random.Generator, joints: int, rate: float, samples: int) -> dict[str, Array]:
    """Sines, their derivative, and signals that mean nothing."""
    t = np.arange(samples) / rate
    speed = rng.uniform(2, 6, joints)
    phase = rng.uniform(0, 6, joints)
    size = rng.uniform(0.2, 1.5, joints)
    angle = speed * t[:, None] + phase
    return {
        "time": t,
        "position": size * np.sin(angle) + rng.uniform(-1, 1, joints),
        "velocity": size * speed * np.cos(angle),
        "torque": rng.normal(size=(samples, joints)),
        "wrench": rng.normal(size=(samples, 6)) + 20 * np.eye(6)[2],
    }


class Layout:
    """How a logger writes what was measured: all of it drawn."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng([17, seed])
        robot = ROBOTS[int(rng.integers(len(ROBOTS)))]
        self.names = list(robot[: int(rng.integers(2, 8))])
        self.joints, self.rate = len(self.names), float(rng.choice([50, 125, 200, 250, 500]))
        self.named = bool(rng.integers(2))
        self.truth = motion(rng, self.joints, self.rate, 400)
        self.with_velocity = bool(rng.integers(2))
        self.style = int(rng.integers(6))
        self.units = {kind: str(rng.choice(each)) for kind, each in USED.items()}
        self.hidden = self.with_velocity and bool(rng.integers(2))  # position's unit is not said
        if self.hidden:
            self.units["velocity"] = "rad/s"
        self.two_files = bool(rng.integers(2))

    def header(self, name: str, unit: str) -> str:
        said = str(self.rng.choice(SPELT[unit]))
        return str(self.rng.choice(UNIT_NAMES)).format(name=name, unit=said)

    def signal(self, kind: str, values: Array) -> dict[str, Array]:
        """Its columns."""
        own = [int(name[5:]) if name[5:].isdigit() else 0 for name in self.names]
        first = int(self.rng.integers(2))
        numbers = own if all(own) else list(range(first, first + self.joints))
        form, unit = str(self.rng.choice(NAMED if self.named else NUMBERED)), self.units[kind]
        columns = {}
        for k in range(self.joints):
            name = form.format(word=WORDS[kind][self.style], k=numbers[k], joint=self.names[k])
            name = name if self.hidden and kind == "position" else self.header(name, unit)
            columns[name] = values[:, k] / UNITS[kind][unit]
        return columns

    def stamps(self, epoch: bool) -> tuple[str, Array]:
        unit = str(self.rng.choice(list(CLOCKS)))
        words = ("t ({})", "Time ({})", "timestamp_{}", "time [{}]")
        name = str(self.rng.choice(words)).format(unit)
        time: Any = self.truth["time"]
        if unit == "ns":
            whole = np.round(time * 1e9).astype(np.int64) + epoch * EPOCH * 10**9
            return name if not epoch else "Timestamp", whole
        if unit == "us":
            return name, np.round(time * 1e6).astype(np.int64) + epoch * EPOCH * 10**6
        return name, time / TIMES[unit] + epoch * EPOCH / TIMES[unit] * (unit == "s")

    def logs(self) -> list[Log]:
        """One file, or one of the joints and one of the plate."""
        parts: dict[str, Array] = {}
        for kind in KINDS:
            if kind != "velocity" or self.with_velocity:
                parts |= self.signal(kind, self.truth[kind])
        for k in range(self.joints):  # what is not measured
            parts[f"{self.rng.choice(WANTED)}_{k}"] = self.rng.normal(size=400)
        parts["motor_temperature"] = self.rng.normal(size=400)
        axes = [each.format(axis) for each in AXES[int(self.rng.integers(4))] for axis in "xyz"]
        units = [*["force"] * 3, *["moment"] * 3]
        plate = {
            self.header(name, self.units[kind]): self.truth["wrench"][:, k]
            / UNITS[kind][self.units[kind]]
            for k, (name, kind) in enumerate(zip(axes, units, strict=True))
        }
        epoch = bool(self.rng.integers(2))
        both = [parts, plate] if self.two_files else [parts | plate]
        found = []
        for each in both:
            order = self.rng.permutation(len(each))
            names = [list(each)[k] for k in order]
            name, stamps = self.stamps(epoch) if not self.two_files else self.stamps(False)
            columns = {name: stamps} | {key: each[key] for key in names}
            found.append(Log(columns, str(self.rng.choice([".csv", ".npz", ".parquet"]))))
        return found


def write(log: Log, path: Path) -> None:
    if log.ending == ".npz":
        np.savez(path, **log.columns)
    elif log.ending == ".parquet":
        pq.write_table(pa.table(dict(log.columns)), path)
    else:
        rows = zip(*(map(repr, values.tolist()) for values in log.columns.values()), strict=True)
        path.write_text("\n".join([";".join(log.columns), *map(";".join, rows)]) + "\n")


@given(seed=st.integers(0, 10**6))
def test_a_guess_converts_the_log_back(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    """What a person fills in is the sense of the wrench, and nothing else."""
    tmp_path = tmp_path_factory.mktemp("log")
    layout = Layout(seed)
    paths = []
    for k, log in enumerate(layout.logs()):
        paths.append(tmp_path / f"log{k}{log.ending}")
        write(log, paths[-1])
    known = not layout.named or bool(layout.rng.integers(2))
    text = guessed(paths, tmp_path, layout.names if known else ()).text
    assert [line.split("=")[0].strip() for line in empty(text)] == ["sense"], text
    (tmp_path / "map.toml").write_text(text.replace('sense = ""', 'sense = "on_robot"'))
    made = tb.Recording.from_mapping(tmp_path / "map.toml")
    assert made.rate == pytest.approx(layout.rate, rel=1e-9), text
    assert sorted(made.names) == sorted(layout.names), text
    order = [made.names.index(name) for name in layout.names]
    assert made.samples == 400
    for kind in ("position", "torque", "wrench", *(["velocity"] * layout.with_velocity)):
        found = made.measured(kind) if kind == "wrench" else made.measured(kind)[:, order]
        np.testing.assert_allclose(found, layout.truth[kind], atol=1e-5, err_msg=text)


def empty(text: str) -> list[str]:
    """Lines of keys that are to be filled in."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return [line for line in lines if '""' in line or line.startswith("rate = 0")]


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
        scale = round(1 / TIMES[unit])
        stamps = np.round(samples / rate * scale).astype(np.int64) + since * scale
    stamps = np.delete(stamps, slice(len(stamps) // 3, len(stamps) // 3 + 40))  # a gap
    assert rate_of(stamps) / TIMES[unit] == pytest.approx(rate, rel=1e-12)


def test_a_files_name_says_what_columns_of_joints_alone_do_not(tmp_path: Path) -> None:
    for name in ("pos_read_data", "curr_data"):
        rows = "\n".join("1,2" for _ in range(5))
        (tmp_path / f"{name}.csv").write_text(f"Joint_1,Joint_2\n{rows}\n")
    paths = [tmp_path / "curr_data.csv", tmp_path / "pos_read_data.csv"]
    tables = guessed(paths, tmp_path, ("joint_1", "joint_2")).tables
    found = {kind: tables[kind]["source"] for kind in ("position", "torque")}
    assert found == {"position": "pos_read_data", "torque": "curr_data"}


def test_columns_with_another_word_before_the_number_are_another_signal(tmp_path: Path) -> None:
    names = [f"{word}{k}" for word in ("Position", "Torque", "TorqueSm", "Cur") for k in (1, 2)]
    table = {"Takt [ms]": np.arange(50.0)} | dict.fromkeys(names, np.arange(50.0))
    np.savez(tmp_path / "log.npz", **table)  # type: ignore[arg-type]
    tables = guessed([tmp_path / "log.npz"], tmp_path, ("joint_1", "joint_2")).tables
    assert tables["torque"]["columns"] == ["Torque1", "Torque2"]
    assert (tables["sources.log"]["time"], tables[""]["rate"]) == ("Takt [ms]", 1000)
