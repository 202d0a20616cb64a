"""Shafts of coupled gears in what recordings say of their mapping; nothing there is trusted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from testbed.recordings.coupled_gear import LONGEST, coupled_shafts

JOINTS = ["waist", "wrist", "flange"]


def facts(matrix: object, joints: object = None) -> dict[str, Any]:
    named = JOINTS if joints is None else joints
    return {"mapping": {"gear": {"matrix": matrix}, "joints": named}}


def test_a_shaft_that_turns_with_several_joints_is_named_after_its_own() -> None:
    """In multiples of its own joint, or where it has none, of the one with which it turns most."""
    found = coupled_shafts(facts([[40, 0, 0], [0, 20, 10], [0, -30, 0]]))
    assert found == {"wrist.motor": {"wrist": 1.0, "flange": 0.5}}
    found = coupled_shafts(facts([[0, 2, -8], [0, 1, 0], [0, 0, 1]]))
    assert found == {"waist.motor": {"wrist": -0.25, "flange": 1.0}}


@pytest.mark.parametrize(
    "matrix",
    [
        "three rows",
        [["a", 0, 0], [0, 1, 1], [0, 0, 1]],
        [[1, 0, 0], [0, 1, 1]],
        [[1, 0, 0], [0, 1, float("nan")], [0, 0, 1]],
        [[1, 1], [1, 1]],
        [1, 1, 1],
        None,
    ],
)
def test_what_is_no_matrix_of_the_joints_couples_nothing(matrix: object) -> None:
    assert coupled_shafts(facts(matrix)) == {}


@pytest.mark.parametrize("joints", [7, [1, 2, 3], {"waist": 1}, ["waist", "wrist"]])
def test_what_names_no_joints_couples_nothing(joints: object) -> None:
    assert coupled_shafts(facts(np.ones((3, 3)).tolist(), joints)) == {}


def test_other_facts_couple_nothing() -> None:
    for other in ({}, {"mapping": 3}, {"mapping": {"gear": 3, "joints": JOINTS}}):
        assert coupled_shafts(other) == {}


@pytest.mark.parametrize(("count", "read"), [(LONGEST, True), (LONGEST + 1, False)])
def test_a_mapping_has_so_many_joints_at_most(count: int, read: bool) -> None:
    matrix = np.eye(count)
    matrix[0, 1] = 0.5
    found = coupled_shafts(facts(matrix, [f"j{k}" for k in range(count)]))
    assert found == ({"j0.motor": {"j0": 1.0, "j1": 0.5}} if read else {})
