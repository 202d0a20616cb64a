"""`testbed new ROBOT --recording LOG` on ordinary logs: the recording, or the one thing to say."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given

import testbed as tb
from testbed.core.base.arrays import Array
from tests.helpers.command import command_line
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.runs import MODELS, robot
from tests.helpers.strategies import few, seeds

pytestmark = pytest.mark.slow

STYLES = (
    ("pos_{k}", "vel_{k}", "torque_{k}"), ("q{k}", "qd{k}", "tau{k}"),
    ("/joint_states/{name}/position", "/joint_states/{name}/velocity",
     "/joint_states/{name}/effort"),
    ("Achse {k} Istposition", "Achse {k} Istgeschwindigkeit", "Achse {k} Moment [Nm]"),
    ("axe{k}_position", "axe{k}_vitesse", "axe{k}_couple"), ("theta{k}", "omega{k}", "T{k}"),
    ("theta_{k}", "theta_dot_{k}", "u_{k}"), ("{name}.pos", "{name}.vel", "{name}.load"),
    ("CurrentPosition{k}", "CurrentVelocity{k}", "CurrentTorque{k}"),
    ("a{k}", "b{k}", "c{k}"), ("rob1_J{k} angle", "rob1_J{k} speed", "rob1_J{k} torque (Nm)"),
)  # fmt: skip
"""Positions, velocities and torques in headers of several makers, and of none."""


FINGERS = """
  <link name="left"><inertial><mass value="0.05"/>
    <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="right"><inertial><mass value="0.05"/>
    <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="finger_1" type="prismatic"><parent link="{last}"/><child link="left"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="20" velocity="0.2"/></joint>
  <joint name="finger_2" type="prismatic"><parent link="{last}"/><child link="right"/>
    <axis xyz="0 -1 0"/><limit lower="0" upper="0.04" effort="20" velocity="0.2"/>
    <mimic joint="finger_1"/></joint>
