"""Identification in a stream: the same to the bit however the samples come, in little memory."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import AnyArray, Array
from testbed.dynamics.algebra import NUMBERS
from testbed.dynamics.kinematics import kinematics
from testbed.dynamics.newton_euler import transmitted
from testbed.errors import RecordingError, SettingsError, UnknownName
from testbed.identification.covariance import ScoreSquares, bin_size
from testbed.identification.estimate import METHODS, Method
from testbed.identification.passes import Passes, is_small
from testbed.identification.settings import Settings
from testbed.identification.windows import make_plan
from testbed.kernel.layout import layout
from testbed.parameters.rules import Model
from testbed.recordings.columns import JOINT_SIGNALS
from testbed.recordings.recording import Recording
from testbed.recordings.source import open_source
from testbed.recordings.stored import write_parts
from tests.helpers.ideal import EXACT, ideal, plus, true_values
from tests.helpers.paths import ROOT
from tests.helpers.robots import random_robot

pytestmark = pytest.mark.slow

FILTERED = Settings(position_cutoff=20.0, cutoff=5.0)


def pieces(recording: Recording, size: int) -> Iterator[Recording]:
    return (
        recording.part(first, min(first + size, recording.samples))
        for first in range(0, recording.samples, size)
    )


def encoders(recording: Recording) -> Recording:
    return replace(recording, velocity=None, acceleration=None)


def same(a: tb.Estimate, b: tb.Estimate) -> None:
    for name in ("values", "covariance", "residual"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small jobs use the compiled kernel, too."""
    monkeypatch.setattr("testbed.identification.passes.SMALL", 0.0)


@pytest.fixture(scope="module")
def tree() -> tb.Tree:
    found = random_robot(np.random.default_rng(4), 3).tree()
    return replace(found, joints=tuple(replace(j, coulomb=2.0, viscous=1.0) for j in found.joints))


@pytest.fixture(scope="module")
def recording(tree: tb.Tree) -> Recording:
    return ideal(tree, duration=400.0, rate=200.0, seed=3)


@pytest.mark.parametrize("settings", [EXACT, FILTERED])
@pytest.mark.parametrize("method", METHODS)
def test_any_number_of_threads_gives_the_same_bits(
    method: Method, settings: Settings, tree: tb.Tree, recording: Recording, fast: None
) -> None:
    one, *more = (
        tb.identify(tree, recording, method, settings=settings, threads=n) for n in (1, 2, 3, 7)
    )
    for other in more:
        same(one, other)


@pytest.mark.parametrize("method", METHODS)
def test_memory_file_map_and_stream_give_the_same_bits(
    method: Method, tree: tb.Tree, recording: Recording, tmp_path: Path, fast: None
) -> None:
    """Encoders only, filtered; file with odd row groups, parts of odd sizes."""
    recording = encoders(recording).blind()
    whole = tb.identify(tree, recording, method, settings=FILTERED)
    path = tmp_path / "recording.parquet"
    write_parts(pieces(recording, 777), path)
    same(tb.identify(tree, path, method, settings=FILTERED), whole)
    same(tb.identify(tree, pieces(recording, 1234), method, settings=FILTERED), whole)
    np.save(tmp_path / "position.npy", recording.position)
    on_disk = np.load(tmp_path / "position.npy", mmap_mode="r")
    mapped = replace(recording, position=on_disk)
    assert np.shares_memory(mapped.position, on_disk)
    same(tb.identify(tree, mapped, method, settings=FILTERED), whole)
    names = tree.names[::-1]
    turned = replace(
        recording,
        names=names,
        position=recording.position[:, ::-1],
        torque=recording.measured("torque")[:, ::-1],
    )
    same(tb.identify(tree, turned, method, settings=FILTERED), whole)
    together = by_columns(recording.position)
    kept = replace(recording, position=together)
    assert np.shares_memory(kept.position, together)
    same(tb.identify(tree, kept, method, settings=FILTERED), whole)


def by_columns(values: Array) -> Array:
    """A copy that cannot be written and keeps each column together."""
    found = np.asfortranarray(values)
    found.flags.writeable = False
    return found


