"""The compiled kernel against witnesses; its code is kept where nobody else can write."""

from __future__ import annotations

import math
import os
import stat
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
from testbed.core.kernel import compiler, gram, numba_engine, numpy_engine
from testbed.core.kernel.compiler import compiled_folder
from testbed.core.kernel.layout import Layout, make_layout
from testbed.core.kernel.records import NB, SignalWindow, Sums
from testbed.core.kernel.rows import sine_cosine
from testbed.core.parameters.rules import Signal
from testbed.core.robot.free_root import with_free_base
from testbed.core.robot.friction import JOINT_LAWS, joint_terms
from tests.helpers.paths import ROOT
from tests.helpers.sensors import random_cut
from tests.helpers.strategies import Rng, few, rngs, trees

SAMPLES = 700
UNIT = np.array([[1.0], [0.0], [0.0]])
models: st.SearchStrategy[Signal] = st.sampled_from(["torque", "wrench"])
any_trees = trees((1, 9), bare=True)


def some_signals(found: Layout, rng: Rng, encoders: bool, filtered: bool) -> SignalWindow:
    n, rate = found.tree.n, 200.0
    taps = motion_taps(rate, 40.0) if encoders else UNIT
    weights = row_weights(rate, 5.0) if filtered else np.ones(1)
    reach, step = taps.shape[1] // 2 + len(weights) // 2, 7 if filtered else 1
    t = np.arange(SAMPLES)[:, None] / rate
    q = sum(s * np.sin((k + 1) * t + s) for k, s in enumerate(rng.uniform(-1, 1, (3, n))))
    qd, qdd = rng.uniform(-2, 2, (2, 0 if encoders else SAMPLES, n))
    measured = rng.normal(size=(SAMPLES, found.channel_count))
    count = (SAMPLES - 2 * reach - 1) // step + 1
    still = 0.5 if found.model == "torque" else 0.0
    near = int(rng.integers(3)) * len(weights) // 4
    return SignalWindow(q, qd, qdd, measured, taps, weights, still, near, reach, step, count)


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
    tree: tb.Tree, model: Signal, rng: Rng, how: tuple[bool, ...]
) -> None:
    """Encoders or sensed kinematics, filtered or not; a base that moves, a cut."""
    encoders, filtered, free = how
    if model == "wrench" and rng.random() < 0.5:
        tree = random_cut(tree, rng)
    elif free:
        tree = with_free_base(tree)
    terms = joint_terms(tree, JOINT_LAWS) if model == "torque" else ()
    found = make_layout(tree, tb.minimal_set(tree, model), terms)
    signals = some_signals(found, rng, encoders, filtered)
    fast = numba_engine.row_products(found, signals, numba_engine.workspace(found, signals))
    made = numpy_engine.rows(found, signals)
    slow = numpy_engine.row_products(found, signals, made)
    np.testing.assert_array_equal(fast.row_counts, slow.row_counts)
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
    tree: tb.Tree, model: Signal, zeros: bool, rng: Rng
) -> None:
    """Each channel's columns, then its measurement; none stands twice; of a cut's sensor, too."""
    if model == "wrench" and rng.random() < 0.5:
        tree = random_cut(tree, rng)
    q, qd, qdd = rng.uniform(-2, 2, (3, 100, tree.n))
    minimal = tb.minimal_set(tree, model, zeros=zeros)
    expected = tb.regressor(tree, tb.Motion(np.arange(100.0), q, qd, qdd), minimal)
    found = make_layout(tree, minimal)
    none = np.zeros((len(q), found.channel_count))
    signals = SignalWindow(q, qd, qdd, none, UNIT, np.ones(1), 0.0, 0, 0, 1, len(q))
    made = numba_engine.rows(found, signals, numba_engine.workspace(found, signals))
    z = np.hstack([block.rows for block in made])
    scale = np.abs(expected).max(initial=1.0) * max(1.0, np.abs(found.basis).max(initial=0.0))
    for c, columns in enumerate(found.channel_columns):
        at = found.rows.start[c]
        got = z[at : at + len(columns)].T @ found.basis[columns]
        assert np.abs(got - expected[:, c]).max(initial=0.0) <= 5e-15 * scale
        assert len(set(columns.tolist())) == len(columns)
        assert found.rows.measured[c] == at + len(columns)
    # of one body each: the speed that a person is promised
    assert ((np.abs(found.theta).max(axis=1) > 0).sum(axis=0) == 1).all()


