"""The compiled kernel against the recursion of `dynamics`, which shares no code with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import testbed as tb
from benchmarks.robots import load, robots
from testbed.arrays import Array
from testbed.dynamics.motion import Motion
from testbed.identification.filters import motion_taps, row_weights
from testbed.kernel import numba_engine, numpy_engine
from testbed.kernel.canonical import canonical
from testbed.kernel.layout import Layout, layout
from testbed.kernel.records import Question, Signals, Sums, products_wanted
from testbed.parameters.rules import Model
from testbed.robot.friction import LAWS, joint_terms
from tests.helpers.robots import random_robot

SAMPLES = 700
MODELS: tuple[Model, ...] = ("dynamic", "reaction")


def some_tree(seed: int) -> tb.Tree:
    return random_robot(np.random.default_rng(seed), 1 + seed % 9).tree()


def some_signals(found: Layout, seed: int, encoders: bool, filtered: bool) -> Signals:
    rng = np.random.default_rng(seed)
    n, rate = found.tree.n, 200.0
    taps = motion_taps(rate, 40.0) if encoders else np.array([[1.0], [0.0], [0.0]])
    weights = row_weights(rate, 5.0) if filtered else np.ones(1)
    reach, step = taps.shape[1] // 2 + len(weights) // 2, 7 if filtered else 1
    t = np.arange(SAMPLES)[:, None] / rate
    size = rng.uniform(-1, 1, (3, n))
    q = sum(s * np.sin((k + 1) * t + s) for k, s in enumerate(size))
    qd, qdd = rng.uniform(-2, 2, (2, 0 if encoders else SAMPLES, n))
    measured = rng.normal(size=(SAMPLES, found.width))
    count = (SAMPLES - 2 * reach - 1) // step + 1
    return Signals(q, qd, qdd, measured, taps, weights, 0.0, 0, reach, step, count)


def close(a: Array, b: Array, tolerance: float = 1e-12) -> None:
    assert a.shape == b.shape
    assert np.abs(a - b).max(initial=0.0) <= tolerance * max(np.abs(b).max(initial=0.0), 1e-9)


def lower(found: Layout, sums: Sums) -> Array:
    """The lower triangles of the products."""
    rows = found.rows
    blocks = [
        np.tril(sums.products[at : at + width**2].reshape(width, width)).ravel()
        for width, at in zip(rows.group_width, rows.group_gram, strict=True)
    ]
    return np.concatenate(blocks)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("encoders", [False, True])
@pytest.mark.parametrize("seed", range(9))
def test_products_and_residuals_are_those_of_the_reference(
    seed: int, encoders: bool, filtered: bool, model: Model
) -> None:
    """Random trees; joints that rest, own terms, joined channels among them."""
    tree = some_tree(seed)
    terms = joint_terms(tree, LAWS) if model == "dynamic" else ()
    found = layout(tree, tb.minimal_set(tree, model), terms, joined=seed % 2 == 0)
    signals = some_signals(found, seed, encoders, filtered)
    reach = (seed % 3) * len(signals.weights) // 4
    signals = signals._replace(deadband=0.5 if model == "dynamic" else 0.0, rest_reach=reach)
    rng, work = np.random.default_rng(seed), numba_engine.workspace(found, signals)
    fast = numba_engine.sweep(found, signals, products_wanted(found.width), work)
    blocks = numpy_engine.rows(found, signals)
    slow = numpy_engine.answer(found, signals, blocks, products_wanted(found.width))
    np.testing.assert_array_equal(fast.used, slow.used)
    tolerance = 1e-11 if encoders else 1e-12  # differences magnify rounding by the rate squared
    close(lower(found, fast), lower(found, slow), tolerance)
    factors = np.where(found.rows.unknown >= 0, rng.normal(size=found.rows.slots), 0.0)
    factors[found.rows.measured] = 1.0
    weights = rng.normal(size=(found.width, found.width))
    question = Question(factors, weights, 1 if filtered else 16)
    fast = numba_engine.sweep(found, signals, question, work)
    slow = numpy_engine.answer(found, signals, blocks, question)
    close(fast.moments, slow.moments, tolerance)
    close(fast.scores, slow.scores, tolerance)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(40))
def test_rows_are_the_minimal_regressor(seed: int, model: Model) -> None:
    """Known zeros, too; columns that are combined in the lift are combined in the basis."""
    tree = some_tree(seed)
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(-2, 2, (3, 100, tree.n))
    for zeros in (False, True):
        minimal = tb.minimal_set(tree, model, zeros=zeros)
        expected = tb.regressor(tree, Motion(np.arange(100.0), q, qd, qdd), minimal)
        found = layout(tree, minimal)
        one = np.array([[1.0], [0.0], [0.0]])
        signals = Signals(
            q, qd, qdd, np.zeros((100, found.width)), one, np.ones(1), 0.0, 0, 0, 1, 100
        )
        blocks = numba_engine.rows(found, signals, numba_engine.workspace(found, signals))
        z = np.hstack(blocks)
        scale = np.abs(expected).max(initial=1.0) * max(1.0, np.abs(found.basis).max(initial=0.0))
        for c, columns in enumerate(found.channels):
            at = found.rows.start[c]
            got = z[at : at + len(columns)].T @ found.basis[columns]
            assert np.abs(got - expected[:, c]).max(initial=0.0) <= 5e-15 * scale


@pytest.mark.parametrize("seed", range(40))
def test_canonical_frames_lean_about_x_only(seed: int) -> None:
    """Put together again, the links give the tree's own rotations and offsets."""
    tree = some_tree(seed)
    found = canonical(tree)
    rests: list[tuple[Array, Array]] = []
    for link in found.links:
        c, s = link.lean
        lean = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        co, si = np.cos(link.turn), np.sin(link.turn)
        turn = np.array([[co, -si, 0], [si, co, 0], [0, 0, 1.0]])
        rotation, origin = rests[link.parent] if link.parent >= 0 else (found.bedplate, 0.0)
        rests.append((rotation @ lean @ turn, origin + rotation @ link.offset))
    places: list[tuple[Array, Array]] = []
    for j, joint in enumerate(tree.joints):
        carrier = places[joint.parent] if joint.parent >= 0 else (np.eye(3), np.zeros(3))
        own = (carrier[0] @ joint.rotation, carrier[1] + carrier[0] @ joint.offset)
        places.append(own)
        np.testing.assert_allclose(rests[found.place[j]][0], own[0] @ found.frames[j], atol=1e-13)
        np.testing.assert_allclose(rests[found.place[j]][1], own[1], atol=1e-13)
        np.testing.assert_allclose(found.frames[j][:, 2], joint.axis, atol=1e-15)


