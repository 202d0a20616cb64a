"""Minimal sets by three witnesses, on random trees, a catalogue and real robots; the map."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.dynamics.witnesses import sampled_regressor, verify
from testbed.errors import UnknownName
from testbed.parameters.barycentric import COMPONENTS, STANDARD, on_standard
from testbed.parameters.entries import dense_rows, static_entries
from testbed.parameters.exact_recursion import recursive_space
from testbed.parameters.identifiability import (
    ALONE,
    COMBINED,
    INSTRUMENTS,
    NEVER,
    identifiability,
)
from testbed.parameters.minimal_set import MinimalSet
from testbed.parameters.regroup import regroup
from testbed.parameters.row_space import distance, row_space
from testbed.parameters.rules import REASONS, Model
from testbed.robot.load import mimic_joints
from testbed.robot.tree import Joint, Tree
from tests.helpers.cases import cases
from tests.helpers.paths import GOLDEN, REAL
from tests.helpers.robots import random_robot, with_zeros

SLIGHTLY_INCLINED = (691, 815, 1727, 1996)  # first axes close to vertical: large lifts
UNCHANGED = 1e-12  # relative change of the model by regrouping
FILE_ROUNDING = 1e-8  # the same, for files whose angles are rounded: an axis almost vertical
GRAVITIES = {"down": (0.0, 0.0, -9.81), "tilted": (2.97, -4.95, -7.93), "off": (0.0, 0.0, 0.0)}
CATALOGUE = json.loads((GOLDEN / "counts.json").read_text())
MODELS: tuple[Model, ...] = ("dynamic", "reaction")
LARGEST = 50  # joints of a real robot that is verified by sampling, which is the slow witness
REFUSALS = ("no joint that moves", "not a valid URDF")


def agree(
    tree: Tree, model: Model, gravity: object, tared: bool = False, change: float = UNCHANGED
) -> None:
    minimal = tb.minimal_set(tree, model, gravity, tared=tared)  # type: ignore[arg-type]
    found = verify(tree, minimal)
    assert found.holds, found
    assert found.change <= change


@pytest.mark.parametrize("gravity", GRAVITIES)
@pytest.mark.parametrize("seed", cases([*SLIGHTLY_INCLINED, *range(10_000, 10_060)], fast=8))
def test_three_witnesses_agree_on_random_trees(seed: int, gravity: str) -> None:
    """1 to 12 joints; row spaces, not counts; `python -m benchmarks minimal` does thousands."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, int(rng.integers(1, 13))).tree()
    for model in MODELS:
        agree(tree, model, GRAVITIES[gravity])
    agree(tree, "reaction", GRAVITIES[gravity], tared=True)