def test_sines_and_cosines_are_right_to_rounding() -> None:
    """A wrong last digit is in every row; whole turns are taken off without rounding."""
    rng = np.random.default_rng(0)
    for span in (1.0, 4.0, 100.0, 1e4, 1e6):
        for shift in (0.0, 0.3, -math.pi / 2):
            q, (s, c) = rng.uniform(-span, span, NB), np.zeros((2, NB))
            sine_cosine(q, shift, s, c)
            np.testing.assert_allclose(s, np.sin(q + shift), rtol=0, atol=3e-16)
            np.testing.assert_allclose(c, np.cos(q + shift), rtol=0, atol=3e-16)


owned = pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owners here")
PLACES = ("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME")


@owned
def test_the_cache_is_where_the_system_keeps_caches_one_for_each_source_and_numba(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the first of the variables that is set; at home in .cache."""
    monkeypatch.setattr(compiler, "__file__", str(tmp_path / "compiler.py"))
    for name in PLACES:
        monkeypatch.setenv(name, str(tmp_path / name))
    for name in PLACES:
        base, found = tmp_path / name / (".cache" if name == "HOME" else ""), []
        for text in ("one", "two", "one"):
            (tmp_path / "screws.py").write_text(text)
            found.append(compiled_folder())
        assert found[0] == found[2] != found[1]
        with monkeypatch.context() as patch:
            patch.setattr("numba.__version__", "0.0.1")
            found.append(compiled_folder())
        assert found[3] not in found[:2]
        assert {each.parent for each in found} == {base / "testbed"}
        assert {stat.S_IMODE(each.stat().st_mode) & 0o077 for each in found} == {0}
        monkeypatch.delenv(name)


@owned
def test_a_folder_that_others_may_write_to_or_that_cannot_be_made_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor one of somebody else; a passing one is made in its place."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "elsewhere"))

    def passing() -> None:
        found = compiled_folder()
        assert found.parent == tmp_path / "elsewhere"
        assert stat.S_IMODE(found.stat().st_mode) == 0o700

    own, somebody = compiled_folder(), os.getuid() + 1
    for opened in (own.parent, own):
        for mode in (0o720, 0o702):
            opened.chmod(mode)
            passing()
        opened.chmod(0o755)
        assert compiled_folder() == own
    with monkeypatch.context() as patch:
        patch.setattr("os.getuid", lambda: somebody)
        passing()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    (tmp_path / "file").write_text("stands in the way")
    passing()


@owned
@pytest.mark.slow
def test_processes_keep_code_in_safe_or_named_places_only(tmp_path: Path) -> None:
    """A folder that is made for lack of a safe one goes with the process."""
    cache = tmp_path / "cache"

    def place(**own: str) -> Path:
        code = "from testbed.core.kernel.compiler import settings; print(settings.CACHE_DIR)"
        given = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
        given |= own | {"XDG_CACHE_HOME": str(cache)}
        return Path(
            subprocess.check_output([sys.executable, "-c", code], env=given, text=True)[:-1]
        )

    assert place(NUMBA_CACHE_DIR=str(tmp_path / "named")) == tmp_path / "named"
    assert not cache.exists()
    kept = place()
    assert kept.exists()
    kept.parent.chmod(0o777)
    passing = place(TMPDIR=str(tmp_path))
    assert passing.parent == tmp_path
    assert not passing.exists()