@pytest.mark.parametrize("model", ["dynamic", "reaction"])
def test_the_kernel_gets_samples_row_by_row(
    model: Model, tree: tb.Tree, recording: Recording
) -> None:
    """However a source keeps them, or some processors would add in another order."""
    few = recording.part(0, 200)
    joints = {signal: few.measured(signal) for signal in JOINT_SIGNALS}
    other_way: dict[str, Any] = {name: values[:, ::-1] for name, values in joints.items()}
    columns: dict[str, Any] = {name: by_columns(values) for name, values in joints.items()}
    turned = replace(few, names=few.names[::-1], **other_way)
    apart = replace(few, **columns, wrench=by_columns(few.measured("wrench")))
    found = layout(tree, tb.minimal_set(tree, model))
    for given in (few, turned, apart):
        plan = make_plan(given, found, np.zeros(6), EXACT)
        for window in plan.windows():
            signals, wanted = (
                plan.signals(each.part(window.first, window.last), window) for each in (given, few)
            )
            for name in ("position", "velocity", "acceleration", "measured"):
                found_now = getattr(signals, name)
                assert found_now.flags.c_contiguous, name
                np.testing.assert_array_equal(found_now, getattr(wanted, name))


@pytest.mark.parametrize("settings", [EXACT, FILTERED])
@pytest.mark.parametrize("method", METHODS)
def test_kernel_and_reference_give_one_estimate(
    method: Method,
    settings: Settings,
    tree: tb.Tree,
    recording: Recording,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    short = encoders(recording.part(0, 4000)) if settings is FILTERED else recording.part(0, 4000)
    noise = np.random.default_rng(0).normal(size=short.measured("wrench").shape)
    noisy = plus(short, wrench=noise, torque=noise[:, :3])
    found = []
    for limit in (0.0, 1e9):
        monkeypatch.setattr("testbed.identification.passes.SMALL", limit)
        found.append(tb.identify(tree, noisy, method, settings=settings))
    np.testing.assert_allclose(found[0].values, found[1].values, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[0].sigma, found[1].sigma, rtol=1e-6)
    np.testing.assert_array_equal(found[0].samples, found[1].samples)


@pytest.mark.parametrize("channel", ["position", "wrench"])
def test_what_is_no_number_is_named_wherever_it_is(
    channel: str, tree: tb.Tree, recording: Recording, tmp_path: Path, fast: None
) -> None:
    values = np.array(getattr(recording, channel))
    values[60_123, 1] = np.nan
    bad = replace(recording.blind(), **{channel: values})  # type: ignore[arg-type]
    path = tmp_path / "recording.parquet"
    write_parts([bad], path)
    for source in (bad, path):
        with pytest.raises(
            RecordingError, match=rf"{channel}/\w+' is nan at sample 60123 \(t = 300.615"
        ):
            tb.identify(tree, source, threads=2)


@pytest.mark.parametrize("settings", [EXACT, FILTERED])
@pytest.mark.slow
def test_a_gap_in_time_is_named_wherever_it_is(
    settings: Settings, tree: tb.Tree, recording: Recording
) -> None:
    """In the midst of a window, and between two."""
    found = layout(tree, tb.minimal_set(tree, "reaction"))
    plan = make_plan(recording, found, np.zeros(6), settings)
    border = [window.first for window in plan.windows()][1]
    for sample in (70_000, border - 1, border):
        time = np.array(recording.time)
        time[sample + 1 :] += 0.5
        with pytest.raises(RecordingError, match=rf"not uniform: 0.505 s after sample {sample}"):
            tb.identify(tree, replace(recording, time=time), settings=settings)


def test_a_file_without_samples_is_no_recording(
    tree: tb.Tree, recording: Recording, tmp_path: Path
) -> None:
    write_parts([recording.part(0, 0)], tmp_path / "empty.parquet")
    with pytest.raises(RecordingError, match="0 samples, which is no recording"):
        tb.identify(tree, tmp_path / "empty.parquet")


def test_parts_that_do_not_belong_together_are_refused(
    tree: tb.Tree, recording: Recording, tmp_path: Path
) -> None:
    parts = [recording.part(0, 100), encoders(recording.part(100, 200))]
    with pytest.raises(RecordingError, match="different channels"):
        tb.identify(tree, parts)
    with pytest.raises(RecordingError, match="different channels"):
        write_parts(parts, tmp_path / "r.parquet")
    with pytest.raises(RecordingError, match="no parts"):
        tb.identify(tree, [])


@pytest.mark.slow
def test_small_jobs_do_not_load_the_compiler() -> None:
    """Sixty seconds of three joints at 1 kHz: what table6 is."""
    code = (
        "import sys, numpy as np, testbed as tb\n"
        "from tests.helpers.ideal import ideal\n"
        f"tree = tb.load_tree(r'{ROOT / 'models/puma562.urdf'}')\n"
        "tb.identify(tree, ideal(tree, 60.0, 1000.0), 'external')\n"
        "assert 'numba' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_large_jobs_use_the_kernel(tree: tb.Tree, recording: Recording) -> None:
    found = layout(tree, tb.minimal_set(tree, "reaction"))
    plan = make_plan(recording, found, np.zeros(6), EXACT)
    assert is_small(plan)
    whole = [recording.blind()] * 3
    longer = replace(plan, source=open_source(whole), spans=((0, 3 * plan.rows),))
    assert not is_small(longer)
    assert Passes(longer, None, lambda done, total: None, 2).compiled


def test_progress_counts_both_passes(tree: tb.Tree, recording: Recording, fast: None) -> None:
    seen: list[tuple[int, int]] = []
    tb.identify(tree, recording, settings=EXACT, progress=lambda *args: seen.append(args))
    done = [d for d, _ in seen]
    assert done == sorted(done)
    assert done[-1] == seen[-1][1] == 2 * recording.samples


# Other weights and channels from the same products.


@pytest.mark.parametrize("method", METHODS)
def test_a_fit_of_some_channels_is_the_fit_of_their_rows(
    method: Method, tree: tb.Tree, recording: Recording
) -> None:
    """All but one channel, by weight and by leaving its rows out of a dense problem."""
    short = recording.part(0, 2000)
    noise = np.random.default_rng(0).normal(size=short.measured("wrench").shape)
    noisy = plus(short, wrench=noise, torque=noise[:, :3])
    settings = replace(EXACT, terms=(), deadband=0.0)
    estimate = tb.identify(tree, noisy, method, settings=settings)
    left = {name: 1.0 + k for k, name in enumerate(estimate.channels)}
    left.pop(estimate.channels[1])
    minimal = tb.minimal_set(tree, "dynamic" if method == "internal" else "reaction")
    motion = tb.Motion(noisy.time, noisy.position, noisy.velocity, noisy.acceleration)  # type: ignore[arg-type]
    phi = tb.regressor(tree, motion, minimal)
    y = noisy.measured("torque") if method == "internal" else noisy.measured("wrench")
    keep = [k for k, name in enumerate(estimate.channels) if name in left]
    root = np.sqrt([left[estimate.channels[k]] for k in keep])
    a = (phi[:, keep] * root[:, None]).reshape(-1, minimal.count)
    expected = np.linalg.lstsq(a, (y[:, keep] * root).ravel(), rcond=None)[0]
    found = tb.fit(estimate.normal_equations, left)
    seen = ~np.isnan(found.values)
    scale = np.abs(expected).max()
    assert np.abs(found.values[seen] - expected[seen]).max() <= 1e-9 * scale
    assert not a[:, ~seen].any()
    with pytest.raises(UnknownName, match="unknown channel 'Mq'"):
        tb.fit(estimate.normal_equations, {"Mq": 1.0})
    again = tb.fit(estimate.normal_equations)
    np.testing.assert_allclose(again.values, estimate.values, rtol=1e-8, atol=1e-8 * scale)


def correlated(tree: tb.Tree) -> tuple[Recording, Array]:
    """Plate noise of which Fx and My hold the same, ten times larger than the rest."""
    clean = ideal(tree, duration=60.0, rate=200.0, seed=3)
    rng = np.random.default_rng(5)
    root = np.eye(6) * 0.1
    root[0, 0] = root[4, 0] = 3.0
    noise = rng.normal(size=clean.measured("wrench").shape) @ root.T
    return plus(clean, wrench=noise), root @ root.T


@pytest.mark.slow
def test_the_full_covariance_of_the_plate_is_worth_knowing(tree: tb.Tree) -> None:
    recording, covariance = correlated(tree)
    truth = true_values(tree, "external")
    weights: tuple[Any, ...] = ("channels", "full", covariance)
    estimates = [tb.identify(tree, recording, settings=replace(EXACT, weights=w)) for w in weights]
    errors = [np.linalg.norm(e.values - truth) for e in estimates]
    sigmas = [np.linalg.norm(e.sigma) for e in estimates]
    assert sigmas[1] < 0.8 * sigmas[0]
    assert errors[1] < errors[0]
    np.testing.assert_allclose(estimates[1].values, estimates[2].values, rtol=0.05, atol=0.05)
    for estimate in estimates:
        assert np.abs((estimate.values - truth) / estimate.sigma).max() < 4.0


def test_a_covariance_must_fit_the_channels() -> None:
    tree = random_robot(np.random.default_rng(0), 2).tree()
    with pytest.raises(SettingsError, match="of 6 channels, the internal method has 2"):
        tb.identify(
            tree, ideal(tree), "internal", settings=replace(EXACT, weights=np.eye(6).tolist())
        )


# Ill-conditioned equations.


@pytest.mark.parametrize("exponent", range(0, 8))
def test_as_accurate_as_lstsq_up_to_a_condition_of_a_million(exponent: int) -> None:
    """Two joints of which one moves less and less; against lstsq in extended precision."""
    tree = random_robot(np.random.default_rng(12), 3).tree()
    clean = ideal(tree, duration=20.0)
    rng = np.random.default_rng(exponent)
    small = np.array([1.0, 1.0, 10.0**-exponent])
    q = np.asarray(clean.position) * small + np.array([0.0, 0.0, 0.3])
    assert clean.velocity is not None
    assert clean.acceleration is not None
    motion = tb.Motion(clean.time, q, clean.velocity * small, clean.acceleration * small)
    minimal = tb.minimal_set(tree, "reaction")
    phi = tb.regressor(tree, motion, minimal).reshape(-1, minimal.count)
    wrench = (phi @ minimal.values(tb.barycentric(tree))).reshape(-1, 6)
    wrench = wrench + 1e-2 * rng.normal(size=wrench.shape)
    recording = replace(
        clean, position=q, velocity=motion.qd, acceleration=motion.qdd, wrench=wrench
    )
    estimate = tb.identify(tree, recording, settings=replace(EXACT, weights=np.eye(6).tolist()))
    scale = np.linalg.norm(phi, axis=0)
    a, y = phi / scale, wrench.ravel()
    plain = np.linalg.lstsq(a, y, rcond=None)[0]
    fine, inverse = extended(tree, motion, minimal) / scale, np.linalg.pinv(a)
    exact = plain.astype(np.longdouble)
    for _ in range(8):
        exact = exact + inverse @ (y - fine @ exact).astype(float)
    size = np.linalg.norm(exact.astype(float))
    ours = np.linalg.norm((estimate.values * scale - exact).astype(float)) / size
    theirs = np.linalg.norm((plain - exact).astype(float)) / size
    assert 10.0**exponent < estimate.condition < 200 * 10.0**exponent
    if estimate.condition <= 1e6:
        assert ours <= 3 * max(float(theirs), 4e-15)
    else:
        assert ours <= 1e-6


def extended(tree: tb.Tree, motion: tb.Motion, minimal: tb.MinimalSet) -> Array:
    """The reaction regressor in extended precision, (6 M, N)."""
    states: tuple[AnyArray, ...] = (motion.q, motion.qd, motion.qdd)
    q, qd, qdd = (x.astype(np.longdouble) for x in states)
    lift = minimal.lift.reshape(tree.n, 10, minimal.count).astype(np.longdouble)
    moving = kinematics(tree, q, qd, qdd, minimal.gravity, NUMBERS)
    base: Array = transmitted(tree, moving, lift, NUMBERS)[1]
    return base.reshape(-1, minimal.count)


# The covariance's sums.


@pytest.mark.parametrize("cuts", [(), (3,), (40, 41, 90)])
def test_sliding_windows_are_bartletts_weights(cuts: tuple[int, ...]) -> None:
    scores = np.random.default_rng(0).normal(size=(100, 4))
    squares = ScoreSquares(4, rate=20.0)
    for part in np.split(scores, cuts):
        squares.add(part)
    lags = 10
    assert squares.lags == lags
    expected = scores.T @ scores
    for lag in range(1, lags + 1):
        overlap = scores[lag:].T @ scores[:-lag]
        expected += (1 - lag / (lags + 1)) * (overlap + overlap.T)
    np.testing.assert_allclose(squares.finish(), expected, rtol=1e-12, atol=1e-12)
    assert [bin_size(rate) for rate in (20.0, 100.0, 1000.0, 1e5)] == [1, 8, 64, 64]


# The compiled code.


@pytest.mark.slow
def test_the_kernel_is_right_without_wide_vectors(tmp_path: Path) -> None:
    """Compiled for a processor with AVX2 only, with its own tiles."""
    from llvmlite import binding

    features = binding.get_host_cpu_features()
    narrow = ",".join(
        ("+" if present and not name.startswith(("avx512", "evex", "avx10")) else "-") + name
        for name, present in features.items()
    )
    code = (
        "from testbed.kernel.compiler import WIDE\n"
        "assert not WIDE\n"
        "import tests.kernel.test_kernel as t\n"
        "law = t.test_products_and_residuals_are_those_of_the_reference\n"
        "for seed in range(4):\n"
        "    for model in t.MODELS:\n"
        "        law(seed, False, True, model)\n"
    )
    environment = os.environ | {
        "NUMBA_CPU_FEATURES": narrow,
        "NUMBA_CPU_NAME": "generic",
        "XDG_CACHE_HOME": str(tmp_path),
    }
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, env=environment)
