"""Barycentric parameters and minimal sets: laws on random trees, golden numbers, witnesses."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import testbed as tb
from testbed.arrays import Array, skew
from testbed.parameters.barycentric import (
    COMPONENTS,
    on_standard,
    parameter_names,
    standard,
    to_barycentric,
    to_standard,
)
from testbed.parameters.rules import Model
from tests.helpers.paths import GOLDEN
from tests.helpers.robots import random_robot, random_states, with_zeros

GOLDEN_TOLERANCE = 1e-12
GRAVITIES = {
    "down": (0.0, 0.0, -9.81),
    "tilted": (2.97, -4.95, -7.93),
    "off": (0.0, 0.0, 0.0),
    "along_x": (9.81, 0.0, 0.0),
}
COUNTS = json.loads((GOLDEN / "counts.json").read_text())
GOLDEN_NAMES = {"K3d": "2*K3d", "Ks2d": "2*K*2d", "mm1": "mbar1"}  # named differently there


def starred(name: str) -> str:
    """mbs2z -> mb*2z, Ks1zz -> K*1zz."""
    return GOLDEN_NAMES.get(name, re.sub(r"^(mb|K)s", r"\1*", name))


# barycentric parameters


def test_theta_of_the_puma_is_the_golden_one(puma: tb.Tree, golden: Any) -> None:
    theta = golden["variants"]["ref18_exact"]["theta"]
    names = [name.replace("mbar", "mm") for name in parameter_names(puma)]
    expected = [theta[name] for name in names]
    np.testing.assert_allclose(
        tb.barycentric(puma).ravel(), expected, rtol=GOLDEN_TOLERANCE, atol=GOLDEN_TOLERANCE
    )


@pytest.mark.parametrize("seed", range(20))
def test_the_recursion_over_children_is_the_sum_over_what_is_carried(seed: int) -> None:
    """[FRS96] eqs. (3)-(5): sums of T^ik with l^ik, against the recursion."""
    tree = random_robot(np.random.default_rng(seed), 8).tree()
    theta, reach = tb.barycentric(tree), tree.reach
    for i in range(tree.n):
        total, moment = 0.0, tree.inertias[i].first_moment.copy()
        tensor = tree.inertias[i].tensor.copy()
        for k in range(tree.n):
            mass = tree.inertias[k].mass * reach[i, k]
            total += mass
            if k == i or not mass:
                continue
            first = tree.chain(k)[tree.chain(k).index(i) + 1]  # the child towards k
            l = tree.joints[first].offset
            moment += mass * l
            tensor -= mass * skew(l) @ skew(l)
        expected = [total, *moment, *tensor[np.triu_indices(3)]]
        np.testing.assert_allclose(theta[i], expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("seed", range(10))
def test_barycentric_and_standard_parameters_are_one_to_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 7).tree()
    any_parameters = rng.normal(size=(7, 10))
    back = to_standard(tree, to_barycentric(tree, any_parameters))
    np.testing.assert_allclose(back, any_parameters, rtol=0, atol=1e-13)


@pytest.mark.parametrize("seed", range(10))
def test_rows_on_barycentric_and_on_standard_parameters_say_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 7).tree()
    rows, parameters = rng.normal(size=(3, 70)), rng.normal(size=(7, 10))
    kept = rows.copy()
    said = rows @ to_barycentric(tree, parameters).ravel()
    found = on_standard(tree, rows) @ parameters.ravel()
    np.testing.assert_allclose(found, said, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(rows, kept)


def test_standard_parameters_are_in_pinocchio_order(tmp_path: Any) -> None:
    robot = random_robot(np.random.default_rng(5), 5)
    (tmp_path / "r.urdf").write_text(robot.urdf())
    tree = tb.load_tree(tmp_path / "r.urdf")
    model = pin.buildModelFromUrdf(str(tmp_path / "r.urdf"))
    for k, name in enumerate(tree.names):
        theirs = model.inertias[model.getJointId(name)].toDynamicParameters()
        np.testing.assert_allclose(standard(tree)[k], theirs, rtol=0, atol=1e-12)


# minimal sets: the PUMA


def test_the_minimal_sets_of_the_puma_are_the_papers(puma: tb.Tree, golden: Any) -> None:
    dynamic, reaction = (tb.minimal_set(puma, m, zeros=True) for m in ("dynamic", "reaction"))
    assert list(dynamic.names) == [starred(n) for n in golden["delta_d_order"]]
    assert list(reaction.names) == [starred(n) for n in golden["delta_r_order"]]
    np.testing.assert_array_equal(tb.selection(dynamic, reaction), np.eye(9, 12))


@pytest.mark.parametrize("model", ["dynamic", "reaction"])
def test_delta_of_the_puma_is_the_golden_one(puma: tb.Tree, golden: Any, model: Model) -> None:
    minimal = tb.minimal_set(puma, model, zeros=True)
    key = "delta_d" if model == "dynamic" else "delta_r"
    truth = golden["variants"]["ref18_exact"][key]
    for name, value in zip(minimal.names, minimal.values(tb.barycentric(puma)), strict=True):
        golden_name = next(n for n in truth if starred(n) == name)
        factor = 2 if name.startswith("2*") else 1
        assert value == pytest.approx(factor * truth[golden_name], rel=GOLDEN_TOLERANCE)


def test_the_nine_are_the_printed_column_of_table_6(puma: tb.Tree, golden: Any) -> None:
    values = tb.minimal_set(puma, "dynamic", zeros=True).values(tb.barycentric(puma))
    np.testing.assert_allclose(values, golden["table6"]["ref18"], rtol=GOLDEN_TOLERANCE)


@pytest.mark.parametrize(
    ("gravity", "counts"), [("down", (15, 20)), ("tilted", (17, 21)), ("off", (13, 19))]
)
def test_counts_of_a_puma_with_general_bodies(
    puma: tb.Tree, gravity: str, counts: tuple[int, int]
) -> None:
    g = GRAVITIES[gravity]
    found = tuple(tb.minimal_set(puma, m, g).count for m in ("dynamic", "reaction"))
    assert found == counts


def test_formulas_are_those_of_the_paper(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "reaction", zeros=True)
    said = {str(formula) for formula in (*minimal.formulas, *minimal.auxiliary)}
    assert {
        "K*1yz = K1yz - l12z*mb*2y",
        "mb*1y = mb1y + mb*2y",
        "mb*2y = mb2y + mb3y",
        "K*2yz = K2yz - l23z*mb3y",
        "2*K3d = K3xx - K3zz",
        "K*1zz = K1zz + K*2xx/2 + K*2zz/2",
        "K*2xx = K2xx + K3xx/2 + K3zz/2",
    } <= said


# minimal sets: catalogue


@pytest.mark.parametrize("robot", COUNTS)
def test_counts_of_the_catalogue(robot: str) -> None:
    """18 robots under 4 gravities, counted elsewhere by an exact recursion."""
    tree = tb.load_tree(GOLDEN / "robots" / COUNTS[robot]["urdf"])
    for entry in COUNTS[robot]["gravity"].values():
        found = [tb.minimal_set(tree, m, entry["g"]).count for m in ("dynamic", "reaction")]
        assert found == [entry["N_d"], entry["N_r"]]


# minimal sets: laws on random trees, with Pinocchio's regressors as witness


def sampled_rows(robot: Any, tree: tb.Tree, model: Model, rng: np.random.Generator) -> Array:
    """Rows of the regressor on the barycentric parameters, (rows, 10 n), by Pinocchio."""
    standard_to_theta = np.array(
        [to_barycentric(tree, unit.reshape(tree.n, 10)).ravel() for unit in np.eye(10 * tree.n)]
    ).T
    root = pin.JointModelFreeFlyer() if model == "reaction" else None
    arguments = (robot, root) if root else (robot,)
    pinocchio = pin.buildModelFromXML(*arguments)
    pinocchio.gravity.linear = tree.gravity
    data, rows = pinocchio.createData(), []
    for q, qd, qdd in zip(*random_states(rng, 6 * tree.n + 20, tree.n), strict=True):
        if root:
            q = np.r_[0, 0, 0, 0, 0, 0, 1, q]
            qd, qdd = np.r_[np.zeros(6), qd], np.r_[np.zeros(6), qdd]
        phi = pin.computeJointTorqueRegressor(pinocchio, data, q, qd, qdd)
        rows.append(phi[:6, 10:] if root else phi)
    order = [list(pinocchio.names)[1 + bool(root) :].index(name) for name in tree.names]
    columns = np.concatenate([np.arange(10) + 10 * k for k in order])
    return np.vstack(rows)[:, columns] @ np.linalg.inv(standard_to_theta)


@pytest.mark.parametrize("gravity", ["down", "tilted", "off"])
@pytest.mark.parametrize("model", ["dynamic", "reaction"])
@pytest.mark.parametrize("seed", range(25))
def test_rules_span_what_a_sampled_regressor_spans(seed: int, model: Model, gravity: str) -> None:
    """Same rank, and the regressor does not change when theta is lifted from delta."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(1, 7)), gravity=GRAVITIES[gravity])
    tree = robot.tree()
    minimal = tb.minimal_set(tree, model)
    rows = sampled_rows(robot.urdf(), tree, model, rng)
    spread = np.linalg.svd(rows, compute_uv=False)
    assert minimal.count == np.sum(spread > 1e-8 * spread[0])
    np.testing.assert_allclose(minimal.matrix @ minimal.lift, np.eye(minimal.count), atol=1e-12)
    regrouped = rows @ minimal.lift @ minimal.matrix
    np.testing.assert_allclose(regrouped, rows, rtol=0, atol=1e-12 * np.abs(rows).max())


