"""What a mapping file says of units, signs, gears and places; nothing of which is guessed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import ExperimentError, RecordingError, TestbedError
from testbed.recordings.importing.foreign_units import UNITS, plain
from testbed.recordings.importing.guess import guessed
from testbed.robot.rotations import from_rpy
from tests.helpers.foreign_files import FORMATS, Log, csv, npz, some_log
from tests.helpers.refusals import is_message, refuses

ANGLES, TORQUES, FORCES = 'unit = "rad"', 'unit = "N m"', '["N", "N m"]'


def imported(folder: Path, text: str) -> tb.Recording:
    (folder / "map.toml").write_text(text)
    return tb.Recording.from_mapping(folder / "map.toml")


@pytest.fixture
def log() -> Log:
    return some_log()


@pytest.fixture
def text(tmp_path: Path, log: Log) -> str:
    return npz(tmp_path, log)


def test_units_are_what_they_are_however_they_are_written(
    text: str, tmp_path: Path, log: Log
) -> None:
    """Known factors, written down here a second time."""
    known = {"deg": 0.017453292519943295, "mm": 1e-3, "turn": 6.283185307179586,
             "N mm": 1e-3, "lbf ft": 1.3558179483314004, "kgf m": 9.80665, "inch": 0.0254,
             "mrad": 1e-3}  # fmt: skip
    for kind, old, raw in (("position", ANGLES, log.q), ("torque", TORQUES, log.tau)):
        for unit in [unit for unit in known if unit in UNITS[kind]]:
            found = imported(tmp_path, text.replace(old, f'unit = "{unit}"')).measured(kind)
            np.testing.assert_allclose(found, raw * known[unit], rtol=1e-15)
    for unit, newton in {"kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665}.items():
        found = imported(tmp_path, text.replace(FORCES, f'["{unit}", "N m"]')).measured("wrench")
        np.testing.assert_allclose(found[:, :3], newton * log.w[:, :3], rtol=1e-12)
        np.testing.assert_allclose(found[:, 3:], log.w[:, 3:], rtol=1e-12)
    said = {"Nm": "N m", "N*m": "N m", "N.m": "N m", "Nmm": "N mm", "degree": "deg",
            "radians": "rad", "rev": "turn", "  N   mm ": "N mm", "furlong": "furlong"}  # fmt: skip
    assert {each: plain(each) for each in said} == said


def test_signs_gains_offsets_matrices_and_gears_are_applied(
    text: str, tmp_path: Path, log: Log
) -> None:
    """Y = sign gain unit x + offset, column by column; a gear keeps power."""

    def same(one: Any, other: Array) -> None:
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15)

    said = text.replace(ANGLES, f"{ANGLES}\nsign = [1, -1]\noffset = [0.5, -2]")
    found = imported(tmp_path, said.replace(TORQUES, 'unit = ["mA", "V"]\ngain = [2.5, -4]'))
    same(found.position, log.q * [1, -1] + [0.5, -2])
    same(found.torque, log.tau * [2.5e-3, -4])
    matrix = [[1.0, 2.0], [0.0, -3.0]]
    found = imported(tmp_path, text.replace(ANGLES, f"{ANGLES}\nmatrix = {matrix}"))
    same(found.position, log.q @ np.array(matrix).T)
    motor = text.replace(ANGLES, f'{ANGLES}\nside = "motor"')
    both = motor.replace(TORQUES, f'{TORQUES}\nside = "motor"')
    gear = np.array([[30.0, 0.0], [12.0, -45.0]])
    found = imported(tmp_path, f"{both}[gear]\nmatrix = {gear.tolist()}\n")
    same(found.position @ gear.T, log.q)
    power = np.diff(found.position, axis=0) * found.measured("torque")[1:]
    same(power.sum(axis=1), (np.diff(log.q, axis=0) * log.tau[1:]).sum(axis=1))
    mixed = motor.replace(TORQUES, f'{TORQUES}\nside = "joint"')
    found = imported(tmp_path, f"{mixed}[gear]\nratio = [30, -45]\n")
    same(found.position, log.q / [30, -45])
    same(found.torque, log.tau)
    found = imported(tmp_path, text.replace(ANGLES, 'unit = ["deg", "mm"]'))
    assert {name: each["kind"] for name, each in found.facts["geometry"].items()} == {
        "j1": "revolute", "j2": "prismatic",
    }  # fmt: skip
    assert found.units()["position/j2"] == "m"


@pytest.mark.parametrize("sense", ["on_robot", "on_plate"])
def test_a_wrench_is_taken_to_the_bedplate(sense: str, text: str, tmp_path: Path, log: Log) -> None:
    """Its power along any rigid motion is the same at the sensor and at the bedplate."""
    place = "place = { xyz = [0.1, -0.2, 0.3], rpy = [0.3, -0.4, 2.0] }\ntare = [1, 2, 98, 0, 0, 4]"
    said = text.replace('sense = "on_robot"', f'sense = "{sense}"\n{place}')
    said = said.replace("rate = 100", "rate = 100\ngravity = [0, 0, -9.8]")
    made = imported(tmp_path, said.replace(FORCES, '["kN", "N cm"]'))
    turn, origin = from_rpy([0.3, -0.4, 2.0]), np.array([0.1, -0.2, 0.3])
    speed, spin = np.random.default_rng(1).normal(size=(2, 3))
    there = turn.T @ (speed + np.cross(spin, origin)), turn.T @ spin
    factor = 1 if sense == "on_robot" else -1
    wanted = factor * (log.w[:, :3] @ there[0] * 1e3 + log.w[:, 3:] @ there[1] * 1e-2)
    found = made.measured("wrench") @ np.concatenate([speed, spin])
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    made.save(tmp_path / "made.parquet")
    again = tb.Recording.load(tmp_path / "made.parquet")
    assert (again.facts["gravity"], np.asarray(again.tare).tolist()) == (
        [0, 0, -9.8], [1, 2, 98, 0, 0, 4],
    )  # fmt: skip
    assert again.facts["mapping"]["wrench"]["sense"] == sense


def test_what_the_file_says_of_units_is_held_against_the_mapping(tmp_path: Path, log: Log) -> None:
    """But for what a matrix takes to a wrench: six bridges are none."""
    text = FORMATS["hdf5"](tmp_path, log)
    for name, unit, said in (("q", "deg", "rad"), ("w", "kN", "N")):
        with h5py.File(tmp_path / "log.h5", "a") as file:
            file[f"log/{name}"].attrs["unit"] = unit
        with refuses(RecordingError, f"'log/{name}[0]'", unit, said):
            imported(tmp_path, text)
        with h5py.File(tmp_path / "log.h5", "a") as file:
            file[f"log/{name}"].attrs["unit"] = unit if name == "w" else said
    matrix = (2 * np.eye(6)).tolist()
    found = imported(tmp_path, text.replace("units = [", f"matrix = {matrix}\nunits = ["))
    np.testing.assert_allclose(found.measured("wrench"), 2 * log.w, rtol=1e-9)


def without(table: str) -> Callable[[str], str]:
    """A mapping without one of its tables."""

    def change(text: str) -> str:
        head, _, rest = text.partition(f"[{table}]")
        _, bracket, others = rest.partition("\n[")
        return head + bracket.lstrip("\n") + others

    return change


def added(line: str, table: str = "sources.log") -> Callable[[str], str]:
    return lambda text: text.replace(f"[{table}]\n", f"[{table}]\n{line}\n", 1)


def other(old: str, new: str = "") -> Callable[[str], str]:
    return lambda text: text.replace(old, new, 1)


def last(lines: str) -> Callable[[str], str]:
    return lambda text: f"{text}\n{lines}\n"


QUATERNION = json.dumps([f"w[{k}]" for k in range(4)])
BASE = f'[base]\nsource = "log"\nposition = ["q[0]", "q[1]", "w[0]"]\nquaternion = {QUATERNION}'
CHANNELS = json.dumps([f"w[{k}]" for k in range(6)])
PLATE = f'[plates.left]\nsource = "log"\nunits = {FORCES}\nsense = "on_robot"\ncolumns = {CHANNELS}'

WRONG: tuple[tuple[Callable[[str], str], tuple[str, ...]], ...] = (
    (other(ANGLES), ("position.unit",)),
    (other(TORQUES), ("torque.unit",)),
    (other('sense = "on_robot"'), ("wrench.sense",)),
    (other(f"units = {FORCES}"), ("wrench.units",)),
    (other('time = "t"\n'), ("sources.log", "`time`")),
    (other('time_unit = "s"'), ("sources.log", "time_unit")),
    (other("rate = 100"), ("rate",)),
    (other("rate = 100", "rat = 100"), ("'rat'", "'rate'")),
    (other("rate = 100", "rate = 1e12"), ("1e+12",)),
    (other("rate = 100", "rate = 100\nstart = 9"), ("start = 9",)),
    (other("rate = 100", "rate = 100\nstart = 1.0\nstop = 1.0"), ("start", "stop")),
    (other(ANGLES, 'unit = "grad"'), ("'grad'", "'rad'")),
    (other(TORQUES, 'unit = "A"'), ("'A'", "gain")),
    (other(TORQUES, f"{TORQUES}\ngain = 2.0"), ("torque", "'N m'")),
    (added("gain = 2.0", "position"), ("position.gain",)),
    (added('side = "motor"', "position"), ("side", "gear")),
    (added("sign = [1]", "position"), ("position.sign", "1", "2")),
    (added("sign = [1, 2]", "position"), ("position.sign",)),
    (other('["q[0]", "q[1]"]', '["q[0]"]'), ("1 column", "2 joints")),
    (other('["q[0]", "q[1]"]', '["q[0]", "q[7]"]'), ("'q[7]'",)),
    (added("matrix = [[1, 0, 0], [0, 1, 0]]", "position"), ("position.matrix",)),
    (other(', "w[5]"'), ("wrench.columns", "5")),
    (added(f"matrix = {[[0.0] * 6] * 5}", "wrench"), ("wrench.matrix",)),
    (added(f"matrix = {[[0.0] * 5] * 6}", "wrench"), ("wrench.matrix",)),
    (added("plaec = 1", "wrench"), ("'plaec'", "'place'")),
    (added("timeunit = 's'"), ("sources.log", "'timeunit'", "'time_unit'")),
    (added('topic = "/joints"'), ("topic",)),
    (other('time = "t"\ntime_unit = "s"', "rate = 100\nsteady = true"), ("steady", "time")),
    (other('["j1", "j2"]', '["j1", "j1"]'), ("joints",)),
    (other('["j1", "j2"]', '["j1", "j\\u0007"]'), ("joints",)),
    (other('source = "log"', 'source = "lag"'), ("'lag'",)),
    (other('file = "log.npz"', 'file = "log.xls"'), ("log.xls",)),
    (other('"log.npz"', '"log\\u0000.npz"'), ("file",)),
    (other('"log.npz"', '"map.toml"'), ("'.toml'",)),
    (other('"log.npz"', '"."'), ("folder",)),
    (lambda text: without("torque")(without("wrench")(text)), ("torque", "wrench")),
    (last(PLATE), ("wrench", "plates")),
    (last("[gear]\nratio = [2, 0]"), ("gear", "ratio")),
    (last("[gear]\nratio = [2, 2, 2]"), ("gear", "3 motors", "2 joints")),
    (last("[gear]\nratio = [2, 2]\nmatrix = [[1, 0], [0, 1]]"), ("gear", "ratio", "matrix")),
    (last("[gear]"), ("gear", "ratio", "matrix")),
    (last("[gear]\nmatrix = [[1, 0], [0]]"), ("gear", "matrix")),
    (last("[gear]\nmatrix = [[1, 1], [1, 1]]"), ("gear", "matrix")),
    (last(f'{BASE}\nunit = "rad"'), ("base.unit", "'rad'")),
    (last(f'{BASE}\nunit = "m"'), ("base.quaternion",)),
    (last(f'{BASE}\nunit = "m"\ncolumns = []'), ("base", "'columns'", "quaternion")),
    (last('[sources.more]\nfile = "log.npz"\nrate = 100'), ("sources.more",)),
)
"""What is changed in a mapping that is right, and the culprits that its refusal names."""


def test_a_wrong_mapping_is_answered_by_naming_the_key(text: str, tmp_path: Path) -> None:
    imported(tmp_path, text)
    for change, culprits in WRONG:
        wrong = change(text)
        assert wrong != text, culprits
        with pytest.raises(TestbedError) as refused:
            imported(tmp_path, wrong)
        said = str(refused.value)
        assert all(each in said for each in culprits), said
        assert is_message(said.replace(str(tmp_path), "")), said


def test_columns_without_numbers_of_one_length_and_time_are_named(
    text: str, tmp_path: Path, log: Log
) -> None:
    def refused(changed: dict[str, Any], *culprits: str) -> None:
        np.savez(tmp_path / "log.npz", **{**vars(log), **changed})
        with refuses(RecordingError, *culprits):
            imported(tmp_path, text)

    holed = {name: np.array(getattr(log, name)) for name in ("t", "q")}
    holed["t"][7], holed["q"][7, 1] = np.nan, np.nan
    refused({"t": holed["t"]}, "sources.log", "'t'", "sample 7")
    refused({"q": holed["q"]}, "sources.log", "'q[1]'", "sample 7")
    refused({"tau": log.tau[:-2]}, "sources.log", "'q[0]' 60", "'tau[0]' 58")
    for times in (1e-9, 1e12):
        refused({"t": log.t * times}, "time_unit")
    with refuses(RecordingError, "sources.log", "3 samples"):
        imported(tmp_path, csv(tmp_path, some_log(3)))
    bag = FORMATS["bag"](tmp_path, log)
    lines = [line for line in bag.splitlines() if "topic" not in line]
    with refuses(RecordingError, "topic"):
        imported(tmp_path, "\n".join(lines))
    found = imported(tmp_path, csv(tmp_path, log).replace('"s"', '"ms"').replace("100", "100000"))
    assert found.rate == pytest.approx(1e5)


def test_a_guess_is_a_mapping_once_it_is_filled_in_and_what_grows_is_no_clock(
    tmp_path: Path, log: Log
) -> None:
    FORMATS["bag"](tmp_path, log)
    text = guessed([tmp_path / "log.bag"], tmp_path).text
    start, end = text.index("[velocity]"), text.index("[torque]")
    text = (text[:start] + text[end:]).replace('sense = ""', 'sense = "on_robot"')
    text = text.replace('units = ["", ""]', f"units = {FORCES}")
    text = text.replace('unit = ""', ANGLES, 1).replace('unit = ""', TORQUES)
    found = imported(tmp_path, text)
    np.testing.assert_array_equal(found.position, log.q)
    np.testing.assert_array_equal(found.wrench, log.w)
    for first in ("time", "count"):
        rows = "".join(f"{k / 10},{k % 3}\n" for k in range(9))
        (tmp_path / "log.csv").write_text(f"{first},q\n{rows}")
        told = guessed([tmp_path / "log.csv"], tmp_path).content["sources"]["log"].get("time")
        assert told == ("time" if first == "time" else None)
    head = "t,q1,base_x,base_y,base_z,quat_w,quat_x,quat_y,quat_z"
    lines = [f"{0.01 * k:.2f},{k},0,0,1,1,0,0,0" for k in range(5)]
    (tmp_path / "walk.csv").write_text("\n".join([head, *lines]) + "\n")
    base = guessed([tmp_path / "walk.csv"], tmp_path).content["base"]
    assert (base["source"], base["position"], base["quaternion"]) == ("log", [""] * 3, [""] * 4)
    with pytest.raises(ExperimentError):
        imported(tmp_path, guessed([tmp_path / "walk.csv"], tmp_path).text)
