"""A minimal set is believed because three computations agree: they must be able to disagree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.dynamics.drive_set import drive_set
from testbed.dynamics.witnesses import sampled_regressor, verify, verify_drives
from testbed.parameters.rules import Model
from tests.helpers.robots import random_robot
from tests.helpers.strategies import few, rngs, trees

models: st.SearchStrategy[Model] = st.sampled_from(["dynamic", "reaction"])


@few(10)
@given(rngs, models)
def test_the_right_set_is_confirmed_and_another_robots_is_not(
    rng: np.random.Generator, model: Model
) -> None:
    tree, other = (random_robot(rng, 5).tree() for _ in range(2))
    minimal = tb.minimal_set(tree, model, tared=model == "reaction")
    found = verify(tree, minimal)
    assert found.holds
    assert found.rules == found.recursion == found.sampled == minimal.count
    assert max(found.recursion_distance, found.sampled_distance) < 1e-9
    assert max(found.change, found.inverse) < 1e-12
    wrong = verify(tree, tb.minimal_set(other, model))
    assert not wrong.holds
    assert wrong.rules != wrong.recursion or wrong.recursion_distance > 1e-3
    assert wrong.rules != wrong.sampled or wrong.sampled_distance > 1e-3
    assert wrong.change > 1e-3
    # each witness alone speaks up
    for spoiled in (
        {"recursion_distance": 1.01e-7},
        {"sampled_distance": 1.01e-7, "gap": 1e9},
        {"sampled_distance": 1.01e-5, "gap": 1e5},
        {"change": 1.01e-8},
        {"gap": 999.0},
        {"inverse": 1.01e-9},
    ):
        assert not replace(found, **spoiled).holds  # type: ignore[arg-type]
    near = replace(found, recursion_distance=1e-7, sampled_distance=0.99e-5, gap=1e5)
    assert near.holds  # sampling tells no more than its gap


@given(trees((2, 5)))
def test_a_change_is_relative_to_the_largest_entry(tree: tb.Tree) -> None:
    """A lift, or drives, that are off by a millionth in one column are seen as that."""
    minimal = tb.minimal_set(tree, "dynamic")
    rows = sampled_regressor(tree, "dynamic")
    drives = drive_set(tree, minimal, ("coulomb", "viscous"))
    assert verify_drives(tree, drives).change < 1e-9
    off = drives.matrix.copy()
    off[0] *= 1 + 1e-6
    wrong = replace(drives, columns=drives.columns.copy())
    vars(wrong)["matrix"] = off
    lost = 1e-6 * np.outer(rows @ minimal.lift[:, 0], drives.matrix[0])
    wanted = np.abs(lost).max() / max(np.abs(rows).max(), 3.0)
    assert wanted / 3 < verify_drives(tree, wrong).change < 3 * wanted
    lift = minimal.lift.copy()
    lift[:, 0] *= 1 + 1e-6
    lost = 1e-6 * np.outer(rows @ minimal.lift[:, 0], minimal.matrix[0])
    vars(minimal)["lift"] = lift
    wanted = np.abs(lost).max() / np.abs(rows).max()
    assert verify(tree, minimal).change == pytest.approx(wanted, rel=1e-6)
