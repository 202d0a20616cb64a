"""Velocities held against positions: what is wrong is told with the line that cures it."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError
from testbed.recordings.importing.foreign_units import UNITS, factor
from tests.helpers.ideal import ideal
from tests.helpers.runs import robot

JOINTS = robot("ur5").names
N = len(JOINTS)
UNIT = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
TURNS = [unit for unit in UNITS["velocity"] if "m" not in unit.split("/")[0] or unit == "mrad/s"]


def log(folder: Path, seed: int = 0, noise: float = 0.0) -> None:
    """What a UR5 did, in radians."""
    made, rng = ideal(robot("ur5"), duration=8, rate=100, seed=seed), np.random.default_rng(seed)
    kinds: dict[str, Any] = {}
    for kind in (*UNIT, "torque"):
        values = made.measured(kind)
        kinds[kind] = values + noise * np.std(values) * rng.normal(size=values.shape)
    np.savez(folder / "log.npz", **kinds)


def columns(kind: str, order: Any = range(N)) -> list[str]:
    return [f"{kind}[{k}]" for k in order]


def mapping(**changed: dict[str, Any]) -> str:
    """A mapping of it, right but for what is changed."""
    tables: dict[str, dict[str, Any]] = {
        "position": {"columns": columns("position"), "unit": "rad"},
        "velocity": {"columns": columns("velocity"), "unit": "rad/s"},
        "torque": {"columns": columns("torque"), "unit": "N m"},
    }
    for kind, keys in changed.items():
        tables[kind] = {"columns": columns(kind), "unit": UNIT[kind]} | tables.get(kind, {}) | keys
    lines = ["rate = 100", f"joints = {json.dumps(JOINTS)}"]
    lines += ["[sources.log]", 'file = "log.npz"', "rate = 100"]
    for kind, table in tables.items():
        lines += [f"[{kind}]", 'source = "log"']
        lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    return "\n".join(lines) + "\n"


def imported(folder: Path, text: str) -> tb.Recording:
    (folder / "map.toml").write_text(text)
    return tb.Recording.from_mapping(folder / "map.toml")


def cure(folder: Path, text: str) -> dict[str, dict[str, Any]]:
    """The mapping's lines in a refusal, as tables."""
    with pytest.raises(RecordingError) as refused:
        imported(folder, text)
    said = str(refused.value).partition("in the mapping: ")[2].rpartition("; or leave")[0]
    found: dict[str, dict[str, Any]] = {}
    for part in said.split(" and "):
        kind, _, keys = part.strip("[").partition("] ")
        lines = keys.replace(", sign", "\nsign").replace(", unit", "\nunit")
        found[kind] = tomllib.loads(lines)
    return found


@pytest.mark.parametrize("seed", range(12))
def test_the_cure_of_a_wrong_velocity_makes_it_right(seed: int, tmp_path: Path) -> None:
    """Unit, signs and order, alone and together, drawn at random; noise of 2 % besides."""
    rng = np.random.default_rng([3, seed])
    log(tmp_path, seed, noise=0.02)
    wrong: dict[str, Any] = {}
    if seed % 4 in (0, 3):
        wrong["unit"] = str(rng.choice([u for u in TURNS if u != "rad/s"]))
    if seed % 4 in (1, 3):
        wrong["sign"] = rng.permutation([-1, -1, *rng.choice([1, -1], N - 2)]).tolist()
    if seed % 4 in (2, 3):
        wrong["columns"] = columns("velocity", np.roll(rng.permutation(N), 1))
        while wrong["columns"] == columns("velocity"):
            wrong["columns"] = columns("velocity", rng.permutation(N))
    found = cure(tmp_path, mapping(velocity=wrong))
    assert set(found) == {"velocity"}
    made = imported(tmp_path, mapping(velocity=wrong | found["velocity"]))
    right = ideal(robot("ur5"), duration=8, rate=100, seed=seed).measured("velocity")
    assert np.corrcoef(made.measured("velocity").ravel(), right.ravel())[0, 1] > 0.99
    assert np.std(made.measured("velocity")) == pytest.approx(np.std(right), rel=0.01)


def test_degrees_taken_for_radians_are_told_by_the_velocity(tmp_path: Path) -> None:
    """No unit of velocities is so much larger: it is the position's that is wrong."""
    log(tmp_path)
    data: dict[str, Any] = dict(np.load(tmp_path / "log.npz"))
    np.savez(
        tmp_path / "log.npz", **data | {"position": data["position"] / factor("position", "deg")}
    )
    assert cure(tmp_path, mapping()) == {"position": {"unit": "deg"}}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("wrong", ["position", "velocity"])
@pytest.mark.parametrize(("was", "said"), [("rad", "deg"), ("deg", "rad")])
def test_which_of_two_is_in_degrees_is_told_by_their_sizes(
    wrong: str, was: str, said: str, seed: int, tmp_path: Path
) -> None:
    """Both are in one unit in the file, and the mapping says another of one of them."""
    log(tmp_path, seed)
    data: dict[str, Any] = dict(np.load(tmp_path / "log.npz"))
    both = {kind: data[kind] / factor("position", was) for kind in ("position", "velocity")}
    np.savez(tmp_path / "log.npz", **data | both)
    units = {"position": was, "velocity": f"{was}/s"}
    mistaken = units | {wrong: units[wrong].replace(was, said)}
    tables = {kind: {"unit": unit} for kind, unit in mistaken.items()}
    assert cure(tmp_path, mapping(**tables)) == {wrong: {"unit": units[wrong]}}


@pytest.mark.parametrize("seed", range(3))
def test_a_dead_encoder_is_told_by_its_velocity(seed: int, tmp_path: Path) -> None:
    log(tmp_path, seed, noise=0.02)
    data: dict[str, Any] = dict(np.load(tmp_path / "log.npz"))
    data["position"][:, seed] = 0.0
    np.savez(tmp_path / "log.npz", **data)
    with pytest.raises(RecordingError, match=f"joint {JOINTS[seed]} is the same throughout"):
        imported(tmp_path, mapping())


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.2])
def test_a_right_velocity_is_taken_and_said_to_be_unused(noise: float, tmp_path: Path) -> None:
    log(tmp_path, noise=noise)
    made = imported(tmp_path, mapping())
    assert made.facts["import"]["signals"]["velocity"]["use"]
    assert not made.facts["import"]["signals"]["velocity"]["notes"] or noise > 0.1


def test_accelerations_are_held_against_velocities(tmp_path: Path) -> None:
    log(tmp_path)
    assert imported(tmp_path, mapping(acceleration={})).senses_kinematics
    wrong = mapping(acceleration={"unit": "deg/s^2"})
    assert cure(tmp_path, wrong) == {"acceleration": {"unit": "rad/s^2"}}


def test_a_robot_at_rest_says_nothing(tmp_path: Path) -> None:
    log(tmp_path)
    data: dict[str, Any] = dict(np.load(tmp_path / "log.npz"))
    still = {"position": np.zeros_like(data["position"]) + 0.3, "velocity": 0 * data["velocity"]}
    np.savez(tmp_path / "log.npz", **data | still)
    made = imported(tmp_path, mapping())
    assert not made.facts["import"]["signals"]["velocity"]["notes"]