def test_a_set_with_one_redefinition_left_out_does_not_span(puma: tb.Tree) -> None:
    """Negative control: the comparison above can fail."""
    rng = np.random.default_rng(0)
    minimal = tb.minimal_set(puma, "dynamic")
    text = (GOLDEN.parent.parent / "models/puma562.urdf").read_text()
    rows = sampled_rows(text, puma, "dynamic", rng)
    wrong = minimal.matrix.copy()
    wrong[list(minimal.names).index("K*2yz")] = np.eye(30)[10 + 8]  # K2yz alone
    gap = rows @ np.linalg.pinv(wrong) @ wrong - rows
    assert np.abs(gap).max() > 1e-3 * np.abs(rows).max()


@pytest.mark.parametrize("seed", range(40))
def test_delta_d_is_a_linear_image_of_delta_r(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, int(rng.integers(1, 9))).tree()
    for zeros in (False, True):
        dynamic, reaction = (tb.minimal_set(tree, m, zeros=zeros) for m in ("dynamic", "reaction"))
        s = tb.selection(dynamic, reaction)
        theta = tb.barycentric(tree)
        np.testing.assert_allclose(s @ reaction.values(theta), dynamic.values(theta), atol=1e-12)


@pytest.mark.parametrize("zeros", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_formulas_say_what_the_matrix_does(seed: int, zeros: bool) -> None:
    """Every printed formula, evaluated on random parameters, gives S theta.

    What is known to be zero has no value here: a formula must not name it.
    """
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(1, 7)))
    tree = (with_zeros(rng, robot) if zeros else robot).tree()
    minimal = tb.minimal_set(tree, "reaction", zeros=zeros)
    theta = np.where(minimal.known_zero, 0.0, rng.normal(size=(tree.n, 10)))
    given = zip(parameter_names(tree), theta.ravel().tolist(), strict=True)
    known: dict[str, float] = {name: value for name, value in given if value}
    for j, joint in enumerate(tree.joints):
        for x, length in zip("xyz", joint.offset, strict=True):
            known[f"l{joint.parent + 1}{j + 1}{x}"] = float(length)
    for formula in minimal.auxiliary:  # tips first: each needs only those before it
        known[formula.left.text] = evaluate(formula.said, known)
    for formula, value in zip(minimal.formulas, minimal.values(theta), strict=True):
        said = evaluate(formula.said, known)
        assert said == pytest.approx(value, abs=1e-4), formula  # six digits


def evaluate(text: str, known: dict[str, float]) -> float:
    """The value of a sum of products; a star inside a name belongs to the name."""
    names = sorted(known, key=len, reverse=True)
    pattern = re.compile("|".join(re.escape(n) for n in names if not n.startswith("2*")))
    numbers = pattern.sub(lambda match: f"({known[match.group()]!r})", text)
    assert re.fullmatch(r"[-+*/(). 0-9e]*", numbers), (text, numbers)
    return float(eval(numbers))  # digits and operators only


def test_parameters_that_are_zero_in_the_file_shrink_the_sets(puma: tb.Tree) -> None:
    cases: dict[Model, tuple[int, int]] = {"dynamic": (15, 9), "reaction": (20, 12)}
    for model, counts in cases.items():
        found = tuple(tb.minimal_set(puma, model, zeros=z).count for z in (False, True))
        assert found == counts


def test_units_follow_the_parameters(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "reaction")
    for name, unit in zip(minimal.names, minimal.units, strict=True):
        expected = (
            "kg" if name.startswith("mbar") else "kg m" if name.startswith("mb") else "kg m^2"
        )
        assert unit == expected
    assert COMPONENTS[0] == "mbar"
