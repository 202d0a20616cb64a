"""Velocities held against positions: what is wrong is told with the line that cures it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from testbed.core.base.errors import RecordingError
from testbed.importing.derivative import DerivativeError
from testbed.importing.foreign_table import UNITS_BY_QUANTITY, unit_size
from testbed.importing.import_report import MappingDraft
from tests.helpers.foreign_files import imported
from tests.helpers.ideal import ideal
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot
from tests.helpers.strategies import few, seeds

JOINTS = robot("ur5").names
N = len(JOINTS)
UNIT = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
TURNS = [
    u for u in UNITS_BY_QUANTITY["velocity"] if u != "rad/s" and ("m" not in u[:1] or u == "mrad/s")
]


def log(folder: Path, seed: int = 0, noise: float = 0.0) -> dict[str, Any]:
    """What a UR5 did, in radians."""
    made, rng = ideal(robot("ur5"), duration=8, rate=100, seed=seed), np.random.default_rng(seed)
    kinds: dict[str, Any] = {}
    for kind in (*UNIT, "torque"):
        values = made.measured(kind)
        kinds[kind] = values + noise * np.std(values) * rng.normal(size=values.shape)
    np.savez(folder / "log.npz", **kinds)
    return kinds


def columns(kind: str, order: Any = range(N)) -> list[str]:
    return [f"{kind}[{k}]" for k in order]


def mapping(**changed: dict[str, Any]) -> str:
    """A mapping of it, right but for what is changed."""
    tables: dict[str, Any] = {"": {"rate": 100, "joints": [*JOINTS]}}
    tables["sources.log"] = {"file": "log.npz", "rate": 100}
    for kind, unit in {**UNIT, "torque": "N m"}.items():
        if kind != "acceleration" or kind in changed:
            table = {"source": "log", "columns": columns(kind), "unit": unit}
            tables[kind] = table | changed.get(kind, {})
    return MappingDraft(tables, {}).text


def cure(folder: Path, text: str) -> dict[str, dict[str, Any]]:
    """The mapping's lines in a refusal, as tables."""
    with pytest.raises(DerivativeError) as refused:
        imported(folder, text)
    found: dict[str, dict[str, Any]] = {}
    for table, key, value in refused.value.lines:
        found.setdefault(table, {})[key] = value
    return found


@few(8)
@given(
    seed=seeds,
    wrong=st.fixed_dictionaries(
        {},
        optional={
            "unit": st.sampled_from(TURNS),
            "sign": st.permutations([-1, -1, 1, 1, 1, 1]).map(list),
            "columns": st.permutations(range(N)).map(lambda order: columns("velocity", order)),
        },
    ).filter(lambda wrong: bool(wrong) and wrong.get("columns") != columns("velocity")),
)
@example(seed=16489, wrong={"columns": columns("velocity", [0, 2, 3, 1, 4, 5])})  # two go alike
def test_the_cure_of_a_wrong_velocity_makes_it_right(
    seed: int, wrong: dict[str, Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Unit, signs and order, alone and together; noise of 2 % besides."""
    folder = tmp_path_factory.mktemp("log")
    log(folder, seed, noise=0.02)
    found = cure(folder, mapping(velocity=wrong))
    assert set(found) == {"velocity"}
    made = imported(folder, mapping(velocity=wrong | found["velocity"])).measured("velocity")
    right = ideal(robot("ur5"), duration=8, rate=100, seed=seed).measured("velocity")
    assert np.corrcoef(made.ravel(), right.ravel())[0, 1] > 0.99
    assert np.std(made) == pytest.approx(np.std(right), rel=0.01)


def test_which_of_two_is_in_another_unit_is_told_by_their_sizes(tmp_path: Path) -> None:
    """Both in one unit; accelerations against velocities; an encoder that is dead."""
    data = log(tmp_path)
    wrong = mapping(acceleration={"unit": "deg/s^2"})
    assert cure(tmp_path, wrong) == {"acceleration": {"unit": "rad/s^2"}}
    for was, said in (("rad", "deg"), ("deg", "rad")):
        both = {kind: data[kind] / unit_size("position", was) for kind in ("position", "velocity")}
        np.savez(tmp_path / "log.npz", **data | both)
        units = {"position": was, "velocity": f"{was}/s"}
        for kind, right in units.items():
            told = units | {kind: right.replace(was, said)}
            tables = {name: {"unit": unit} for name, unit in told.items()}
            assert cure(tmp_path, mapping(**tables)) == {kind: {"unit": right}}
    data["position"][:, 1] = 0.0
    np.savez(tmp_path / "log.npz", **data)
    with refuses(RecordingError, JOINTS[1]):
        imported(tmp_path, mapping())


def test_a_right_velocity_is_taken_and_a_robot_at_rest_says_nothing(tmp_path: Path) -> None:
    """One that follows badly is doubted."""
    for noise, share, doubted in ((0.02, 1.0, False), (0.3, 1.0, True), (0.0, 0.0, False)):
        data = log(tmp_path, noise=noise)
        moved = {kind: share * data[kind] for kind in ("position", "velocity")}
        np.savez(tmp_path / "log.npz", **data | moved)
        told = imported(tmp_path, mapping()).metadata.report["signals"]["velocity"]
        assert bool(told["diagnostics"]) == doubted
