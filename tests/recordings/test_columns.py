"""Names and units of columns, and what a recording is asked for by name."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from testbed.errors import RecordingError
from testbed.recordings.columns import AXES, axis_unit, joints_in, members_of, signal_of, unit_of
from testbed.recordings.geometry import geometry
from testbed.recordings.recording import Recording
from tests.helpers.ideal import ideal
from tests.helpers.robots import random_robot

KINDS = {"turn": "revolute", "slide": "prismatic"}
UNITS = {
    "time": "s",
    "position/turn": "rad",
    "velocity/turn": "rad/s",
    "acceleration/turn": "rad/s^2",
    "torque/turn": "N m",
    "truth/friction/turn": "N m",
    "position/slide": "m",
    "truth/velocity/slide": "m/s",
    "acceleration/slide": "m/s^2",
    "torque/slide": "N",
    "friction/slide": "N",
    "wrench/Fx": "N",
    "wrench/Fz": "N",
    "truth/wrench/Mx": "N m",
    "wrench/Mz": "N m",
    "position/stranger": "rad",
}


@pytest.mark.parametrize(("column", "unit"), UNITS.items())
def test_every_column_has_the_unit_of_its_signal_and_joint(column: str, unit: str) -> None:
    assert unit_of(column, KINDS) == unit


def test_the_plate_has_three_forces_and_three_moments() -> None:
    assert [axis_unit(axis) for axis in AXES] == ["N"] * 3 + ["N m"] * 3


def test_a_bases_columns_are_those_of_the_conventions() -> None:
    """Its place, and its quaternion's parts, the real one first."""
    names = members_of("base", ("waist", "elbow"))
    assert names == ("x", "y", "z", "qw", "qx", "qy", "qz")
    assert [unit_of(f"base/{name}", {}) for name in names] == ["m"] * 3 + ["1"] * 4


@pytest.mark.parametrize(
    ("column", "signal"),
    [
        ("time", "time"),
        ("position/elbow", "position"),
        ("position/left/elbow", "position"),
        ("truth/position/elbow", "truth/position"),
        ("truth/wrench/Fx", "truth/wrench"),
    ],
)
def test_a_column_says_its_signal(column: str, signal: str) -> None:
    assert signal_of(column) == signal


def test_joints_are_those_with_a_position_whatever_their_names_hold() -> None:
    columns = ["time", "position/b", "torque/c", "position/left/a", "truth/position/d"]
    assert joints_in(columns) == ("b", "left/a")


@pytest.fixture
def whole() -> Recording:
    """Of a robot with joints of both kinds."""
    tree = random_robot(np.random.default_rng(2), 5).tree()
    assert {joint.kind for joint in tree.joints} == {"revolute", "prismatic"}
    return replace(ideal(tree, duration=2.0, rate=50.0), facts={"geometry": geometry(tree)})


def test_a_recording_is_its_columns(whole: Recording) -> None:
    """Columns, metadata and nothing else: it is the same again."""
    columns = whole.columns() | whole.true_columns()
    again = Recording.from_columns(columns, whole.metadata, "r")
    assert (again.names, again.facts, again.signals) == (whole.names, whole.facts, whole.signals)
    for name, values in columns.items():
        np.testing.assert_array_equal((again.columns() | again.true_columns())[name], values)
    np.testing.assert_array_equal(again.tare, np.zeros(6))
    units = whole.units()
    assert units.keys() == columns.keys()
    kinds = {name: joint["kind"] for name, joint in whole.facts["geometry"].items()}
    assert all(units[name] == unit_of(name, kinds) for name in columns)


def test_truth_is_there_whole_or_not_at_all(whole: Recording) -> None:
    columns = whole.columns() | whole.true_columns()
    some = {name: values for name, values in columns.items() if "truth/friction" not in name}
    again = Recording.from_columns(some, whole.metadata, "r")
    assert again.truth is None
    assert not again.true_columns()


@pytest.mark.parametrize("lost", ["time", "torque/j2", "wrench/Mx", "velocity/j1"])
def test_what_is_missing_is_named(lost: str, whole: Recording) -> None:
    columns = whole.columns()
    del columns[lost]
    with pytest.raises(RecordingError, match=f"^r: channel '{lost}' is missing$"):
        Recording.from_columns(columns, {}, "r")


def test_no_joints_are_no_recording(whole: Recording) -> None:
    columns = {n: v for n, v in whole.columns().items() if not n.startswith("position/")}
    with pytest.raises(RecordingError, match="there is no channel 'position/JOINT'"):
        Recording.from_columns(columns, {}, "r")


def test_what_was_not_measured_is_said_when_asked_for(whole: Recording) -> None:
    part = replace(whole, torque=None, velocity=None)
    assert part.signals == ("time", "position", "acceleration", "wrench")
    assert (whole.senses_kinematics, part.senses_kinematics) == (True, False)
    assert not replace(whole, acceleration=None).senses_kinematics
    with pytest.raises(RecordingError, match="the recording has no torque"):
        part.measured("torque")


def test_a_part_is_a_slice_of_what_was_measured(whole: Recording) -> None:
    part = whole.part(10, 30)
    assert part.samples == 20
    assert part.truth is None
    for name, values in whole.columns().items():
        np.testing.assert_array_equal(part.columns()[name], values[10:30])
    assert np.shares_memory(part.position, whole.position)
    assert whole.rate == pytest.approx(50.0)
    assert part.rate == pytest.approx(50.0)


def test_the_truth_is_put_in_order_too(whole: Recording) -> None:
    tree = random_robot(np.random.default_rng(2), 5).tree()
    order = [3, 1, 4, 0, 2]
    truth = whole.truth
    assert truth is not None
    turned: dict[str, Any] = {
        name: values if name == "wrench" else values[:, order]
        for name, values in vars(truth).items()
    }
    names = tuple(whole.names[k] for k in order)
    seen: dict[str, Any] = {
        name: whole.measured(name)[:, order]
        for name in ("position", "velocity", "acceleration", "torque")
    }
    shuffled = replace(whole, names=names, truth=replace(truth, **turned), **seen)
    again = shuffled.ordered(tree)
    assert again.names == tree.names
    for name, values in (whole.columns() | whole.true_columns()).items():
        np.testing.assert_array_equal((again.columns() | again.true_columns())[name], values)
    assert whole.ordered(tree) is whole
    assert whole.blind().truth is None
