"""The compiled kernel, which makes the equations of every long recording, against witnesses."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from llvmlite import binding

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.estimation.regression.windows import motion_taps, row_weights
from testbed.core.kernel import gram, numba_engine, numpy_engine
from testbed.core.kernel.layout import Layout, independent_columns, layout
from testbed.core.kernel.records import NB, Signals, Sums
from testbed.core.kernel.rows import sine_cosine
from testbed.core.parameters.rules import Model
from testbed.core.robot.free_base import on_free_base
from testbed.core.robot.friction import LAWS, joint_terms
from tests.helpers.paths import ROOT
from tests.helpers.sensors import random_cut
from tests.helpers.strategies import few, rngs, trees

SAMPLES = 700
UNIT = np.array([[1.0], [0.0], [0.0]])
models: st.SearchStrategy[Model] = st.sampled_from(["dynamic", "reaction"])
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


def close(a: Array, b: Array, tolerance: float = 1e-12) -> None:
    assert a.shape == b.shape
    assert np.abs(a - b).max(initial=0.0) <= tolerance * max(np.abs(b).max(initial=0.0), 1e-9)


def lower(found: Layout, sums: Sums) -> Array:
    """The lower triangles of the products."""
    sizes = zip(found.rows.width, found.rows.group_gram, strict=True)
    squares = (sums.products[at : at + width**2].reshape(width, width) for width, at in sizes)
    return np.concatenate([np.tril(square).ravel() for square in squares])


@few(40)
@given(any_trees, models, rngs, st.tuples(*[st.booleans()] * 3))
def test_compiled_and_plain_engine_say_the_same(
    tree: tb.Tree, model: Model, rng: np.random.Generator, how: tuple[bool, ...]
) -> None:
    """Encoders or sensed kinematics, filtered or not; a base that moves, a cut."""
    encoders, filtered, free = how
    if model == "reaction" and rng.random() < 0.5:
        tree = random_cut(tree, rng)
    elif free:
        tree = on_free_base(tree)
    terms = joint_terms(tree, LAWS) if model == "dynamic" else ()
    found = layout(tree, tb.minimal_set(tree, model), terms)
    signals = some_signals(found, rng, encoders, filtered)
    fast = numba_engine.sweep(found, signals, numba_engine.workspace(found, signals))
    made = numpy_engine.rows(found, signals)
    slow = numpy_engine.sweep(found, signals, made)
    np.testing.assert_array_equal(fast.used, slow.used)
    tolerance = 1e-11 if encoders else 1e-12  # differences magnify rounding by the rate squared
    close(lower(found, fast), lower(found, slow), tolerance)
    assert len(gram.sweep.signatures) == 1  # compiled once for every robot


@pytest.mark.nightly
def test_the_kernel_is_right_on_processors_without_wide_vectors(tmp_path: Path) -> None:
    """Compiled anew, for AVX2 only, with its own tiles."""
    wide = ("avx512", "evex", "avx10")
    narrow = ",".join(
        f"{'-' if name.startswith(wide) or not present else '+'}{name}"
        for name, present in binding.get_host_cpu_features().items()
    )
    own = {"NUMBA_CPU_FEATURES": narrow, "NUMBA_CPU_NAME": "generic"}
    environment = os.environ | own | {"XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-m", "pytest", "-q", __file__, "-k", "say_the_same"]
    subprocess.run(command, cwd=ROOT, check=True, env=environment)


@few(40)
@given(any_trees, models, st.booleans(), rngs)
def test_rows_are_the_minimal_regressor(
    tree: tb.Tree, model: Model, zeros: bool, rng: np.random.Generator
) -> None:
    """Each channel's columns, then its measurement; none stands twice; of a cut's sensor, too."""
    if model == "reaction" and rng.random() < 0.5:
        tree = random_cut(tree, rng)
    q, qd, qdd = rng.uniform(-2, 2, (3, 100, tree.n))
    minimal = tb.minimal_set(tree, model, zeros=zeros)
    expected = tb.regressor(tree, tb.Motion(np.arange(100.0), q, qd, qdd), minimal)
    found = layout(tree, minimal)
    none = np.zeros((len(q), found.width))
    signals = Signals(q, qd, qdd, none, UNIT, np.ones(1), 0.0, 0, 0, 1, len(q))
    made = numba_engine.rows(found, signals, numba_engine.workspace(found, signals))
    z = np.hstack([block.rows for block in made])
    scale = np.abs(expected).max(initial=1.0) * max(1.0, np.abs(found.basis).max(initial=0.0))
    for c, columns in enumerate(found.channels):
        at = found.rows.start[c]
        got = z[at : at + len(columns)].T @ found.basis[columns]
        assert np.abs(got - expected[:, c]).max(initial=0.0) <= 5e-15 * scale
        assert len(set(columns.tolist())) == len(columns)
        assert found.rows.measured[c] == at + len(columns)
    # of one body each: the speed that a person is promised
    assert ((np.abs(found.theta).max(axis=1) > 0).sum(axis=0) == 1).all()


@given(rngs)
def test_independent_columns_span_all_and_are_the_first_that_do(rng: np.random.Generator) -> None:
    """But for columns that nearly depend on earlier ones: these come last."""
    units = np.eye(5)[:, rng.integers(0, 5, 40)]
    first = {tuple(column): 39 - k for k, column in enumerate(units.T[::-1])}
    assert independent_columns(units, range(40)) == sorted(first.values())
    matrix = rng.normal(size=(5, 12))
    picked = independent_columns(matrix, rng.permutation(12).tolist())
    assert len(picked) == np.linalg.matrix_rank(matrix[:, picked]) == 5
    assert independent_columns(np.array([[1.0, 1.0, 0.0], [0.0, 0.01, 1.0]]), [0, 1, 2]) == [0, 2]
    for size, wanted in ((1e-5, [0, 1]), (1e-7, [0])):
        assert independent_columns(np.array([[1.0, 1.0], [0.0, size]]), [0, 1]) == wanted


def test_sines_and_cosines_are_right_to_rounding() -> None:
    """A wrong last digit is in every row; whole turns are taken off without rounding."""
    rng = np.random.default_rng(0)
    for span in (1.0, 4.0, 100.0, 1e4, 1e6):
        for shift in (0.0, 0.3, -math.pi / 2):
            q, (s, c) = rng.uniform(-span, span, NB), np.zeros((2, NB))
            sine_cosine(q, shift, s, c)
            np.testing.assert_allclose(s, np.sin(q + shift), rtol=0, atol=3e-16)
            np.testing.assert_allclose(c, np.cos(q + shift), rtol=0, atol=3e-16)
