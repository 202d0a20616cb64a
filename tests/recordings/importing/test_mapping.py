"""What a mapping file says: units, signs, gears, places; nothing of which is guessed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ExperimentError, RecordingError
from testbed.recordings.importing.foreign_units import UNITS, plain
from testbed.recordings.importing.guess import guessed
from testbed.recordings.importing.mapping import read_mapping
from testbed.robot.rotations import from_rpy
from tests.helpers.foreign_files import FORMATS, Log, csv, npz, some_log

PLACE = "place = { xyz = [0.1, -0.2, 0.3], rpy = [0.3, -0.4, 2.0] }"


def imported(folder: Path, text: str) -> tb.Recording:
    (folder / "map.toml").write_text(text)
    return tb.Recording.from_mapping(folder / "map.toml")


@pytest.fixture
def log() -> Log:
    return some_log()


@pytest.fixture
def text(tmp_path: Path, log: Log) -> str:
    return npz(tmp_path, log)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('unit = "rad"', "position.unit: Field required"),
        ('unit = "N m"', "torque.unit: Field required"),
        ('sense = "on_robot"', "wrench.sense: Field required"),
        ('units = ["N", "N m"]', "wrench.units: Field required"),
        ('time = "t"\n', "a source has a clock"),
        ('time_unit = "s"', "sources.log: say `time_unit`"),
        ("rate = 100", "rate: Field required"),
    ],
)
def test_units_sense_and_clocks_have_no_defaults(
    line: str, said: str, text: str, tmp_path: Path
) -> None:
    with pytest.raises((ExperimentError, RecordingError), match=said):
        imported(tmp_path, text.replace(line, "", 1))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("rate = 100", "rat = 100", "unknown key 'rat'; did you mean 'rate'"),
        ('unit = "rad"', 'unit = "grad"', "unknown unit of position 'grad'; did you mean 'rad'"),
        ('unit = "N m"', 'unit = "A"', "'A' is no torque; say `gain`"),
        ('unit = "N m"', 'unit = "N m"\ngain = 2.0', "unknown unit of torque with a gain 'N m'"),
        ('unit = "rad"', 'unit = "rad"\nside = "motor"', "`side` needs a table .gear."),
        ('unit = "rad"', 'unit = "rad"\nsign = [1]', "position.sign: 1 given, 2 wanted"),
        ('unit = "rad"', 'unit = "rad"\nsign = [1, 2]', "position.sign"),
        ('["q[0]", "q[1]"]', '["q[0]"]', "1 column, 2 joints, and no matrix"),
        ('["q[0]", "q[1]"]', '["q[0]", "q[7]"]', "unknown column of .* 'q.7.'"),
        ('["j1", "j2"]', '["j1", "j1"]', "a name is there twice"),
        ('source = "log"', 'source = "lag"', "there is no source 'lag'"),
        ('file = "log.npz"', 'file = "log.xls"', "there is no file"),
        ("rate = 100", "rate = 1e12", "too many for memory"),
        ("rate = 100", "rate = 100\nstart = 9", "leaves nothing"),
        ("rate = 100", "rate = 100\n[gear]\nratio = [2, 0]", "no ratio is zero"),
    ],
)
def test_what_is_not_understood_is_one_line_with_what_is_known(
    old: str, new: str, said: str, text: str, tmp_path: Path
) -> None:
    head, found, rest = text.partition(old)
    assert found
    if "[gear]" in new:
        new, rest = old, rest + "\n[gear]\nratio = [2, 0]\n"
    with pytest.raises(tb.TestbedError, match=said) as error:
        imported(tmp_path, head + new + rest)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", ["position", "torque"])
def test_units_are_what_they_are(kind: str, text: str, tmp_path: Path, log: Log) -> None:
    """Known factors, written down here a second time; SI units divide them out again."""
    known = {"deg": 0.017453292519943295, "mm": 1e-3, "turn": 6.283185307179586,
             "N mm": 1e-3, "lbf ft": 1.3558179483314004, "kgf m": 9.80665, "inch": 0.0254,
             "mrad": 1e-3}  # fmt: skip
    old = 'unit = "rad"' if kind == "position" else 'unit = "N m"'
    for unit in [unit for unit in known if unit in UNITS[kind]]:
        found = imported(tmp_path, text.replace(old, f'unit = "{unit}"'))
        wanted = log.q if kind == "position" else log.tau
        np.testing.assert_allclose(found.measured(kind), wanted * known[unit], rtol=1e-15)


@pytest.mark.parametrize(
    ("unit", "newton"), [("kN", 1e3), ("lbf", 4.4482216152605), ("kgf", 9.80665)]
)
def test_forces_are_in_newtons(
    unit: str, newton: float, text: str, tmp_path: Path, log: Log
) -> None:
    found = imported(tmp_path, text.replace('["N", "N m"]', f'["{unit}", "N m"]'))
    np.testing.assert_allclose(found.measured("wrench")[:, :3], newton * log.w[:, :3], rtol=1e-12)


def test_positions_in_lengths_are_of_joints_that_slide(text: str, tmp_path: Path) -> None:
    found = imported(tmp_path, text.replace('unit = "rad"', 'unit = ["deg", "mm"]'))
    assert found.facts["geometry"] == {"j1": {"kind": "revolute"}, "j2": {"kind": "prismatic"}}
    assert found.units()["position/j2"] == "m"


def test_signs_gains_and_offsets(text: str, tmp_path: Path, log: Log) -> None:
    """Y = sign gain unit x + offset, column by column."""
    text = text.replace('unit = "rad"', 'unit = "rad"\nsign = [1, -1]\noffset = [0.5, -2]')
    text = text.replace('unit = "N m"', 'unit = ["mA", "V"]\ngain = [2.5, -4]')
    found = imported(tmp_path, text)
    np.testing.assert_allclose(found.position, log.q * [1, -1] + [0.5, -2], rtol=1e-15)
    np.testing.assert_allclose(found.measured("torque"), log.tau * [2.5e-3, -4], rtol=1e-15)


def test_a_gear_keeps_power(text: str, tmp_path: Path, log: Log) -> None:
    """Motor angles and torques through a coupled gear: what comes in comes out."""
    gear = np.array([[30.0, 0.0], [12.0, -45.0]])
    text = text.replace('unit = "rad"', 'unit = "rad"\nside = "motor"')
    text = text.replace('unit = "N m"', 'unit = "N m"\nside = "motor"')
    found = imported(tmp_path, text + f"[gear]\nmatrix = {gear.tolist()}\n")
    np.testing.assert_allclose(found.position @ gear.T, log.q, rtol=1e-12, atol=1e-15)
    motor = np.diff(log.q, axis=0) * log.tau[1:]
    joint = np.diff(found.position, axis=0) * found.measured("torque")[1:]
    np.testing.assert_allclose(joint.sum(axis=1), motor.sum(axis=1), atol=1e-15)
    ratio = text + "[gear]\nratio = [30, -45]\n"
    uncoupled = imported(tmp_path, ratio)
    np.testing.assert_allclose(uncoupled.position, log.q / [30, -45], rtol=1e-14)
    np.testing.assert_allclose(uncoupled.measured("torque"), log.tau * [30, -45], rtol=1e-14)


def test_a_matrix_takes_columns_to_joints(text: str, tmp_path: Path, log: Log) -> None:
    matrix = [[1.0, 2.0], [0.0, -3.0]]
    found = imported(tmp_path, text.replace('unit = "rad"', f'unit = "rad"\nmatrix = {matrix}'))
    np.testing.assert_allclose(found.position, log.q @ np.array(matrix).T, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("sense", ["on_robot", "on_plate"])
def test_a_wrench_is_taken_to_the_bedplate(sense: str, text: str, tmp_path: Path, log: Log) -> None:
    """Its power along any rigid motion is the same at the sensor and at the bedplate."""
    text = text.replace('sense = "on_robot"', f'sense = "{sense}"\n{PLACE}')
    found = imported(tmp_path, text.replace('["N", "N m"]', '["kN", "N cm"]')).measured("wrench")
    turn, place = from_rpy([0.3, -0.4, 2.0]), np.array([0.1, -0.2, 0.3])
    rng = np.random.default_rng(1)
    speed, spin = rng.normal(size=(2, 3))
    there = turn.T @ (speed + np.cross(spin, place)), turn.T @ spin
    factor = 1 if sense == "on_robot" else -1
    wanted = factor * (log.w[:, :3] @ there[0] * 1e3 + log.w[:, 3:] @ there[1] * 1e-2)
    np.testing.assert_allclose(found @ np.concatenate([speed, spin]), wanted, rtol=1e-12)


def test_what_the_file_says_of_units_is_held_against_the_mapping(tmp_path: Path, log: Log) -> None:
    import h5py

    text = FORMATS["hdf5"](tmp_path, log)
    with h5py.File(tmp_path / "log.h5", "a") as file:
        file["log/q"].attrs["unit"] = "deg"
    with pytest.raises(RecordingError, match="'log/q.0.' is in deg, the mapping says rad"):
        imported(tmp_path, text)


def test_units_of_what_a_matrix_takes_to_a_wrench_are_the_matrixs(tmp_path: Path, log: Log) -> None:
    """What six bridges say is no wrench; behind a matrix it need be none."""
    import h5py

    text = FORMATS["hdf5"](tmp_path, log)
    with h5py.File(tmp_path / "log.h5", "a") as file:
        file["log/w"].attrs["unit"] = "kN"
    with pytest.raises(RecordingError, match="is in kN, the mapping says N"):
        imported(tmp_path, text)
    matrix = (2 * np.eye(6)).tolist()
    found = imported(tmp_path, text.replace("units = [", f"matrix = {matrix}\nunits = ["))
    plain = imported(tmp_path, FORMATS["csv"](tmp_path, log))
    np.testing.assert_allclose(found.measured("wrench"), 2 * plain.measured("wrench"), rtol=1e-9)


def test_the_mapping_stays_with_the_recording(text: str, tmp_path: Path) -> None:
    text += "tare = [0, 0, 98.1, 0, 0, 0]\n"
    found = imported(tmp_path, text.replace("rate = 100", "rate = 100\ngravity = [0, 0, -9.8]"))
    found.save(tmp_path / "made.parquet")
    again = tb.Recording.load(tmp_path / "made.parquet")
    assert again.facts["mapping"]["position"]["unit"] == "rad"
    assert again.facts["gravity"] == [0, 0, -9.8]
    assert again.tare is not None
    assert again.tare.tolist() == [0, 0, 98.1, 0, 0, 0]


@pytest.mark.parametrize(("first", "clock"), [("time", True), ("count", False)])
def test_what_grows_is_a_clock_only_by_its_name(first: str, clock: bool, tmp_path: Path) -> None:
    rows = "".join(f"{k / 10},{k % 3}\n" for k in range(9))
    (tmp_path / "log.csv").write_text(f"{first},q\n{rows}")
    assert (f'time = "{first}"' in guessed([tmp_path / "log.csv"], tmp_path).text) is clock


@pytest.mark.parametrize("name", FORMATS)
def test_a_guess_names_all_columns_and_is_refused_until_it_is_filled_in(
    name: str, tmp_path: Path
) -> None:
    FORMATS[name](tmp_path, some_log())
    file = max(tmp_path.glob("log*"), key=lambda path: (path.is_file(), path.name))
    text = guessed([file], tmp_path).text
    (tmp_path / "guess.toml").write_text(text)
    with pytest.raises(ExperimentError) as error:
        read_mapping(tmp_path / "guess.toml")
    empty = {line.split(" = ")[0] for line in text.splitlines() if re.match(r'\w+ = .*""', line)}
    assert empty <= set(re.findall(r"\w+", str(error.value)))  # all at once
    telling = () if name in ("csv", "c3d") else ('unit = ""', 'units = ["", ""]', 'sense = ""')
    assert all(line in text for line in telling)


def test_a_guess_that_is_filled_in_is_a_mapping(tmp_path: Path, log: Log) -> None:
    FORMATS["bag"](tmp_path, log)
    text = guessed([tmp_path / "log.bag"], tmp_path).text
    start, end = text.index("[velocity]"), text.index("[torque]")
    text = (text[:start] + text[end:]).replace('sense = ""', 'sense = "on_robot"')
    text = text.replace('units = ["", ""]', 'units = ["N", "N m"]')
    text = text.replace('unit = ""', 'unit = "rad"', 1).replace('unit = ""', 'unit = "N m"')
    found = imported(tmp_path, text)
    assert found.names == ("j1", "j2")
    np.testing.assert_array_equal(found.position, log.q)
    np.testing.assert_array_equal(found.measured("wrench"), log.w)


def test_times_of_text_need_a_unit(tmp_path: Path, log: Log) -> None:
    text = csv(tmp_path, log).replace('time_unit = "s"', 'time_unit = "ms"')
    found = imported(tmp_path, text.replace("rate = 100", "rate = 100000"))
    assert found.rate == pytest.approx(1e5)


def test_a_guess_of_a_moving_base_names_its_source_and_leaves_the_choice(tmp_path: Path) -> None:
    head = "t,q1,base_x,base_y,base_z,quat_w,quat_x,quat_y,quat_z"
    lines = [f"{0.01 * k:.2f},{k},0,0,1,1,0,0,0" for k in range(5)]
    (tmp_path / "walk.csv").write_text("\n".join([head, *lines]) + "\n")
    table = guessed([tmp_path / "walk.csv"], tmp_path).text.partition("[base]")[2]
    assert table.splitlines()[1] == 'source = "log"'
    assert "# of these: " in table
    assert 'position = ["", "", ""]' in table
    assert 'quaternion = ["", "", "", ""]' in table
    assert "columns = " not in table


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("Nm", "N m"), ("N*m", "N m"), ("N.m", "N m"), ("Nmm", "N mm"), ("Ncm", "N cm"),
        ("degree", "deg"), ("degrees", "deg"), ("radian", "rad"), ("radians", "rad"),
        ("rev", "turn"), ("  N   mm ", "N mm"), ("kN", "kN"), ("furlong", "furlong"),
    ],
)  # fmt: skip
def test_other_ways_to_write_a_unit_are_known(said: str, meant: str) -> None:
    assert plain(said) == meant