@pytest.mark.parametrize("robot", cases(CATALOGUE, fast=6))
def test_three_witnesses_agree_on_the_catalogue(robot: str) -> None:
    tree = tb.load_tree(GOLDEN / "robots" / CATALOGUE[robot]["urdf"])
    for entry in CATALOGUE[robot]["gravity"].values():
        for model in MODELS:
            agree(tree, model, entry["g"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    cases(sorted(REAL.rglob("*.urdf")), fast=4),
    ids=lambda path: str(path.relative_to(REAL)),
)
def test_real_robots_are_understood_or_refused_with_a_reason(path: Path) -> None:
    """Every URDF of example-robot-data; roots welded, inertias accepted, followers held."""
    followers = dict.fromkeys(mimic_joints(path))
    try:
        tree = tb.load_tree(path, weld_root=True, lock=followers)
    except tb.TestbedError as error:
        refused = str(error)
        known = any(reason in refused for reason in REFUSALS) and path.name in refused
        if not known:
            raise
        return
    for model in MODELS:
        minimal = tb.minimal_set(tree, model)
        if tree.n <= LARGEST:
            agree(tree, model, None, change=FILE_ROUNDING)
        assert recursive_space(tree, model).rank == minimal.count


def test_there_are_real_robots_to_test() -> None:
    assert len(list(REAL.rglob("*.urdf"))) > 60


# traps


def chain(*axes: tuple[float, float, float], offsets: object = None) -> Tree:
    """Revolute joints in a row, each with a random body."""
    rng = np.random.default_rng(len(axes))
    places = rng.uniform(-0.5, 0.5, (len(axes), 3)) if offsets is None else np.array(offsets)
    joints = tuple(
        Joint(f"j{k}", f"b{k}", "revolute", k - 1, np.array(axis), places[k], np.eye(3))
        for k, axis in enumerate(axes)
    )
    bodies = tuple(
        tb.Inertia.about_centre(rng.uniform(1, 3), rng.uniform(-0.2, 0.2, 3), np.eye(3) * 0.1)
        for _ in axes
    )
    return Tree("chain", joints, bodies)


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def test_axes_parallel_at_zero_only_are_not_parallel() -> None:
    """z, x, z: the third axis turns away from the first, whatever the adjacent joint says."""
    tree = chain(Z, X, Z)
    assert tb.minimal_set(tree, "dynamic").count == 1 + 7 + 7
    agree(tree, "dynamic", None)


def test_without_gravity_concurrent_axes_hide_two_parameters() -> None:
    """The row of Table 4 that the paper lacks: axis 2 meets axis 1."""
    meeting = chain(Z, Y, offsets=[[0, 0, 0], [0, 0, 0.4]])
    apart = chain(Z, Y, offsets=[[0, 0, 0], [0.3, 0, 0.4]])
    off = (0.0, 0.0, 0.0)
    assert tb.minimal_set(meeting, "dynamic", off).count == 1 + 5
    assert tb.minimal_set(apart, "dynamic", off).count == 1 + 7
    agree(meeting, "dynamic", off)
    agree(apart, "dynamic", off)


def test_an_axis_tilted_by_rounding_is_not_tilted() -> None:
    """Rescaled, the rounding of an almost vertical axis would count."""
    tree = chain((1e-12, 0.0, 1.0), Y)
    assert [tb.minimal_set(tree, m).count for m in MODELS] == [8, 13]
    for model in MODELS:
        agree(tree, model, None, change=FILE_ROUNDING)


def test_inclined_axes_are_taken_in_a_triad_of_their_own() -> None:
    tree = chain(Z, (0.6, 0.0, 0.8))
    minimal = tb.minimal_set(tree, "dynamic")
    assert {"mb2u", "mb2v", "K2ww", "2*K2d", "K2uv"} <= set(minimal.names)
    assert list(minimal.triads) == [1]
    axes = minimal.triads[1].axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(axes[2], [0.6, 0.0, 0.8], atol=1e-15)
    agree(tree, "dynamic", None)


def test_every_entry_has_a_reason_and_the_rest_is_named(puma: tb.Tree) -> None:
    dynamic, reaction = (tb.minimal_set(puma, m) for m in MODELS)
    assert set(dynamic.reasons) == {"4.1", "4.3"}
    assert dict(zip(reaction.names, reaction.reasons, strict=True))["mbar1"] == "base"
    assert set(reaction.reasons) == {"5.1", "5.2", "base"}
    assert set(reaction.never) == {"mb1z", "K1xx", "K1xy", "K1yy", "mbar2", "mbar3"}
    for number in (*dynamic.reasons, *reaction.reasons):
        assert REASONS[number]


def test_a_tared_plate_does_not_weigh(puma: tb.Tree) -> None:
    full, tared = (tb.minimal_set(puma, "reaction", tared=t) for t in (False, True))
    assert set(full.names) - set(tared.names) == {"mbar1"}
    assert tared.tared


def test_given_zeros_shrink_the_sets_as_the_files_do(puma: tb.Tree) -> None:
    given = [f"{p}{k}{x}" for k in (1, 2, 3) for p, x in (("mb", "x"), ("K", "xy"), ("K", "xz"))]
    for model, count in (("dynamic", 9), ("reaction", 12)):
        minimal = tb.minimal_set(puma, model, zeros=given)  # type: ignore[arg-type]
        assert minimal.count == count
        assert minimal.names == tb.minimal_set(puma, minimal.model, zeros=True).names
    with pytest.raises(UnknownName, match="barycentric parameter 'mb9x'"):
        tb.minimal_set(puma, "dynamic", zeros=["mb9x"])


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("model", MODELS)
def test_sets_on_standard_parameters_say_the_same(seed: int, model: Model) -> None:
    """K pi = S theta: users of other tools compare through it."""
    tree = random_robot(np.random.default_rng(seed), 6).tree()
    minimal = tb.minimal_set(tree, model)
    delta = minimal.values(tb.barycentric(tree))
    np.testing.assert_allclose(
        minimal.standard_matrix @ tb.standard(tree).ravel(), delta, atol=1e-12
    )


# the map


def levels(tree: Tree, instrument: str, gravity: object = None) -> np.ndarray:
    seen = identifiability(tree, gravity)  # type: ignore[arg-type]
    return next(each.standard for each in seen if each.instrument == instrument)


def test_the_map_of_the_puma(puma: tb.Tree) -> None:
    """Link 1: torques tell its Izz in combination only; the plate its mx, Ixz alone too."""
    torques, plate = (levels(puma, name) for name in INSTRUMENTS[:2])
    first = dict(zip(STANDARD, torques[0], strict=True))
    assert {name for name, level in first.items() if level != NEVER} == {"Izz"}
    assert first["Izz"] == COMBINED
    felt = dict(zip(STANDARD, plate[0], strict=True))
    assert (felt["mx"], felt["Ixz"], felt["m"], felt["mz"]) == (ALONE, ALONE, COMBINED, NEVER)


@pytest.mark.slow
def test_the_plate_sees_whatever_torques_see() -> None:
    for seed in range(20):
        tree = random_robot(np.random.default_rng(seed), 6).tree()
        assert (levels(tree, "bedplate") >= levels(tree, "torques")).all()
        assert (levels(tree, "bedplate") >= levels(tree, "tared bedplate")).all()


def test_an_unknown_pedestal_hides_what_only_weight_tells(puma: tb.Tree) -> None:
    """The lone trunk's mass can no longer be told from the pedestal's."""
    seen = {each.instrument: each for each in identifiability(puma)}
    assert [seen[name].count for name in INSTRUMENTS] == [15, 20, 19, 22]
    mbar = COMPONENTS.index("mbar")
    assert seen["bedplate"].barycentric[0, mbar] == ALONE
    assert seen["bedplate, pedestal unknown"].barycentric[0, mbar] == COMBINED
    assert seen["tared bedplate"].barycentric[0, mbar] == NEVER


@pytest.mark.parametrize("seed", range(10))
def test_the_map_is_that_of_a_sampled_regressor(seed: int) -> None:
    """What is never told has a column of zeros; what is told alone, a column of its own."""
    tree = random_robot(np.random.default_rng(seed), 5).tree()
    for instrument, model, tared in (
        ("torques", "dynamic", False),
        ("bedplate", "reaction", False),
        ("tared bedplate", "reaction", True),
    ):
        rows = sampled_regressor(tree, model, tared=tared)  # type: ignore[arg-type]
        seen = next(e for e in identifiability(tree) if e.instrument == instrument)
        flat = seen.barycentric.ravel()
        size = np.abs(rows).max(axis=0)
        np.testing.assert_array_equal(size < 1e-9 * size.max(), flat == NEVER)
        for column in np.flatnonzero(flat == ALONE)[:5]:
            rest = np.delete(rows, column, axis=1)
            assert row_space(rest, 1e-10).rank == row_space(rows, 1e-10).rank - 1


def beside_a_pedestal(tree: Tree, gravity: np.ndarray, tared: MinimalSet) -> np.ndarray:
    """What is told with an unknown mass and two moments on the plate, (k, 3 + 10 n)."""
    bodies = regroup(tree, "reaction", gravity)
    entries = static_entries(tree, gravity) if gravity.any() else []
    static = np.where(tared.known_zero.ravel(), 0.0, dense_rows(tree, bodies, entries))
    own = np.eye(3)[: len(static)]
    return np.block([[np.zeros((tared.count, 3)), tared.matrix], [own, static]])


def levels_by_orthonormal_rows(rows: np.ndarray) -> np.ndarray:
    basis = np.linalg.qr(rows.T)[0]
    inside = np.linalg.norm(basis, axis=1) > 1e-9
    outside = np.linalg.norm(np.eye(len(basis)) - basis @ basis.T, axis=0) > 1e-9
    return np.where(outside, np.where(inside, COMBINED, NEVER), ALONE)


@pytest.mark.parametrize("zeros", [False, True])
@pytest.mark.parametrize("gravity", GRAVITIES)
@pytest.mark.parametrize("seed", range(5))
def test_the_map_is_that_of_the_row_space(seed: int, gravity: str, zeros: bool) -> None:
    """A unit parameter is outside of it, has a part in it, or is in it, told by a dense basis."""
    rng = np.random.default_rng(seed)
    tree = with_zeros(rng, random_robot(rng, int(rng.integers(1, 8)))).tree()
    g = np.array(GRAVITIES[gravity])
    torques, plate = (tb.minimal_set(tree, model, g, zeros) for model in MODELS)
    tared = tb.minimal_set(tree, "reaction", g, zeros, tared=True)
    rows = [torques.matrix, plate.matrix, tared.matrix, beside_a_pedestal(tree, g, tared)]
    for found, told in zip(identifiability(tree, g, zeros), rows, strict=True):
        others = told.shape[1] - 10 * tree.n
        standard = np.hstack([told[:, :others], on_standard(tree, told[:, others:])])
        assert found.count == len(told)
        for table, own in ((found.standard, standard), (found.barycentric, told)):
            expected = levels_by_orthonormal_rows(own)[others:]
            np.testing.assert_array_equal(table.ravel(), expected)


# text


def test_formulas_in_latex(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "reaction")
    said = {f.left.text: f.latex() for f in (*minimal.formulas, *minimal.auxiliary)}
    assert said["K*1yz"] == r"K^{*1}_{yz} = K^{1}_{yz} - l^{12}_{z}\,m\!b^{*2}_{y}"
    assert said["K*1zz"] == (
        r"K^{*1}_{zz} = K^{1}_{zz} + \tfrac{1}{2}\,K^{*2}_{xx} + \tfrac{1}{2}\,K^{*2}_{zz}"
    )
    assert said["mbar1"] == r"\bar{m}^{1} = \bar{m}^{1}"
    assert said["2*K3d"] == r"2\,K^{3}_{d} = K^{3}_{xx} - K^{3}_{zz}"


def test_formulas_with_numbers(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "dynamic", zeros=True)
    assert "K*2yz = K2yz - 0.4318*mb3y" in map(str, minimal.formulas_with("numbers"))


def test_lengths_of_bodies_beyond_the_ninth_are_readable() -> None:
    tree = chain(*([Z, Y] * 6))
    text = " ".join(map(str, tb.minimal_set(tree, "reaction").formulas))
    assert "l11_12" in text
    assert "l89" in text


def test_distance_of_spaces_of_other_rank_is_one() -> None:
    a, b = row_space(np.eye(3)[:1], 1e-9), row_space(np.eye(3)[:2], 1e-9)
    nothing = row_space(np.zeros((1, 3)), 1e-9)
    assert distance(a, b) == distance(a, nothing) == 1.0
    assert distance(a, a) < 1e-12
    assert distance(nothing, nothing) == 0.0