def test_every_robot_uses_the_same_compiled_code() -> None:
    from testbed.kernel.gram import sweep

    assert len(sweep.signatures) <= 1
    tree = replace(some_tree(3))
    found = layout(tree, tb.minimal_set(tree, "reaction"))
    signals = some_signals(found, 3, True, True)
    numba_engine.sweep(found, signals, products_wanted(6), numba_engine.workspace(found, signals))
    assert len(sweep.signatures) == 1


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", ["arm3", "puma6", "tree30"])
def test_rows_are_those_of_pinocchio(name: str, model: Model) -> None:
    """Phi delta = phi K pi: the minimal rows times K are Pinocchio's regressor."""
    urdf = robots()[name]
    tree, rng = load(urdf), np.random.default_rng(1)
    q, qd, qdd = rng.uniform(-2, 2, (3, 64, tree.n))
    minimal = tb.minimal_set(tree, model)
    found = layout(tree, minimal)
    one = np.array([[1.0], [0.0], [0.0]])
    signals = Signals(q, qd, qdd, np.zeros((64, found.width)), one, np.ones(1), 0.0, 0, 0, 1, 64)
    (z,) = numba_engine.rows(found, signals, numba_engine.workspace(found, signals))
    floating = (pin.JointModelFreeFlyer(),) if model == "reaction" else ()
    robot = pin.buildModelFromXML(urdf, *floating)
    data, root = robot.createData(), len(floating)
    order = [robot.getJointId(joint) - 1 - root for joint in tree.names]
    columns = np.concatenate([10 * (k + root) + np.arange(10) for k in order])
    for sample in range(64):
        states = [np.zeros(6 * root + tree.n) for _ in range(3)]
        for state, values in zip(states, (q, qd, qdd), strict=True):
            state[np.array(order) + 6 * root] = values[sample]
        if root:
            states[0] = np.concatenate([[0, 0, 0, 0, 0, 0, 1.0], states[0][6:]])
        theirs = pin.computeJointTorqueRegressor(robot, data, *states)[:, columns]
        theirs = theirs[:6] if root else theirs[order]
        for c, own in enumerate(found.channels):
            at = found.rows.start[c]
            row = z[at : at + len(own), sample] @ found.basis[own] @ minimal.standard_matrix
            assert np.abs(row - theirs[c]).max() <= 5e-15 * np.abs(theirs).max()
