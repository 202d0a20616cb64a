"""Witnesses agree where a set is right, and tell where it is not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.dynamics.drive_set import drive_set
from testbed.dynamics.inverse_dynamics import parameter_regressor
from testbed.dynamics.witnesses import Agreement, sampled_regressor, verify, verify_drives
from testbed.parameters.rules import Model
from tests.helpers.robots import random_robot

MODELS: tuple[Model, ...] = ("dynamic", "reaction")


def some_tree(seed: int, n: int = 5) -> tb.Tree:
    return random_robot(np.random.default_rng(seed), n).tree()


def agreement(**changes: Any) -> Agreement:
    """Three witnesses that agree, but for the changes."""
    whole = Agreement(
        model="dynamic",
        rules=5,
        recursion=5,
        sampled=5,
        recursion_distance=1e-14,
        sampled_distance=1e-14,
        gap=1e9,
        change=1e-15,
        inverse=1e-15,
    )
    return replace(whole, **changes)


def test_witnesses_agree_on_equal_spaces_and_a_clear_rank() -> None:
    """Angles up to 1e-7, or to what sampling can tell; singular values a thousand times apart."""
    assert agreement().holds
    assert agreement(recursion_distance=1e-7, sampled_distance=1e-7, gap=1e3).holds
    assert not agreement(recursion_distance=1.01e-7).holds
    assert not agreement(sampled_distance=1.01e-7).holds
    assert agreement(sampled_distance=0.99e-5, gap=1e5).holds
    assert not agreement(sampled_distance=1.01e-5, gap=1e5).holds
    assert not agreement(change=1.01e-8).holds
    assert not agreement(gap=999.0).holds
    assert not agreement(inverse=1.01e-9).holds


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("tared", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_the_right_set_is_confirmed(seed: int, tared: bool, model: Model) -> None:
    tree = some_tree(seed)
    minimal = tb.minimal_set(tree, model, tared=tared and model == "reaction")
    found = verify(tree, minimal, seed=seed)
    assert found.holds
    assert found.model == model
    assert found.rules == found.recursion == found.sampled == minimal.count
    assert max(found.recursion_distance, found.sampled_distance) < 1e-9
    assert found.change < 1e-12


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(6))
def test_another_robots_set_is_rejected(seed: int, model: Model) -> None:
    tree, other = some_tree(seed), some_tree(seed + 100)
    found = verify(tree, tb.minimal_set(other, model))
    assert not found.holds
    assert found.rules != found.recursion or found.recursion_distance > 1e-3
    assert found.rules != found.sampled or found.sampled_distance > 1e-3
    assert found.change > 1e-3
    right = tb.minimal_set(tree, model)
    assert found.recursion == found.sampled == right.count


def test_the_change_is_relative_to_the_largest_entry() -> None:
    """A lift that is off in one parameter changes the model by that parameter's columns."""
    tree = some_tree(1)
    minimal = tb.minimal_set(tree, "dynamic")
    right = minimal.lift
    off = right.copy()
    off[:, 0] *= 1 + 1e-6
    vars(minimal)["lift"] = off
    found = verify(tree, minimal)
    rows = sampled_regressor(tree, "dynamic")
    lost = 1e-6 * np.outer(rows @ right[:, 0], minimal.matrix[0])
    assert found.change == pytest.approx(np.abs(lost).max() / np.abs(rows).max(), rel=1e-6)


def test_the_change_of_bodies_and_drives_is_relative_too() -> None:
    tree = some_tree(1)
    minimal = tb.minimal_set(tree, "dynamic")
    right = drive_set(tree, minimal, ("coulomb", "viscous"))
    assert verify_drives(tree, right).change < 1e-9
    off = right.matrix.copy()
    off[0] *= 1 + 1e-6
    rows = sampled_regressor(tree, "dynamic")
    wrong = replace(right, columns=right.columns.copy())
    vars(wrong)["matrix"] = off
    lost = 1e-6 * np.outer(rows @ minimal.lift[:, 0], right.matrix[0])
    wanted = np.abs(lost).max() / np.abs(rows).max()
    assert verify_drives(tree, wrong).change == pytest.approx(wanted, rel=0.5)


def rest(tree: tb.Tree) -> tb.Motion:
    return tb.Motion(np.zeros(1), *np.zeros((3, 1, tree.n)))


@pytest.mark.parametrize("model", MODELS)
def test_sampled_states_begin_at_rest_and_a_tare_takes_that_off(model: Model) -> None:
    tree = some_tree(2)
    channels = tree.n if model == "dynamic" else 6
    rows = sampled_regressor(tree, model, seed=3)
    assert rows.shape[1] == 10 * tree.n
    assert len(rows) // channels >= 10 * tree.n / channels  # enough to see the whole space
    at_rest: Array = parameter_regressor(tree, rest(tree), model)[0]
    np.testing.assert_allclose(rows[:channels], at_rest, atol=1e-14)
    tared = sampled_regressor(tree, model, seed=3, tared=True)
    repeated = np.tile(at_rest, (len(rows) // channels, 1))
    np.testing.assert_allclose(tared, rows - repeated, atol=1e-14)


def test_states_depend_on_the_seed_and_on_nothing_else() -> None:
    tree = some_tree(3)
    one, same, other = (sampled_regressor(tree, "reaction", seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    default = sampled_regressor(tree, "reaction")
    np.testing.assert_array_equal(default, sampled_regressor(tree, "reaction", seed=0))