</robot>"""


ARMS = {"ur5": MODELS["ur5"], "puma": ROOT / "models/puma562.urdf"}


def arm_with_fingers(folder: Path, arm: str = "ur5") -> Path:
    """An arm that carries a gripper whose fingers move together."""
    path, last = folder / "robot.urdf", robot(arm).joints[-1].body
    text = ARMS[arm].read_text().replace("</robot>", FINGERS.format(last=last))
    path.write_text(text)
    return path


def moved(seed: int, seconds: float = 10.0, arm: str = "ur5") -> dict[str, Array]:
    """Motion and torques of the arm, with friction and noise."""
    rubs = {"coulomb": 2.0, "viscous": 1.0}
    tree = robot(arm).with_joints(dict.fromkeys(robot(arm).names, rubs))
    made = measured(tree, seed, duration=seconds, rate=100.0, noise=0.1)
    speed = np.gradient(made.position, made.time, axis=0)
    return {"t": made.time, "position": np.array(made.position), "velocity": speed,
            "torque": made.measured("torque")}  # fmt: skip


NAMES = robot("ur5").names
PLAIN = ("q_{name}", "", "tau_{name}")
WITH_UNITS = ("q_{name} [rad]", "", "tau_{name} [Nm]")


def new(
    folder: Path, log: dict[str, Array], style: tuple[str, ...] = PLAIN, *, degrees: bool = False,
    kinds: tuple[str, ...] = ("position", "torque"), arm: str = "ur5",
) -> Any:  # fmt: skip
    """What `new` says of a log whose headers are in some style."""
    model, names = arm_with_fingers(folder, arm), robot(arm).names
    columns = {"time": log["t"]}
    for kind, form in zip(("position", "velocity", "torque"), style, strict=True):
        scale = 180 / np.pi if degrees and kind != "torque" else 1.0
        for k, values in enumerate(log[kind].T if kind in kinds else ()):
            columns[form.format(k=k + 1, name=names[k])] = scale * values
    columns |= {f"temp_{k}": np.full(len(log["t"]), 31.5) for k in range(1, 7)}
    rows, heads = np.column_stack([*columns.values()]), ";".join(columns)
    np.savetxt(folder / "log.csv", rows, "%.12g", ";", header=heads, comments="", encoding="utf-8")
    return command_line("new", model.name, "--recording", "log.csv", cwd=folder)


@few(6)
@example(seed=0)
@given(seed=seeds)
def test_an_ordinary_log_is_taken_without_a_line_by_hand(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Any headers, perhaps degrees, a gripper that the log lacks; `identify` needs no lock."""
    folder, rng = tmp_path_factory.mktemp("log"), np.random.default_rng(seed)
    style = STYLES[rng.integers(len(STYLES))]
    log = moved(seed, 20.0)
    kinds = ("position", "velocity", "torque")
    done = new(folder, log, style, degrees=bool(rng.integers(2)), kinds=kinds)
    assert done.returncode == 0, (style, done.stderr)
    recording = tb.Recording.load(folder / "log.parquet")
    assert recording.names == NAMES
    assert (recording.metadata.mapping or {})["lock"] == {"finger_1": 0.0}
    at = np.round(np.interp(recording.time, log["t"], np.arange(len(log["t"])))).astype(int)
    np.testing.assert_allclose(recording.position, log["position"][at], atol=1e-4)
    np.testing.assert_allclose(recording.measured("torque"), log["torque"][at], atol=1e-4)
    done = command_line("identify", "log.parquet", "--model", "robot.urdf", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["estimates"]


def test_a_mapping_is_written_whatever_is_found(tmp_path: Path) -> None:
    """Positions that no joint has, in a unit that the log states: refused, with the line."""
    log = moved(1, arm="puma")
    log["position"] += 200.0
    done = new(tmp_path, log, WITH_UNITS, arm="puma")
    lines = (tmp_path / "log.toml").read_text().splitlines()
    assert len(tomllib.loads("\n".join(lines))["position"]["columns"]) == 3
    assert done.returncode == 2
    found = re.search(r"log.toml:([0-9]+): ", done.stderr)
    assert found is not None
    assert lines[int(found[1]) - 1].startswith("unit = ")
    assert not (tmp_path / "log.parquet").exists()


def test_encoders_that_wrap_are_unwrapped_and_a_step_is_named(tmp_path: Path) -> None:
    """One counts from 0 to 360 degrees, one is re-homed by three degrees at 7 s."""
    log = moved(2)
    true = log["position"].copy()
    log["position"][:, 5] = np.mod(log["position"][:, 5], 2 * np.pi)
    log["position"][700:, 4] += np.deg2rad(3)
    done = new(tmp_path, log)
    recording = tb.Recording.load(tmp_path / "log.parquet")
    apart = recording.position[:, 5] - true[: recording.samples, 5]
    np.testing.assert_allclose(apart, apart[0], atol=1e-9)
    said = {each.code: each for each in recording.metadata.diagnostics}
    assert said["position.step"].subject == NAMES[4]
    assert said["position.step"].value == pytest.approx(np.deg2rad(3), rel=0.02)
    assert "position.unwrapped" in said
    first = next(line for line in (done.stdout + done.stderr).splitlines() if "warning" in line)
    assert NAMES[4] in first


def test_logs_of_any_length_and_ending_end_in_words(tmp_path: Path) -> None:
    """Parquet is not replaced by the recording that is made of it; half a second says little."""
    arm_with_fingers(tmp_path)
    log = moved(3)
    for samples in (60, 120, 240):
        columns = {"t": log["t"][:samples]}
        for kind, head in (("position", "q"), ("torque", "tau")):
            columns |= {f"{head}_{n}": x[:samples] for n, x in zip(NAMES, log[kind].T, strict=True)}
        pq.write_table(pa.table(columns), tmp_path / f"log{samples}.parquet")
        before = (tmp_path / f"log{samples}.parquet").read_bytes()
        new = command_line(
            "new", "robot.urdf", "--recording", f"log{samples}.parquet", cwd=tmp_path
        )
        assert new.returncode in (0, 2), new.stderr
        assert (tmp_path / f"log{samples}.toml").exists()
        assert (tmp_path / f"log{samples}.parquet").read_bytes() == before
        made = f"log{samples}_recording.parquet"
        done = command_line("identify", made, "--model", "robot.urdf", "--json", cwd=tmp_path)
        assert done.returncode in (0, 2), done.stderr


def test_torques_that_no_robot_makes_are_not_explained(tmp_path: Path) -> None:
    """External torques in place of the drives': said first, and nothing is solved from them."""
    log = moved(4)
    log["torque"] = 0.1 * np.random.default_rng(5).normal(size=log["torque"].shape)
    done = new(tmp_path, log, WITH_UNITS)
    mapping = tomllib.loads((tmp_path / "log.toml").read_text())
    assert not {"offset", "sign"} & {*mapping["position"], *mapping["torque"]}
    assert done.returncode == 2 or "not explained" in done.stdout + done.stderr
