"""What a mapping file says of units, signs, gears and places; nothing of which is guessed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, TestbedError
from testbed.core.robot.rotations import rpy_to_matrix
from testbed.importing.foreign_table import UNITS_BY_QUANTITY, canonical_unit
from tests.helpers.foreign_files import FORMATS, Log, csv, imported, npz, some_log
from tests.helpers.refusals import is_message, refuses

ANGLES, TORQUES, FORCES = 'unit = "rad"', 'unit = "N m"', '["N", "N m"]'


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
        for unit in [unit for unit in known if unit in UNITS_BY_QUANTITY[kind]]:
            found = imported(tmp_path, text.replace(old, f'unit = "{unit}"')).measured(kind)
            np.testing.assert_allclose(found, raw * known[unit], rtol=1e-15)
    for unit, newton in {"kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665}.items():
        found = imported(tmp_path, text.replace(FORCES, f'["{unit}", "N m"]')).measured("wrench")
        np.testing.assert_allclose(found[:, :3], newton * log.w[:, :3], rtol=1e-12)
        np.testing.assert_allclose(found[:, 3:], log.w[:, 3:], rtol=1e-12)
    said = {"Nm": "N m", "N*m": "N m", "Nmm": "N mm", "degree": "deg", "rev": "turn",
            "  N   mm ": "N mm", "furlong": "furlong"}  # fmt: skip
    assert {each: canonical_unit(each) for each in said} == said


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
    kinds = [each.kind for each in found.metadata.geometry.values()]
    assert (kinds, found.units()["position/j2"]) == (["revolute", "prismatic"], "m")


def test_a_wrench_is_taken_to_the_bedplate(text: str, tmp_path: Path, log: Log) -> None:
    """Its power along any rigid motion is the same at the sensor and at the bedplate."""
    place = "place = { xyz = [0.1, -0.2, 0.3], rpy = [0.3, -0.4, 2.0] }\ntare = [1, 2, 98, 0, 0, 4]"
    text = text.replace("rate = 100", "rate = 100\ngravity = [0, 0, -9.8]")
    turn, origin = rpy_to_matrix([0.3, -0.4, 2.0]), np.array([0.1, -0.2, 0.3])
    speed, spin = np.random.default_rng(1).normal(size=(2, 3))
    there = turn.T @ (speed + np.cross(spin, origin)), turn.T @ spin
    power = log.w[:, :3] @ there[0] * 1e3 + log.w[:, 3:] @ there[1] * 1e-2
    for sense, sign in (("on_robot", 1), ("on_plate", -1)):
        said = text.replace('sense = "on_robot"', f'sense = "{sense}"\n{place}')
        made = imported(tmp_path, said.replace(FORCES, '["kN", "N cm"]'))
        found = made.measured("wrench") @ np.concatenate([speed, spin])
        np.testing.assert_allclose(found, sign * power, rtol=1e-12)
        assert made.metadata.gravity == (0, 0, -9.8)
        assert np.asarray(made.tare).tolist() == [1, 2, 98, 0, 0, 4]
        assert (made.metadata.mapping or {})["wrench"]["sense"] == sense


def test_what_the_file_says_of_units_is_held_against_the_mapping(tmp_path: Path, log: Log) -> None:
    """But for what a matrix takes to a wrench: six bridges are none."""
    text = FORMATS["parquet"](tmp_path, log)
    with refuses(RecordingError, "ns", "ms"):
        imported(tmp_path, text.replace('time = "t"', 'time = "t"\ntime_unit = "ms"'))
    text = FORMATS["hdf5"](tmp_path, log)
    for name, unit, said in (("q", "deg", "rad"), ("w", "kN", "N")):
        with h5py.File(tmp_path / "log.h5", "a") as file:
            file[f"log/{name}"].attrs["unit"] = unit
        with refuses(RecordingError, f"'log/{name}[0]'", unit, said):
            imported(tmp_path, text)
        if name == "q":
            text = text.replace(ANGLES, 'unit = "deg"')
    matrix = (2 * np.eye(6)).tolist()
    found = imported(tmp_path, text.replace("units = [", f"matrix = {matrix}\nunits = ["))
    np.testing.assert_allclose(found.measured("wrench"), 2 * log.w, rtol=1e-9)


POSITION = "[position]\n"
BASE = '[base]\nsource = "log"\nposition = ["t", "t", "t"]\nquaternion = ["t", "t", "t", "t"]\n'
WRONG: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    (ANGLES, "", ("position.unit",)),
    ('sense = "on_robot"', "", ("wrench.sense",)),
    (f"units = {FORCES}", "", ("wrench.units",)),
    ('time = "t"\n', "", ("sources.log", "`time`")),
    ('time_unit = "s"', "", ("sources.log", "time_unit")),
    ("rate = 100", "rate = 1e12", ("1e+12",)),
    ("rate = 100", "rate = 100\nstart = 9", ("start = 9",)),
    (ANGLES, 'unit = "grad"', ("'grad'", "'rad'")),
    (TORQUES, 'unit = "A"', ("'A'", "gain")),
    (TORQUES, f"{TORQUES}\ngain = 2.0", ("torque", "'N m'")),
    (POSITION, f'{POSITION}side = "motor"\n', ("side", "gear")),
    (POSITION, f"{POSITION}sign = [1, 2]\n", ("position.sign",)),
    (POSITION, f"{POSITION}matrix = [[1, 0, 0], [0, 1, 0]]\n", ("position.matrix",)),
    ('["q[0]", "q[1]"]', '["q[0]"]', ("1 column", "2 joints")),
    ('["q[0]", "q[1]"]', '["q[0]", "q[7]"]', ("'q[7]'",)),
    (', "w[5]"', "", ("wrench.columns", "5")),
    ('["j1", "j2"]', '["j1", "j1"]', ("joints",)),
    ('source = "log"', 'source = "lag"', ("'lag'",)),
    (POSITION, f"[gear]\nratio = [2, 0]\n{POSITION}", ("gear", "ratio")),
    (POSITION, f"[gear]\nmatrix = [[1, 1], [1, 1]]\n{POSITION}", ("gear", "matrix")),
    (POSITION, f'{BASE}unit = "rad"\n{POSITION}', ("base.unit", "'rad'")),
    (POSITION, f'[sources.more]\nfile = "log.npz"\nrate = 100\n{POSITION}', ("sources.more",)),
)
"""What is put in the place of what, in a mapping that is right, and the culprits named."""


def test_a_wrong_mapping_is_answered_by_naming_the_key(text: str, tmp_path: Path) -> None:
    imported(tmp_path, text)
    for old, new, culprits in WRONG:
        with pytest.raises(TestbedError) as refused:
            imported(tmp_path, text.replace(old, new, 1))
        said = str(refused.value)
        assert all(each in said for each in culprits), said
        assert is_message(said.replace(str(tmp_path), "")), said


def test_columns_without_numbers_of_one_length_and_time_are_named(
    text: str, tmp_path: Path, log: Log
) -> None:
    cases: list[tuple[dict[str, Array], tuple[str, ...]]] = [
        ({"t": np.full(60, np.nan)}, ("sources.log", "'t'")),
        ({"tau": log.tau * [1, np.nan]}, ("sources.log", "'tau[1]'", "[torque]")),
        ({"tau": log.tau[:-2]}, ("sources.log", "'q[0]' 60", "'tau[0]' 58")),
        *(({"t": log.t * scale}, ("time_unit",)) for scale in (1e-9, 1e12)),
    ]
    for changed, culprits in cases:
        np.savez(tmp_path / "log.npz", **{**vars(log), **changed})
        with refuses(RecordingError, *culprits):
            imported(tmp_path, text)
    with refuses(RecordingError, "sources.log", "3 samples"):
        imported(tmp_path, csv(tmp_path, some_log(3)))
    found = imported(tmp_path, csv(tmp_path, log).replace('"s"', '"ms"').replace("100", "100000"))
    assert found.rate == pytest.approx(1e5)
