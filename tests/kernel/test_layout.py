"""Rows as they are laid out: which slot holds which column, and that nothing stands twice."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.kernel import numba_engine
from testbed.kernel.canonical import canonical
from testbed.kernel.compiler import settings
from testbed.kernel.gram import sweep
from testbed.kernel.layout import Layout, independent_columns, layout
from testbed.kernel.records import Signals, blocks
from testbed.parameters.rules import Model
from tests.helpers.robots import random_robot

MODELS: tuple[Model, ...] = ("dynamic", "reaction")


def some_tree(seed: int) -> tb.Tree:
    return random_robot(np.random.default_rng(seed), 1 + seed % 7).tree()


def some_layout(seed: int, model: Model, *, joined: bool = False) -> Layout:
    tree = some_tree(seed)
    return layout(tree, tb.minimal_set(tree, model), joined=joined)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(12))
def test_slots_are_columns_then_the_measurement_then_zeros(seed: int, model: Model) -> None:
    """Channel by channel; whole tiles of four."""
    found = some_layout(seed, model)
    rows = found.rows
    unknown, at = rows.unknown.tolist(), 0
    for c, columns in enumerate(found.channels):
        assert rows.start[c] == at
        assert rows.measured[c] == at + len(columns)
        assert rows.width[c] % 4 == 0
        assert 0 <= at + rows.width[c] - rows.measured[c] - 1 < 4
        filled = unknown[at : rows.measured[c]]
        assert filled == columns.tolist()
        assert len(set(filled)) == len(filled)
        assert set(unknown[rows.measured[c] : at + rows.width[c]]) == {-1}
        at += rows.width[c]
    assert rows.slots == at == len(unknown)
    assert rows.block % 64 == 0
    assert 64 <= rows.block <= 320
    assert found.width == len(found.channels) == (found.tree.n if model == "dynamic" else 6)


@pytest.mark.parametrize("joined", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_products_are_those_of_a_channel_or_of_all(seed: int, joined: bool) -> None:
    """Groups cover all slots once; their squares follow each other in memory."""
    rows = some_layout(seed, "reaction", joined=joined).rows
    assert len(rows.group_slot) == (1 if joined else 6)
    np.testing.assert_array_equal(rows.group_slot, np.cumsum([0, *rows.group_width[:-1]]))
    assert rows.group_width.sum() == rows.slots
    np.testing.assert_array_equal(rows.group_gram, np.cumsum([0, *rows.group_width[:-1] ** 2]))
    assert (rows.group_size <= rows.group_width).all()
    last = rows.measured[-1] if joined else rows.measured
    assert (rows.group_slot + rows.group_size > last).all()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(12))
def test_columns_are_parameters_of_one_body_each_and_make_up_the_minimal_ones(
    seed: int, model: Model
) -> None:
    """Times the basis they are a lift: S theta basis = 1."""
    tree = some_tree(seed)
    minimal = tb.minimal_set(tree, model)
    found = layout(tree, minimal)
    columns = found.theta.shape[2]
    assert (np.abs(found.theta).max(axis=1) > 0).sum(axis=0).tolist() == [1] * columns
    lifted = found.theta.reshape(10 * tree.n, columns) @ found.basis
    np.testing.assert_allclose(minimal.matrix @ lifted, np.eye(minimal.count), atol=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_canonical_parameters_are_those_of_the_turned_body(seed: int) -> None:
    """Of any body seen from its canonical frame: mass, first moment, second moments."""
    tree = some_tree(seed)
    frames = canonical(tree)
    turned = [
        inertia.moved(frame.T, np.zeros(3))
        for inertia, frame in zip(tree.inertias, frames.frames, strict=True)
    ]
    alone = [
        tb.barycentric(tb.Tree("one", (joint,), (inertia,)))
        for each in (tree.inertias, turned)
        for joint, inertia in zip(_on_the_plate(tree), each, strict=True)
    ]
    own, seen = alone[: tree.n], alone[tree.n :]
    for matrix, one, other in zip(frames.to_canonical(), own, seen, strict=True):
        np.testing.assert_allclose(matrix @ one.ravel(), other.ravel(), atol=1e-12)


def _on_the_plate(tree: tb.Tree) -> list[tb.Joint]:
    return [tb.Joint(j.name, j.body, j.kind, -1, j.axis, j.offset, j.rotation) for j in tree.joints]


@pytest.mark.parametrize("seed", range(20))
def test_independent_columns_span_all_and_come_in_their_order(seed: int) -> None:
    """As many as the rank; where every column is as good as any, the first ones."""
    rng = np.random.default_rng(seed)
    rank, count = int(rng.integers(1, 6)), int(rng.integers(6, 12))
    matrix = rng.normal(size=(rank, count))
    order = rng.permutation(count).tolist()
    picked = independent_columns(matrix, order)
    assert len(picked) == len(set(picked)) == rank
    assert np.linalg.matrix_rank(matrix[:, picked]) == rank
    units = np.eye(rank)[:, rng.integers(0, rank, 40)]
    first: dict[int, int] = {}
    for k in range(40):
        first.setdefault(int(units[:, k].argmax()), k)
    picked = independent_columns(units, range(40))
    assert picked == sorted(first.values())


def test_columns_that_nearly_depend_on_others_come_last() -> None:
    nearly = np.array([[1.0, 1.0, 0.0], [0.0, 0.01, 1.0]])
    assert independent_columns(nearly, [0, 1, 2]) == [0, 2]
    alone = np.array([[1.0, 1.0], [0.0, 1e-5]])
    assert independent_columns(alone, [0, 1]) == [0, 1]
    same = np.array([[1.0, 1.0], [0.0, 1e-7]])
    assert independent_columns(same, [0, 1]) == [0]


@pytest.mark.parametrize(("number", "size"), [(0, 5), (4, 5), (5, 5), (13, 5)])
def test_blocks_are_all_rows_in_order(number: int, size: int) -> None:
    empty = np.zeros((0, 1))
    signals = Signals(empty, empty, empty, empty, empty, empty, 0.0, 0, 100, 7, number)
    at = 0
    for first, part in blocks(signals, size):
        assert first == at
        assert part.start == 100 + 7 * first
        assert 0 < part.number <= size
        at += part.number
    assert at == number


def test_warming_up_compiles_and_says_where_to() -> None:
    folder = numba_engine.warm_up()
    assert folder == str(settings.CACHE_DIR)
    assert len(sweep.signatures) == 1
