"""The compiled kernel, which makes the equations of every long recording, against witnesses."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.arrays import Array
from testbed.identification.filters import motion_taps, row_weights
from testbed.kernel import gram, numba_engine, numpy_engine
from testbed.kernel.layout import Layout, independent_columns, layout
from testbed.kernel.records import Question, Signals, Sums, products_wanted
from testbed.parameters.rules import Model
from testbed.robot.friction import LAWS, joint_terms
from tests.helpers.paths import ROOT
from tests.helpers.strategies import few, rngs, trees

SAMPLES = 700
MODELS: tuple[Model, ...] = ("dynamic", "reaction")
UNIT = np.array([[1.0], [0.0], [0.0]])
models = st.sampled_from(MODELS)
any_trees = trees((1, 9), bare=True)


def some_signals(
    found: Layout, rng: np.random.Generator, encoders: bool, filtered: bool
) -> Signals:
    n, rate = found.tree.n, 200.0
    taps = motion_taps(rate, 40.0) if encoders else UNIT
    weights = row_weights(rate, 5.0) if filtered else np.ones(1)
    reach, step = taps.shape[1] // 2 + len(weights) // 2, 7 if filtered else 1
    t = np.arange(SAMPLES)[:, None] / rate
    q = sum(s * np.sin((k + 1) * t + s) for k, s in enumerate(rng.uniform(-1, 1, (3, n))))
    qd, qdd = rng.uniform(-2, 2, (2, 0 if encoders else SAMPLES, n))
    measured = rng.normal(size=(SAMPLES, found.width))
    count = (SAMPLES - 2 * reach - 1) // step + 1
    still = 0.5 if found.model == "dynamic" else 0.0
    near = int(rng.integers(3)) * len(weights) // 4
    return Signals(q, qd, qdd, measured, taps, weights, still, near, reach, step, count)


def plain(found: Layout, q: Array, qd: Array, qdd: Array) -> Signals:
    """Sensed kinematics, a row a sample."""
    none = np.zeros((len(q), found.width))
    return Signals(q, qd, qdd, none, UNIT, np.ones(1), 0.0, 0, 0, 1, len(q))


def rows_of(found: Layout, signals: Signals) -> Array:
    """All slots of all rows, (slots, rows)."""
    return np.hstack(numba_engine.rows(found, signals, numba_engine.workspace(found, signals)))


def close(a: Array, b: Array, tolerance: float = 1e-12) -> None:
    assert a.shape == b.shape
    assert np.abs(a - b).max(initial=0.0) <= tolerance * max(np.abs(b).max(initial=0.0), 1e-9)


def lower(found: Layout, sums: Sums) -> Array:
    """The lower triangles of the products."""
    sizes = zip(found.rows.group_width, found.rows.group_gram, strict=True)
    squares = (sums.products[at : at + width**2].reshape(width, width) for width, at in sizes)
    return np.concatenate([np.tril(square).ravel() for square in squares])


def agree(tree: tb.Tree, model: Model, rng: np.random.Generator, how: tuple[bool, ...]) -> None:
    """Products, residuals and scores of both engines."""
    encoders, filtered, joined = how
    terms = joint_terms(tree, LAWS) if model == "dynamic" else ()
    found = layout(tree, tb.minimal_set(tree, model), terms, joined=joined)
    signals = some_signals(found, rng, encoders, filtered)
    work, wanted = numba_engine.workspace(found, signals), products_wanted(found.width)
    fast = numba_engine.sweep(found, signals, wanted, work)
    made = numpy_engine.rows(found, signals)
    slow = numpy_engine.answer(found, signals, made, wanted)
    np.testing.assert_array_equal(fast.used, slow.used)
    tolerance = 1e-11 if encoders else 1e-12  # differences magnify rounding by the rate squared
    close(lower(found, fast), lower(found, slow), tolerance)
    factors = np.where(found.rows.unknown >= 0, rng.normal(size=found.rows.slots), 0.0)
    factors[found.rows.measured] = 1.0
    weights = rng.normal(size=(found.width, found.width))
    question = Question(factors, weights, 1 if filtered else 16)
    fast = numba_engine.sweep(found, signals, question, work)
    slow = numpy_engine.answer(found, signals, made, question)
    close(fast.moments, slow.moments, tolerance)
    close(fast.scores, slow.scores, tolerance)
    assert len(gram.sweep.signatures) == 1  # compiled once for every robot


@few(40)
@given(any_trees, models, rngs, st.tuples(st.booleans(), st.booleans(), st.booleans()))
def test_compiled_and_plain_engine_say_the_same(
    tree: tb.Tree, model: Model, rng: np.random.Generator, how: tuple[bool, ...]
) -> None:
    """Encoders or sensed kinematics, filtered or not, channels joined; joints that rest."""
    agree(tree, model, rng, how)


@pytest.mark.nightly
def test_the_kernel_is_right_on_processors_without_wide_vectors(tmp_path: Path) -> None:
    """Compiled anew, for AVX2 only, with its own tiles."""
    from llvmlite import binding

    narrow = ",".join(
        ("+" if present and not name.startswith(("avx512", "evex", "avx10")) else "-") + name
        for name, present in binding.get_host_cpu_features().items()
    )
    code = (
        "import numpy as np, tests.kernel.test_kernel as t\n"
        "from tests.helpers.robots import random_robot\n"
        "assert not t.compiler.WIDE\n"
        "for k in range(16):\n"
        "    rng = np.random.default_rng(k)\n"
        "    tree = random_robot(rng, 1 + k % 7).tree()\n"
        "    t.agree(tree, t.MODELS[k % 2], rng, (k % 4 > 1, k % 8 > 3, k > 7))\n"
    )
    own = {"NUMBA_CPU_FEATURES": narrow, "NUMBA_CPU_NAME": "generic"}
    environment = os.environ | own | {"XDG_CACHE_HOME": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, env=environment)


@few(40)
@given(any_trees, models, st.booleans(), rngs)
def test_rows_are_the_minimal_regressor(
    tree: tb.Tree, model: Model, zeros: bool, rng: np.random.Generator
) -> None:
    """Each channel's columns, then its measurement; none stands twice."""
    q, qd, qdd = rng.uniform(-2, 2, (3, 100, tree.n))
    minimal = tb.minimal_set(tree, model, zeros=zeros)
    expected = tb.regressor(tree, tb.Motion(np.arange(100.0), q, qd, qdd), minimal)
    found = layout(tree, minimal)
    z = rows_of(found, plain(found, q, qd, qdd))
    scale = np.abs(expected).max(initial=1.0) * max(1.0, np.abs(found.basis).max(initial=0.0))
    for c, columns in enumerate(found.channels):
        at = found.rows.start[c]
        got = z[at : at + len(columns)].T @ found.basis[columns]
        assert np.abs(got - expected[:, c]).max(initial=0.0) <= 5e-15 * scale
        assert len(set(columns.tolist())) == len(columns)
        assert found.rows.unknown[at : at + len(columns)].tolist() == columns.tolist()
        assert found.rows.measured[c] == at + len(columns)
    # of one body each, in whole tiles: the speed that a person is promised
    assert ((np.abs(found.theta).max(axis=1) > 0).sum(axis=0) == 1).all()
    widths = np.array([len(columns) + 1 for columns in found.channels])
    np.testing.assert_array_equal(found.rows.width, -(-widths // 4) * 4)
    assert 64 <= found.rows.block <= 320


@given(rngs)
def test_independent_columns_span_all_and_are_the_first_that_do(rng: np.random.Generator) -> None:
    """But for columns that nearly depend on earlier ones: these come last."""
    rank, count = int(rng.integers(1, 6)), int(rng.integers(6, 12))
    matrix = rng.normal(size=(rank, count))
    picked = independent_columns(matrix, rng.permutation(count).tolist())
    assert len(set(picked)) == len(picked) == rank == np.linalg.matrix_rank(matrix[:, picked])
    units = np.eye(rank)[:, rng.integers(0, rank, 40)]
    first = {tuple(column): 39 - k for k, column in enumerate(units.T[::-1])}
    assert independent_columns(units, range(40)) == sorted(first.values())
    assert independent_columns(np.array([[1.0, 1.0, 0.0], [0.0, 0.01, 1.0]]), [0, 1, 2]) == [0, 2]
    for size, wanted in ((1e-5, [0, 1]), (1e-7, [0])):
        assert independent_columns(np.array([[1.0, 1.0], [0.0, size]]), [0, 1]) == wanted
